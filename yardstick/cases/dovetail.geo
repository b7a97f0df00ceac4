// Half of a blade's root in a dovetail slot. Flanks of 45 degrees lie on each other; they begin and
// end at other places, so that both have kinks inside the other one.
//
// h  size of the cells [mm]

DefineConstant[ h = {0.8, Min 0.1, Max 3, Step 0.1, Name "Size of the cells [mm]"} ];

Point(1) = {0, 0, 0}; Point(2) = {10, 0, 0}; Point(3) = {10, 4, 0}; Point(4) = {4, 10, 0};
Point(5) = {4, 25, 0}; Point(6) = {0, 25, 0};
Point(7) = {10.5, -5, 0}; Point(8) = {30, -5, 0}; Point(9) = {30, 12, 0}; Point(10) = {4.3, 12, 0};
Point(11) = {4.3, 9.7, 0}; Point(12) = {10.5, 3.5, 0};
For i In {0:1}
  For j In {1:5}
    Line(6 * i + j) = {6 * i + j, 6 * i + j + 1};
  EndFor
  Line(6 * i + 6) = {6 * i + 6, 6 * i + 1};
  Curve Loop(i + 1) = {6 * i + 1 : 6 * i + 6}; Plane Surface(i + 1) = {i + 1};
EndFor
Physical Surface("blade") = {1}; Physical Surface("disc") = {2};
Physical Curve("root") = {1:4}; Physical Curve("top") = {5}; Physical Curve("axis") = {6};
Physical Curve("slot") = {7, 9:12}; Physical Curve("outer") = {8};
Mesh.MeshSizeMax = h; Mesh.MeshSizeMin = h / 2;
