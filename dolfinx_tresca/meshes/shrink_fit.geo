// A quarter of the cross-section of a hollow shaft and of the ring that is shrunk on it.
//
//   y
//   |----___        ring, from Radius to Rim
//   |       `-.
//   |---_      \    shaft, from Bore to Radius + Interference
//   |    `.     \
//   '      |     |
//     Bore +-----+---- x
//
// Symmetry planes x = 0 and y = 0. The sides that touch have nodes of their own, and their divisions
// differ: the meshes do not match.
//
// N             cells round the quarter of the ring
// M             cells round the quarter of the shaft; better not a divisor or multiple of N
// Bore          inner radius of the shaft [mm]
// Radius        inner radius of the ring [mm]
// Rim           outer radius of the ring [mm]
// Interference  outer radius of the shaft minus Radius [mm]
//
// All lengths in millimetres.

DefineConstant[
  N = {16, Min 3, Max 400, Step 1, Name "Cells round the quarter of the ring"}
  M = {12, Min 2, Max 400, Step 1, Name "Cells round the quarter of the shaft"}
  Bore = {10, Name "Inner radius of the shaft [mm]"}
  Radius = {20, Name "Inner radius of the ring [mm]"}
  Rim = {40, Name "Outer radius of the ring [mm]"}
  Interference = {0.02, Name "Interference [mm]"}
];

centre = newp; Point(centre) = {0, 0, 0};

// A quarter of an annulus from `inner` to `outer`, with `cells` round it: arc[] are the inner and
// the outer one, side[] those on y = 0 and x = 0.
Macro Annulus
  p = newp;
  Point(p + 0) = {inner, 0, 0};
  Point(p + 1) = {outer, 0, 0};
  Point(p + 2) = {0, outer, 0};
  Point(p + 3) = {0, inner, 0};
  l = newl;
  Line(l + 0) = {p, p + 1};
  Circle(l + 1) = {p + 1, centre, p + 2};
  Line(l + 2) = {p + 3, p + 2};
  Circle(l + 3) = {p, centre, p + 3};
  // outwards the cells grow as the arcs do
  growth = outer / inner;
  layers = Max(2, Round(Log(growth) / (Pi / 2) * cells));
  Transfinite Curve{l, l + 2} = layers + 1 Using Progression growth^(1 / layers);
  Transfinite Curve{l + 1, l + 3} = cells + 1;
  loop = newcl; Curve Loop(loop) = {l, l + 1, -(l + 2), -(l + 3)};
  body = news; Plane Surface(body) = {loop};
  Transfinite Surface{body};
  Recombine Surface{body};
  arc[] = {l + 3, l + 1};
  side[] = {l, l + 2};
Return

inner = Radius; outer = Rim; cells = N;
Call Annulus;
Physical Surface("ring", 1) = {body};
Physical Curve("ring_contact", 11) = {arc[0]};
Physical Curve("rim", 12) = {arc[1]};
Physical Curve("ring_y", 13) = {side[0]};
Physical Curve("ring_x", 14) = {side[1]};

inner = Bore; outer = Radius + Interference; cells = M;
Call Annulus;
Physical Surface("shaft", 2) = {body};
Physical Curve("shaft_contact", 21) = {arc[1]};
Physical Curve("bore", 22) = {arc[0]};
Physical Curve("shaft_y", 23) = {side[0]};
Physical Curve("shaft_x", 24) = {side[1]};
