// A small crane that stands on a layer of clay: foot, post and arm in one, and nothing glues it to
// the ground.
//
//                     +----+------------------+
//                     |        arm            |
//                     |    +------------------+     z = Foot + Post
//                     |post|
//                     |    |
//                +----+    +----+                   z = Foot
//                |     foot     |
//     +----------+--------------+----------+        z = 0
//     |                clay                |
//     +------------------------------------+        z = -Depth
//
// The middle of the foot's bottom is the origin; the arm is along x. All cells are bricks, or
// tetrahedra.
//
// N      cells along the foot; along x and y the post has about N*Thick/Side
// M      cells along the clay. The mesh of the clay shall not match that of the foot, and shall be a
//        little finer, since the clay is softer
// Hex    0: tetrahedra, 1: bricks. For tetrahedra take an odd M: Gmsh cuts bricks into them, and then
//        makes one node of any two in the same place, which would glue the foot to the clay
// Growth height of each layer of cells in the clay divided by the height of the layer above
//
// Lengths may be in any unit.

DefineConstant[
  N = {16, Min 4, Max 100, Step 1, Name "Cells along the foot"}
  M = {36, Min 4, Max 100, Step 1, Name "Cells along the clay"}
  Hex = {1, Choices{0, 1}, Name "Bricks"}
  Growth = {1.4, Min 1, Name "Growth of the height of cells in the clay"}
  Side = {2, Name "Length and width of the foot"}
  Foot = {0.5, Name "Height of the foot"}
  Thick = {0.5, Name "Thickness of post and arm"}
  Post = {1.5, Name "Height of the post below the arm"}
  Arm = {2.25, Name "How far the arm sticks out of the post"}
  Width = {4, Name "Length and width of the clay"}
  Depth = {1.2, Name "Depth of the clay"}
];

cell = Side/N;

// The bottom of the foot: three by three rectangles, the middle one below the post.
cut[] = {-Side/2, -Thick/2, Thick/2, Side/2};
count[] = {};
For i In {0:2}
  count[] += Max(1, Round((cut[i + 1] - cut[i])/cell));
EndFor
For j In {0:3}
  For i In {0:3}
    Point(1 + i + 4*j) = {cut[i], cut[j], 0};
  EndFor
EndFor
For j In {0:3}
  For i In {0:2}
    Line(1 + i + 3*j) = {1 + i + 4*j, 2 + i + 4*j};     // along x
    Transfinite Curve{1 + i + 3*j} = count[i] + 1;
    Line(21 + i + 3*j) = {1 + j + 4*i, 1 + j + 4*(i + 1)};  // along y
    Transfinite Curve{21 + i + 3*j} = count[i] + 1;
  EndFor
EndFor
For j In {0:2}
  For i In {0:2}
    Curve Loop(1 + i + 3*j) = {1 + i + 3*j, 21 + j + 3*(i + 1), -(4 + i + 3*j), -(21 + j + 3*i)};
    Plane Surface(1 + i + 3*j) = {1 + i + 3*j};
  EndFor
EndFor
Transfinite Surface{1:9};
If (Hex)
  Recombine Surface{1:9};
EndIf

// Each extrusion returns the new end, the volume, and the sides: at small y, large x, large y, small x.
crane[] = {};
pulled[] = {};
For k In {1:9}
  If (Hex)
    part[] = Extrude {0, 0, Foot} { Surface{k}; Layers{Max(1, Round(Foot/cell))}; Recombine; };
  Else
    part[] = Extrude {0, 0, Foot} { Surface{k}; Layers{Max(1, Round(Foot/cell))}; };
  EndIf
  crane[] += part[1];
  If (k == 5)
    middle = part[0];
  EndIf
  If (k >= 7)
    pulled[] += part[4];
  EndIf
EndFor
If (Hex)
  post[] = Extrude {0, 0, Post} { Surface{middle}; Layers{Max(1, Round(Post/cell))}; Recombine; };
  head[] = Extrude {0, 0, Thick} { Surface{post[0]}; Layers{Max(1, Round(Thick/cell))}; Recombine; };
  arm[] = Extrude {Arm, 0, 0} { Surface{head[3]}; Layers{Max(1, Round(Arm/cell))}; Recombine; };
Else
  post[] = Extrude {0, 0, Post} { Surface{middle}; Layers{Max(1, Round(Post/cell))}; };
  head[] = Extrude {0, 0, Thick} { Surface{post[0]}; Layers{Max(1, Round(Thick/cell))}; };
  arm[] = Extrude {Arm, 0, 0} { Surface{head[3]}; Layers{Max(1, Round(Arm/cell))}; };
EndIf
crane[] += {post[1], head[1], arm[1]};

// The clay, from its top downwards: where its layers of cells end, as a fraction of the depth.
layers = Max(1, Round(Depth*M/Width));
If (Growth > 1)
  layers = Max(1, Round(Log(1 + Depth*M/Width*(Growth - 1))/Log(Growth)));
EndIf
ones[] = {};
ends[] = {};
For k In {1:layers}
  ones[] += {1};
  If (Growth > 1)
    ends[] += {(Growth^k - 1)/(Growth^layers - 1)};
  Else
    ends[] += {k/layers};
  EndIf
EndFor
p = newp;
Point(p) = {-Width/2, -Width/2, 0};
Point(p + 1) = {Width/2, -Width/2, 0};
Point(p + 2) = {Width/2, Width/2, 0};
Point(p + 3) = {-Width/2, Width/2, 0};
l = newl;
For i In {0:3}
  Line(l + i) = {p + i, p + (i + 1) % 4};
EndFor
Transfinite Curve{l : l + 3} = M + 1;
c = newcl;
Curve Loop(c) = {l : l + 3};
s = news;
Plane Surface(s) = {c};
Transfinite Surface{s};
If (Hex)
  Recombine Surface{s};
EndIf
If (Hex)
  clay[] = Extrude {0, 0, -Depth} { Surface{s}; Layers{ones[], ends[]}; Recombine; };
Else
  clay[] = Extrude {0, 0, -Depth} { Surface{s}; Layers{ones[], ends[]}; };
EndIf

Physical Volume("clay", 1) = {clay[1]};
Physical Surface("clay_contact", 11) = {s};
Physical Surface("clay_fixed", 12) = {clay[0]};
Physical Volume("crane", 2) = {crane[]};
Physical Surface("foot_contact", 21) = {1:9};
Physical Surface("foot_pulled", 22) = {pulled[]}; // the side at large y
Physical Surface("arm_top", 23) = {arm[4]};
