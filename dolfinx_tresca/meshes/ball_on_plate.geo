// Half of an elastic ball on half of an elastic plate, for loads in the plane y = 0: fretting.
//
//   ball   centre (0, 0, R), its lowest point is the origin; cut at z = R
//   plate  -R < x < R, y < R, -R < z < 0
//
// Both are cut by the plane of symmetry y = 0. The bodies share no point, and their meshes do not
// match. Within Zone of the origin cells have the size h; elsewhere they grow with distance.
//
// R       radius of the ball
// h       size of the cells at the contact
// Zone    radius of the surfaces that may come into contact, and of the zone of small cells
// Growth  how much the size of the cells grows per distance from the zone
//
// Lengths may be in any unit.

DefineConstant[
  R = {5, Name "Radius of the ball"}
  h = {0.0125, Name "Size of cells at the contact"}
  Zone = {0.13, Name "Radius of the zone of small cells"}
  Growth = {0.3, Name "Growth of cells"}
];

SetFactory("OpenCASCADE");
Geometry.OCCBoundsUseStl = 1; // tight boxes

Sphere(1) = {0, 0, R, R};
Rotate {{1, 0, 0}, {0, 0, R}, Pi/2} { Volume{1}; } // no pole of its coordinates in the contact
Box(2) = {-R, 0, 0, 2*R, R, R};
BooleanIntersection(3) = { Volume{1}; Delete; }{ Volume{2}; Delete; };
Box(4) = {-R, 0, -R, 2*R, R, R};

// a cylinder cuts off what may come into contact
Cylinder(5) = {0, 0, -Zone, 0, 0, 2*Zone, Zone, Pi};
BooleanIntersection(6) = { Volume{3}; }{ Volume{5}; };
BooleanIntersection(7) = { Volume{4}; }{ Volume{5}; Delete; };
ball() = BooleanFragments{ Volume{3}; Delete; }{ Volume{6}; Delete; };
plate() = BooleanFragments{ Volume{4}; Delete; }{ Volume{7}; Delete; };

e = 1e-3*Zone;
depth = R - Sqrt(R^2 - Zone^2); // of the cap
flat() = Surface In BoundingBox {-Zone - e, -e, -e, Zone + e, Zone + e, e};
cap() = Surface In BoundingBox {-Zone - e, -e, -e, Zone + e, Zone + e, depth + e};
cap() -= flat();
cut() = Surface In BoundingBox {-R - e, -e, R - e, R + e, R + e, R + e};
bottom() = Surface In BoundingBox {-R - e, -e, -R - e, R + e, R + e, -R + e};
middle() = Surface In BoundingBox {-R - e, -e, -R - e, R + e, e, R + e};
Physical Volume("ball", 1) = {ball()};
Physical Surface("ball_contact", 11) = {cap()};
Physical Surface("ball_cut", 12) = {cut()};
Physical Volume("plate", 2) = {plate()};
Physical Surface("plate_contact", 21) = {flat()};
Physical Surface("plate_bottom", 22) = {bottom()};
Physical Surface("symmetry", 3) = {middle()};

Field[1] = MathEval;
Field[1].F = Sprintf("%g + %g*max(0, sqrt(x^2 + y^2 + z^2) - %g)", h, Growth, Zone);
Background Field = 1;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
Mesh.Algorithm = 6; // the most even triangles; pressures are as smooth as meshes are even
