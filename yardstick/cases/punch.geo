// Half of a block below a flat punch: a half-plane, cut far from the punch. Plane.
//
// a       half width of the punch
// L       width and depth of the block
// h       size of the cells at the edge of the punch
// Growth  how much the size of the cells grows per distance from the edge, over h/a: all cells go with h
//
// Lengths may be in any unit.

DefineConstant[
  a = {1, Name "Half width of the punch"}
  L = {1000, Name "Width and depth of the block"}
  h = {0.004, Name "Size of cells at the edge"}
  Growth = {8, Name "Growth of cells"}
];

Point(1) = {0, 0, 0};
Point(2) = {0, -L, 0};
Point(3) = {L, -L, 0};
Point(4) = {L, 0, 0};
Point(5) = {a, 0, 0};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 5};
Line(5) = {5, 1};
Curve Loop(1) = {1:5};
Plane Surface(1) = {1};

Physical Surface("block", 1) = {1};
Physical Curve("contact", 11) = {5};
Physical Curve("bottom", 12) = {2};
Physical Curve("symmetry", 13) = {1};

Field[1] = MathEval;
Field[1].F = Sprintf("%g*(1 + %g*sqrt((x - %g)^2 + y^2)/%g)", h, Growth, a, a);
Background Field = 1;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
