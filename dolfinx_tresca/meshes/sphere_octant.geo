// An octant of an elastic ball, or two of them that face each other: Hertz contact.
//
//   upper  centre (0, 0, R), its lowest point is the origin; cut at z = R
//   lower  centre (0, 0, -R_lower), its highest point is the origin; cut at z = -R_lower
//
// Both are cut by the planes of symmetry x = 0 and y = 0 as well. The bodies share no point. Around
// the origin a block (0, Zone) x (0, Zone), as high as wide, is filled with a regular grid of
// tetrahedra: pressures are as smooth as meshes are regular. Elsewhere cells grow with distance.
//
// Bodies   1: the upper one, 2: both
// R        radius of the upper ball
// R_lower  radius of the lower ball
// h        size of the cells of the upper ball at the contact
// h_lower  size of the cells of the lower ball at the contact
// Zone     width of the block, and of the surface that may come into contact; at most half of R
//          and of R_lower
// Growth   how much the size of the cells grows per distance from the block
//
// Lengths may be in any unit.

DefineConstant[
  Bodies = {1, Choices{1, 2}, Name "Number of bodies"}
  R = {1, Name "Radius of the upper ball"}
  R_lower = {1, Name "Radius of the lower ball"}
  h = {0.012, Name "Size of cells at the contact"}
  h_lower = {0.015, Name "Size of cells at the contact, lower ball"}
  Zone = {0.17, Name "Width of the zone of small cells"}
  Growth = {0.3, Name "Growth of cells"}
];

