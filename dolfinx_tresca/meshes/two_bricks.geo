// Two elastic bricks, one on top of the other: the scene of the paper (section 38.5).
//
//   upper brick (0,2) x (0,1) x (1,2)   fixed at x = 2, pressed from above
//   lower brick (0,2) x (0,1) x (0,1)   fixed at x = 0
//
// N       cells along each brick's length (N >= 2); across it are N - 1, so that each brick has
//         N^3 nodes that are not fixed, and the contact N^2
// Hex     0: tetrahedra, 1: hexahedra
// Offset  initial distance between the bricks [m]
// Shift   the upper brick is moved by this along y [m]: then only a part of the faces overlaps
//
// All lengths in metres.

DefineConstant[
  N = {16, Min 2, Max 100, Step 1, Name "Cells along a brick"}
  Hex = {0, Choices{0, 1}, Name "Hexahedra"}
  Offset = {0, Name "Initial distance [m]"}
  Shift = {0, Name "Shift of the upper brick along y [m]"}
];

length = 2; width = 1; height = 1;

// A structured brick that shares no point with others. It is walked round from its fixed end, at
// x_fixed, to the free one, at x_free, so that each brick is the other one turned about the vertical
// and their tetrahedra are cut alike. faces[] = bottom, top, two sides, fixed end, free end.
Macro Brick
  p = newp;
  For k In {0:1}
    Point(p + 4*k + 0) = {x_fixed, y_first, z + k*height};
    Point(p + 4*k + 1) = {x_fixed, y_second, z + k*height};
    Point(p + 4*k + 2) = {x_free, y_second, z + k*height};
    Point(p + 4*k + 3) = {x_free, y_first, z + k*height};
  EndFor
  l = newl;
  For k In {0:1}
    Line(l + 4*k + 0) = {p + 4*k + 0, p + 4*k + 1};
    Line(l + 4*k + 1) = {p + 4*k + 1, p + 4*k + 2};
    Line(l + 4*k + 2) = {p + 4*k + 2, p + 4*k + 3};
    Line(l + 4*k + 3) = {p + 4*k + 3, p + 4*k + 0};
  EndFor
  For j In {0:3}
    Line(l + 8 + j) = {p + j, p + 4 + j};
  EndFor
  Transfinite Curve{l + 1, l + 3, l + 5, l + 7} = N + 1;
  Transfinite Curve{l, l + 2, l + 4, l + 6, l + 8, l + 9, l + 10, l + 11} = N;

  c = newcl;
  Curve Loop(c + 0) = {l, l + 1, l + 2, l + 3};
  Curve Loop(c + 1) = {l + 4, l + 5, l + 6, l + 7};
  Curve Loop(c + 2) = {l + 3, l + 8, -(l + 7), -(l + 11)};
  Curve Loop(c + 3) = {l + 1, l + 10, -(l + 5), -(l + 9)};
  Curve Loop(c + 4) = {l, l + 9, -(l + 4), -(l + 8)};
  Curve Loop(c + 5) = {l + 2, l + 11, -(l + 6), -(l + 10)};
  s = news;
  For j In {0:5}
    Plane Surface(s + j) = {c + j};
    faces[j] = s + j;
  EndFor
  // the diagonals of opposite faces must run alike to be those of the tetrahedra
  Transfinite Surface{s, s + 1, s + 3, s + 4};
  Transfinite Surface{s + 2, s + 5} Right;
  If (Hex)
    Recombine Surface{s : s + 5};
  EndIf
  shell = newsl;
  Surface Loop(shell) = {s : s + 5};
  body = newv;
  Volume(body) = {shell};
  Transfinite Volume{body};
Return

z = 0; x_fixed = 0; x_free = length; y_first = width; y_second = 0;
Call Brick;
Physical Volume("lower", 1) = {body};
Physical Surface("lower_fixed", 11) = {faces[4]};
Physical Surface("lower_contact", 12) = {faces[1]};
Physical Surface("lower_free_end", 13) = {faces[5]};

z = height + Offset; x_fixed = length; x_free = 0; y_first = Shift; y_second = width + Shift;
Call Brick;
Physical Volume("upper", 2) = {body};
Physical Surface("upper_fixed", 21) = {faces[4]};
Physical Surface("upper_contact", 22) = {faces[0]};
Physical Surface("upper_free_end", 23) = {faces[5]};
Physical Surface("upper_top", 24) = {faces[1]};
