// A quarter of a pin that is pressed into the hole of a round plate, and too thick for it.
//
//              +-----+
//              | pin |                     z = Thickness + Overhang
//     +--------+     |
//     |  plate |     |                     z = Thickness
//     |        |     |
//     +--------+     |                     z = 0
//              |     |
//              +-----+                     z = -Overhang
//                    x = 0
//
// Symmetry planes x = 0 and y = 0; the axis of the pin is z. The surfaces that touch have nodes of
// their own, and their divisions differ: the meshes do not match.
//
// N             cells round a quarter of the hole
// M             cells round a quarter of the pin; even, and better not a divisor or multiple of N
// Hex           0: tetrahedra, 1: hexahedra
// Radius        radius of the hole [mm]
// Rim           outer radius of the plate [mm]
// Support       the bottom of the plate rests on a ring from here to the rim [mm]
// Thickness     thickness of the plate [mm]
// Overhang      length of the pin on either side of the plate [mm]
// Interference  radius of the pin minus radius of the hole [mm]
//
// All lengths in millimetres.

DefineConstant[
  N = {16, Min 3, Max 200, Step 1, Name "Cells round a quarter of the hole"}
  M = {12, Min 2, Max 200, Step 2, Name "Cells round a quarter of the pin"}
  Hex = {1, Choices{0, 1}, Name "Hexahedra"}
  Radius = {10, Name "Radius of the hole [mm]"}
  Rim = {30, Name "Outer radius of the plate [mm]"}
  Support = {20, Name "Inner radius of the support [mm]"}
  Thickness = {16, Name "Thickness of the plate [mm]"}
  Overhang = {6, Name "Length of the pin on either side of the plate [mm]"}
  Interference = {0.01, Name "Interference [mm]"}
];

// Along the axis the cells are about as long as they are round the contact.
layers = Ceil(Thickness / (Pi / 2 * Radius / N));
layers_pin = Ceil((Thickness + 2 * Overhang) / (Pi / 2 * Radius / M));

// Extrudes the surfaces base[] to the given height; body[] are the volumes, side[] the faces that
// curve number `edge` of the first surface, or of the first two, leaves behind.
Macro Raise
  body[] = {}; top[] = {};
  For i In {0 : #base[] - 1}
    If (Hex)
      Recombine Surface{base[i]};
      out[] = Extrude {0, 0, height} { Surface{base[i]}; Layers{cells}; Recombine; };
    Else
      out[] = Extrude {0, 0, height} { Surface{base[i]}; Layers{cells}; };
    EndIf
    top[i] = out[0];
    body[i] = out[1];
    For j In {0:3}
      face[4*i + j] = out[2 + j];
    EndFor
  EndFor
Return

// The plate: two rings, of which the outer one is supported.
centre = newp; Point(centre) = {0, 0, 0};
radii[] = {Radius, Support, Rim};
For i In {0:2}
  on_x[i] = newp; Point(on_x[i]) = {radii[i], 0, 0};
  on_y[i] = newp; Point(on_y[i]) = {0, radii[i], 0};
  arc[i] = newl; Circle(arc[i]) = {on_x[i], centre, on_y[i]};
  Transfinite Curve{arc[i]} = N + 1;
EndFor
base[] = {};
For i In {0:1}
  along_x = newl; Line(along_x) = {on_x[i], on_x[i + 1]};
  along_y = newl; Line(along_y) = {on_y[i], on_y[i + 1]};
  // outwards the cells grow as the arcs do
  growth = radii[i + 1] / radii[i];
  cells = Max(2, Round(Log(growth) / (Pi / 2) * N));
  Transfinite Curve{along_x, along_y} = cells + 1 Using Progression growth^(1 / cells);
  loop = newcl; Curve Loop(loop) = {along_x, arc[i + 1], -along_y, -arc[i]};
  base[i] = news; Plane Surface(base[i]) = {loop};
  Transfinite Surface{base[i]};
EndFor
height = Thickness; cells = layers;
Call Raise;
Physical Volume("plate", 1) = {body[]};
Physical Surface("plate_contact", 11) = {face[3]};
Physical Surface("plate_support", 12) = {base[1]};
Physical Surface("plate_x", 13) = {face[2], face[6]};
Physical Surface("plate_y", 14) = {face[0], face[4]};

// The pin: a square core, and two blocks between it and the circle.
radius = Radius + Interference;
core = 0.5 * radius; corner = 0.4 * radius; diagonal = radius * Sqrt(0.5);
p = newp;
Point(p + 0) = {0, 0, -Overhang};
Point(p + 1) = {core, 0, -Overhang};
Point(p + 2) = {corner, corner, -Overhang};
Point(p + 3) = {0, core, -Overhang};
Point(p + 4) = {radius, 0, -Overhang};
Point(p + 5) = {diagonal, diagonal, -Overhang};
Point(p + 6) = {0, radius, -Overhang};
l = newl;
Line(l + 0) = {p, p + 1};
Line(l + 1) = {p + 1, p + 2};
Line(l + 2) = {p + 2, p + 3};
Line(l + 3) = {p + 3, p};
Line(l + 4) = {p + 1, p + 4};
Line(l + 5) = {p + 2, p + 5};
Line(l + 6) = {p + 3, p + 6};
Circle(l + 7) = {p + 4, p, p + 5};
Circle(l + 8) = {p + 5, p, p + 6};
Transfinite Curve{l, l + 1, l + 2, l + 3, l + 7, l + 8} = M / 2 + 1;
Transfinite Curve{l + 4, l + 5, l + 6} = Max(2, Round(M / 3)) + 1;
c = newcl;
Curve Loop(c + 0) = {l, l + 1, l + 2, l + 3};
Curve Loop(c + 1) = {l + 4, l + 7, -(l + 5), -(l + 1)};
Curve Loop(c + 2) = {l + 5, l + 8, -(l + 6), -(l + 2)};
s = news;
For j In {0:2}
  Plane Surface(s + j) = {c + j};
  Transfinite Surface{s + j};
EndFor
base[] = {s : s + 2};
height = Thickness + 2 * Overhang; cells = layers_pin;
Call Raise;
Physical Volume("pin", 2) = {body[]};
Physical Surface("pin_contact", 21) = {face[5], face[9]};
Physical Surface("pin_top", 22) = {top[]};
Physical Surface("pin_x", 23) = {face[3], face[10]};
Physical Surface("pin_y", 24) = {face[0], face[4]};