// An octant with its pole at the origin and its centre at (0, 0, side*radius).
Macro Octant
  middle = side*radius;
  edge = middle - side*Sqrt(radius^2 - Zone^2);
  corner = middle - side*Sqrt(radius^2 - 2*Zone^2);
  diagonal = radius/Sqrt(2);
  cells = Ceil(Zone/cell);

  // the block: corners 0 to 3 on the sphere, 4 to 7 inside. With the pole as number 2 the
  // diagonals of the tetrahedra disturb the pressures at the planes of symmetry least.
  p = newp;
  Point(p + 0) = {Zone, Zone, corner};
  Point(p + 1) = {0, Zone, edge};
  Point(p + 2) = {0, 0, 0};
  Point(p + 3) = {Zone, 0, edge};
  Point(p + 4) = {Zone, Zone, side*Zone};
  Point(p + 5) = {0, Zone, side*Zone};
  Point(p + 6) = {0, 0, side*Zone};
  Point(p + 7) = {Zone, 0, side*Zone};
  // the cut, and centres of arcs
  Point(p + 8) = {0, 0, middle};
  Point(p + 9) = {radius, 0, middle};
  Point(p + 10) = {diagonal, diagonal, middle};
  Point(p + 11) = {0, radius, middle};
  Point(p + 12) = {Zone, 0, middle};
  Point(p + 13) = {0, Zone, middle};

  l = newl;
  Circle(l + 0) = {p + 0, p + 13, p + 1};
  Circle(l + 1) = {p + 1, p + 8, p + 2};
  Circle(l + 2) = {p + 2, p + 8, p + 3};
  Circle(l + 3) = {p + 3, p + 12, p + 0};
  For j In {0:3}
    Line(l + 4 + j) = {p + 4 + j, p + 4 + (j + 1) % 4};
    Line(l + 8 + j) = {p + j, p + 4 + j};
  EndFor
  Transfinite Curve{l : l + 11} = cells + 1;
  Circle(l + 12) = {p + 3, p + 8, p + 9};
  Circle(l + 13) = {p + 0, p + 8, p + 10};
  Circle(l + 14) = {p + 1, p + 8, p + 11};
  Circle(l + 15) = {p + 9, p + 8, p + 10};
  Circle(l + 16) = {p + 10, p + 8, p + 11};
  Line(l + 17) = {p + 6, p + 8};
  Line(l + 18) = {p + 8, p + 9};
  Line(l + 19) = {p + 8, p + 11};

  // 0 to 5: the block, on the sphere, its top, x = Zone, x = 0, y = Zone, y = 0
  c = newcl;
  Curve Loop(c + 0) = {l, l + 1, l + 2, l + 3};
  Curve Loop(c + 1) = {l + 4, l + 5, l + 6, l + 7};
  Curve Loop(c + 2) = {l + 3, l + 8, -(l + 7), -(l + 11)};
  Curve Loop(c + 3) = {l + 1, l + 10, -(l + 5), -(l + 9)};
  Curve Loop(c + 4) = {l, l + 9, -(l + 4), -(l + 8)};
  Curve Loop(c + 5) = {l + 2, l + 11, -(l + 6), -(l + 10)};
  // 6 to 10: the rest, on the sphere, on the sphere, the cut, x = 0, y = 0
  Curve Loop(c + 6) = {l + 12, l + 15, -(l + 13), -(l + 3)};
  Curve Loop(c + 7) = {l + 13, l + 16, -(l + 14), -l};
  Curve Loop(c + 8) = {l + 18, l + 15, l + 16, -(l + 19)};
  Curve Loop(c + 9) = {l + 17, l + 19, -(l + 14), l + 9, l + 5};
  Curve Loop(c + 10) = {l + 17, l + 18, -(l + 12), l + 11, -(l + 6)};
  s = news;
  Surface(s) = {c} In Sphere {p + 8};
  For j In {1:5}
    Plane Surface(s + j) = {c + j};
  EndFor
  Surface(s + 6) = {c + 6} In Sphere {p + 8};
  Surface(s + 7) = {c + 7} In Sphere {p + 8};
  For j In {8:10}
    Plane Surface(s + j) = {c + j};
  EndFor
  // the diagonals of opposite faces must run alike to be those of the tetrahedra
  Transfinite Surface{s, s + 1, s + 3, s + 4};
  Transfinite Surface{s + 2, s + 5} Right;

  shell = newsl;
  Surface Loop(shell) = {s : s + 5};
  Surface Loop(shell + 1) = {s + 1, s + 2, s + 4, s + 6, s + 7, s + 8, s + 9, s + 10};
  body = newv;
  Volume(body) = {shell};
  Volume(body + 1) = {shell + 1};
  Transfinite Volume{body};

  near = newf;
  Field[near] = MathEval;
  Field[near].F = Sprintf("%g + %g*max(0, max(max(x, y), abs(z)) - %g)", cell, Growth, Zone);
  here = newf;
  Field[here] = Restrict;
  Field[here].InField = near;
  Field[here].VolumesList = {body + 1};
  Field[here].IncludeBoundary = 1;
  sizes[] += {here};
Return

sizes[] = {};
side = 1; radius = R; cell = h;
Call Octant;
Physical Volume("upper", 1) = {body, body + 1};
Physical Surface("upper_contact", 11) = {s};
Physical Surface("upper_cut", 12) = {s + 8};
Physical Surface("upper_x", 13) = {s + 3, s + 9};
Physical Surface("upper_y", 14) = {s + 5, s + 10};
Physical Surface("upper_free", 15) = {s + 6, s + 7};

If (Bodies == 2)
  side = -1; radius = R_lower; cell = h_lower;
  Call Octant;
  Physical Volume("lower", 2) = {body, body + 1};
  Physical Surface("lower_contact", 21) = {s};
  Physical Surface("lower_cut", 22) = {s + 8};
  Physical Surface("lower_x", 23) = {s + 3, s + 9};
  Physical Surface("lower_y", 24) = {s + 5, s + 10};
  Physical Surface("lower_free", 25) = {s + 6, s + 7};
EndIf

smallest = newf;
Field[smallest] = Min;
Field[smallest].FieldsList = {sizes[]};
Background Field = smallest;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
