// Meridians of a punch with a rounded edge and of its foundation: NAFEMS contact benchmark 2.
//
// h       size of the cells where the flat face ends
// Growth  how much the size of the cells grows per distance from there
//
// Lengths in mm: the punch has radius 50, height 100 and a fillet of 10, the foundation 100 and 200.

DefineConstant[
  h = {0.5, Name "Size of cells at the end of the flat face"}
  Growth = {0.2, Name "Growth of cells"}
];

Point(1) = {0, 0, 0};
Point(2) = {40, 0, 0};
Point(3) = {50, 10, 0};
Point(4) = {50, 100, 0};
Point(5) = {0, 100, 0};
Point(6) = {40, 10, 0};
Line(1) = {1, 2};
Circle(2) = {2, 6, 3};
Line(3) = {3, 4};
Line(4) = {4, 5};
Line(5) = {5, 1};
Curve Loop(1) = {1:5};
Plane Surface(1) = {1};

Point(11) = {0, 0, 0};
Point(12) = {0, -200, 0};
Point(13) = {100, -200, 0};
Point(14) = {100, 0, 0};
Point(15) = {50, 0, 0};
Line(11) = {11, 12};
Line(12) = {12, 13};
Line(13) = {13, 14};
Line(14) = {14, 15};
Line(15) = {15, 11};
Curve Loop(2) = {11:15};
Plane Surface(2) = {2};

Physical Surface("punch", 1) = {1};
Physical Surface("foundation", 2) = {2};
Physical Curve("punch_contact", 11) = {1, 2};
Physical Curve("top", 12) = {4};
Physical Curve("foundation_contact", 21) = {15};
Physical Curve("bottom", 22) = {12};
Physical Curve("axis", 3) = {5, 11};

Field[1] = MathEval;
Field[1].F = Sprintf("%g + %g*sqrt((x - 40)^2 + y^2)", h, Growth);
Background Field = 1;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
