// A tapered stem in a block of bone, as after the replacement of a hip: one half, y > 0.
//
//                       ___ joint
//                      /  /
//                     |  |    neck, bent to x > 0
//      +-----------+--+  +-+-----------+     z = 0
//      |            \      /           |
//      |             \stem/            |
//      |   bone       |  |             |
//      |              +--+             |     z = -Inserted
//      |              |__|    the hole goes on below the tip
//      |                               |
//      +-------------------------------+     z = -Depth
//
// The stem is an elliptic cone; the hole is made with a thinner cone: at the top thinner
// by the interference, and less and less towards the tip, which fits exactly. Nothing glues the
// two bodies, so each has surfaces and nodes of its own.
//
// N             cells round the half hole
// M             cells round the half stem; better not a divisor or multiple of N
// Growth        how much the cells of the bone grow per distance from the stem
// Inserted      length of the stem in the bone [mm]
// Shoulder      half the width of the stem at its top, along x [mm]
// Tip           half the width of the stem at its tip, along x [mm]
// Flat          width of the stem along y divided by its width along x
// Interference  half the width of the stem minus half the width of the hole, at the top along x [mm]
// Width         width of the block along x [mm]; this half of the block is half as wide along y
// Depth         depth of the block [mm]
//
// All lengths in millimetres.

SetFactory("OpenCASCADE");

DefineConstant[
  N = {20, Min 4, Max 200, Step 1, Name "Cells round the half hole"}
  M = {16, Min 4, Max 200, Step 1, Name "Cells round the half stem"}
  Growth = {0.35, Name "Growth of the cells of the bone"}
  Inserted = {50, Name "Length of the stem in the bone [mm]"}
  Shoulder = {8, Name "Half the width of the stem at its top [mm]"}
  Tip = {5, Name "Half the width of the stem at its tip [mm]"}
  Flat = {0.85, Name "Width along y over width along x"}
  Interference = {0.04, Name "Interference [mm]"}
  Width = {50, Name "Width of the block [mm]"}
  Depth = {65, Name "Depth of the block [mm]"}
];

clearance = 3;         // of the hole below the tip
neck = 0.6*Shoulder;   // radius
bend = 22;             // radius of the axis of the neck
angle = 40*Pi/180;     // of the end of the neck
eps = 1e-3*Shoulder;

// The stem: cone and neck in one.
stem = newv;
Cone(stem) = {0, 0, -Inserted, 0, 0, Inserted, Tip, Shoulder};
Dilate {{0, 0, 0}, {1, Flat, 1}} { Volume{stem}; }
disk = news;
Disk(disk) = {0, 0, 0, neck};
Dilate {{0, 0, 0}, {1, Flat, 1}} { Surface{disk}; }
out[] = Extrude { {0, 1, 0}, {bend, 0, 0}, angle } { Surface{disk}; };
Recursive Delete { Surface{disk}; }
united[] = BooleanUnion{ Volume{stem}; Delete; }{ Volume{out[1]}; Delete; };

// The hole: a cone, and its continuation below the tip, as two tools, so that the face of the hole
// that meets the stem ends where the stem ends.
slope = (Shoulder - Interference - Tip)/Inserted;
tool = newv;
Cone(tool) = {0, 0, -Inserted, 0, 0, Inserted, Tip, Shoulder - Interference};
below = newv;
Cone(below) = {0, 0, -Inserted - clearance, 0, 0, clearance, Tip - slope*clearance, Tip};
Dilate {{0, 0, 0}, {1, Flat, 1}} { Volume{tool, below}; }
block = newv;
Box(block) = {-Width/2, 0, -Depth, Width, Width/2, Depth};
// one after the other: both at once, with the face that they share, takes ten times as long
bone[] = BooleanDifference{ Volume{block}; Delete; }{ Volume{tool}; Delete; };
bone[] = BooleanDifference{ Volume{bone[]}; Delete; }{ Volume{below}; Delete; };

half = newv;
Box(half) = {-Width, 0, -Depth, 2*Width, Width, 2*Depth};
halved[] = BooleanIntersection{ Volume{united[]}; Delete; }{ Volume{half}; Delete; };

// Which face is which: by the box round it, xmin, ymin, zmin, xmax, ymax, zmax. The contact gets a
// regular mesh, `round` cells round it and `along` cells along it: its normals are better for it.
Macro Sort
  contact[] = {}; plane[] = {}; bottom[] = {}; joint[] = {};
  faces[] = Abs(Boundary{ Volume{body}; });
  For i In {0 : #faces[] - 1}
    b[] = BoundingBox Surface{faces[i]};
    If (b[4] < eps)
      plane[] += {faces[i]};
    ElseIf (Abs(b[2] + Inserted) < eps && Abs(b[5]) < eps)
      contact[] += {faces[i]};
    ElseIf (b[5] < eps - Depth)
      bottom[] += {faces[i]};
    ElseIf (b[2] > eps)
      joint[] += {faces[i]};
    EndIf
  EndFor
  edges[] = Abs(Boundary{ Surface{contact[0]}; });
  For i In {0 : #edges[] - 1}
    b[] = BoundingBox Curve{edges[i]};
    If (b[5] - b[2] < eps)
      Transfinite Curve{edges[i]} = round + 1;
    Else
      Transfinite Curve{edges[i]} = along + 1;
    EndIf
  EndFor
  Transfinite Surface{contact[0]} Alternate;
Return

// Half the perimeter of the stem in the middle, and so the size of the cells there.
middle = 0.5*(Shoulder + Tip);
perimeter = Pi*Sqrt(0.5*(1 + Flat^2))*middle;
stretch = 1.4;  // of the cells along the stem

body = bone[0];
size = perimeter/N; round = N; along = Ceil(Inserted/(stretch*size));
Call Sort;
Physical Volume("bone", 1) = {body};
Physical Surface("bone_contact", 11) = {contact[]};
Physical Surface("bone_symmetry", 12) = {plane[]};
Physical Surface("bone_fixed", 13) = {bottom[]};

near = newf;
Field[near] = Distance;
Field[near].SurfacesList = {contact[]};
Field[near].Sampling = 40;
grown = newf;
Field[grown] = MathEval;
Field[grown].F = Sprintf("%g + %g*F%g", size, Growth, near);
in_bone = newf;
Field[in_bone] = Restrict;
Field[in_bone].InField = grown;
Field[in_bone].VolumesList = {body};
Field[in_bone].IncludeBoundary = 1;

body = halved[0];
size = perimeter/M; round = M; along = Ceil(Inserted/(stretch*size));
Call Sort;
Physical Volume("stem", 2) = {body};
Physical Surface("stem_contact", 21) = {contact[]};
Physical Surface("stem_symmetry", 22) = {plane[]};
Physical Surface("stem_joint", 23) = {joint[]};

in_stem = newf;
Field[in_stem] = Constant;
Field[in_stem].VIn = size;
Field[in_stem].VolumesList = {body};
Field[in_stem].IncludeBoundary = 1;

smallest = newf;
Field[smallest] = Min;
Field[smallest].FieldsList = {in_bone, in_stem};
Background Field = smallest;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
Mesh.Optimize = 1;
