// A block on which a cylinder rolls: a half-plane, cut far from the contact. Plane.
//
// h       size of the cells along the way
// Way     length of the way on each side of the middle
// L       half width and depth of the block
// Growth  how much the size of the cells grows per distance from the way
//
// Lengths may be in any unit.

DefineConstant[
  h = {0.2, Name "Size of cells along the way"}
  Way = {9.5, Name "Length of the way on each side of the middle"}
  L = {20, Name "Half width and depth of the block"}
  Growth = {0.3, Name "Growth of cells"}
];

Point(1) = {-L, -L, 0};
Point(2) = {L, -L, 0};
Point(3) = {L, 0, 0};
Point(4) = {Way, 0, 0};
Point(5) = {-Way, 0, 0};
Point(6) = {-L, 0, 0};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 5};
Line(5) = {5, 6};
Line(6) = {6, 1};
Curve Loop(1) = {1:6};
Plane Surface(1) = {1};

Physical Surface("block", 1) = {1};
Physical Curve("contact", 11) = {4};
Physical Curve("bottom", 12) = {1};

Field[1] = MathEval;
Field[1].F = Sprintf("%g + %g*sqrt(max(abs(x) - %g, 0)^2 + y^2)", h, Growth, Way);
Background Field = 1;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
