// An elastic block, its bottom centred on the origin: something to press on an obstacle.
//
//   (-Lx/2, Lx/2) x (-Ly/2, Ly/2) x (0, Lz)
//
// N        cells along x; along y so many that cells are about square
// Grading  height of each layer of cells divided by the height of the layer below; the lowest cells
//          are about cubes
// Hex      0: tetrahedra, 1: hexahedra
//
// Lengths may be in any unit.

DefineConstant[
  N = {24, Min 1, Max 100, Step 1, Name "Cells along the block"}
  Grading = {1, Min 1, Name "Growth of the height of cells"}
  Hex = {0, Choices{0, 1}, Name "Hexahedra"}
  Lx = {2, Name "Length along x"}
  Ly = {2, Name "Width along y"}
  Lz = {1, Name "Height along z"}
];

cell = Lx/N;
N_y = Max(1, Round(Ly/cell));
N_z = Max(1, Round(Lz/cell));
If (Grading > 1)
  N_z = Max(1, Round(Log(1 + Lz/cell*(Grading - 1))/Log(Grading)));
EndIf
// how many cells each layer has, and where it ends, as a fraction of Lz
layers[] = {};
ends[] = {};
For k In {1:N_z}
  layers[] += {1};
  If (Grading > 1)
    ends[] += {(Grading^k - 1)/(Grading^N_z - 1)};
  Else
    ends[] += {k/N_z};
  EndIf
EndFor

Point(1) = {-Lx/2, -Ly/2, 0};
Point(2) = {Lx/2, -Ly/2, 0};
Point(3) = {Lx/2, Ly/2, 0};
Point(4) = {-Lx/2, Ly/2, 0};
For i In {1:4}
  Line(i) = {i, i % 4 + 1};
EndFor
Transfinite Curve{1, 3} = N + 1;
Transfinite Curve{2, 4} = N_y + 1;
Curve Loop(1) = {1 : 4};
Plane Surface(1) = {1};
Transfinite Surface{1} Alternate;
If (Hex)
  Recombine Surface{1};
  block[] = Extrude {0, 0, Lz} { Surface{1}; Layers{layers[], ends[]}; Recombine; };
Else
  block[] = Extrude {0, 0, Lz} { Surface{1}; Layers{layers[], ends[]}; };
EndIf

// block[] = top, volume, four sides
Physical Volume("block", 1) = {block[1]};
Physical Surface("bottom", 11) = {1};
Physical Surface("top", 12) = {block[0]};
Physical Surface("sides", 13) = {block[{2 : 5}]};
