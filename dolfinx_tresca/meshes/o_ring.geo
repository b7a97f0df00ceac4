// A quarter of the cross-section of an O-ring.
//
//   centre (0, R), its lowest point is the origin; cut at the planes of symmetry y = R and x = 0
//
// R       radius of the cord
// N       cells along the arc
//
// Lengths may be in any unit.

DefineConstant[
  R = {1, Name "Radius"}
  N = {24, Name "Cells along the arc"}
];

Point(1) = {0, R, 0};
Point(2) = {0, 0, 0};
Point(3) = {R, R, 0};
Circle(1) = {2, 1, 3};
Line(2) = {3, 1};
Line(3) = {1, 2};
Curve Loop(1) = {1 : 3};
Plane Surface(1) = {1};

Physical Surface("ring", 1) = {1};
Physical Curve("arc", 11) = {1};
Physical Curve("middle", 12) = {2};
Physical Curve("axis", 13) = {3};

Mesh.MeshSizeMax = Pi * R / 2 / N;
Mesh.MeshSizeMin = Mesh.MeshSizeMax;
