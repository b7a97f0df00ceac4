// Half of a cylinder on half of a block: the roller of the NAFEMS contact benchmarks. Plane.
//
// R       radius of the cylinder; the block is 2 R wide and 4 R high
// h       size of the cells at the contact
// Zone    half width of the contact surfaces, and radius of the zone of small cells
// Load    half width of the loaded arc on top
// Growth  how much the size of the cells grows per distance from the zone
//
// Lengths may be in any unit.

DefineConstant[
  R = {50, Name "Radius of the cylinder"}
  h = {0.4, Name "Size of cells at the contact"}
  Zone = {10, Name "Half width of the contact surfaces"}
  Load = {10, Name "Half width of the loaded arc"}
  Growth = {0.2, Name "Growth of cells"}
];

rise = R - Sqrt(R^2 - Zone^2);
Point(1) = {0, R, 0};
Point(2) = {0, 0, 0};
Point(3) = {Zone, rise, 0};
Point(4) = {R, R, 0};
Point(5) = {Load, R + Sqrt(R^2 - Load^2), 0};
Point(6) = {0, 2*R, 0};
Circle(1) = {2, 1, 3};
Circle(2) = {3, 1, 4};
Circle(3) = {4, 1, 5};
Circle(4) = {5, 1, 6};
Line(5) = {6, 2};
Curve Loop(1) = {1:5};
Plane Surface(1) = {1};

Point(11) = {0, 0, 0};
Point(12) = {0, -4*R, 0};
Point(13) = {2*R, -4*R, 0};
Point(14) = {2*R, 0, 0};
Point(15) = {Zone, 0, 0};
Line(11) = {11, 12};
Line(12) = {12, 13};
Line(13) = {13, 14};
Line(14) = {14, 15};
Line(15) = {15, 11};
Curve Loop(2) = {11:15};
Plane Surface(2) = {2};

Physical Surface("cylinder", 1) = {1};
Physical Surface("block", 2) = {2};
Physical Curve("cylinder_contact", 11) = {1};
Physical Curve("top", 12) = {4};
Physical Curve("block_contact", 21) = {15};
Physical Curve("bottom", 22) = {12};
Physical Curve("symmetry", 3) = {5, 11};

Field[1] = MathEval;
Field[1].F = Sprintf("%g + %g*max(0, sqrt(x^2 + y^2) - %g)", h, Growth, Zone);
Background Field = 1;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
