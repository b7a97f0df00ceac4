// Half of a disc, from its lowest point, the origin, to its top. Plane; cells are curved: the weight is the disc's.
//
// R       radius
// h       size of the cells
//
// Lengths may be in any unit.

DefineConstant[
  R = {20, Name "Radius"}
  h = {1, Name "Size of cells"}
];

Point(1) = {0, 0, 0, h};
Point(2) = {R, R, 0, h};
Point(3) = {0, 2 * R, 0, h};
Point(4) = {0, R, 0, h};
Circle(1) = {1, 4, 2};
Circle(2) = {2, 4, 3};
Line(3) = {3, 4};
Line(4) = {4, 1};
Curve Loop(1) = {1:4};
Plane Surface(1) = {1};

Physical Surface("disc", 1) = {1};
Physical Curve("contact", 11) = {1};
Physical Curve("symmetry", 12) = {3, 4};

Mesh.ElementOrder = 2;
