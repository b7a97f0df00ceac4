// A quarter of the cross-section of a long elastic cylinder: Hertz contact along a line.
//
//   centre (0, R), its lowest point is the origin; cut at y = R and at the plane of symmetry x = 0
//
// R       radius
// h       size of the cells at the contact
// Zone    cells have this size up to this distance from the origin, then they grow
// Growth  how much the size of the cells grows per distance from this zone
// Arc     half the width of the arc that may come into contact, less than R
// Quad    0: triangles, 1: quadrilaterals
//
// Lengths may be in any unit.

DefineConstant[
  R = {1, Name "Radius"}
  h = {0.012, Name "Size of cells at the contact"}
  Zone = {0.15, Name "Radius of the zone of small cells"}
  Growth = {0.2, Name "Growth of cells"}
  Arc = {0.25, Name "Half width of the arc"}
  Quad = {0, Choices{0, 1}, Name "Quadrilaterals"}
];

Point(1) = {0, R, 0};
Point(2) = {0, 0, 0};
Point(3) = {Arc, R - Sqrt(R^2 - Arc^2), 0};
Point(4) = {R, R, 0};
Circle(1) = {2, 1, 3};
Circle(2) = {3, 1, 4};
Line(3) = {4, 1};
Line(4) = {1, 2};
Curve Loop(1) = {1 : 4};
Plane Surface(1) = {1};
If (Quad)
  Mesh.RecombinationAlgorithm = 3; // quadrilaterals only
  Recombine Surface{1};
EndIf

Physical Surface("cylinder", 1) = {1};
Physical Curve("contact", 11) = {1};
Physical Curve("cut", 12) = {3};
Physical Curve("symmetry", 13) = {4};

Field[1] = Distance;
Field[1].PointsList = {2};
Field[2] = MathEval;
Field[2].F = Sprintf("%g + %g*max(0, F1 - %g)", h, Growth, Zone);
Background Field = 2;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
