// The meridian of a shaft and of a hub with the same taper of 3 degrees; x is the radius.
//
// h  size of the cells [mm]

DefineConstant[ h = {1, Min 0.1, Max 5, Step 0.1, Name "Size of the cells [mm]"} ];

slope = Tan(3 * Pi / 180);
Point(1) = {2, -5, 0}; Point(2) = {10 + 5 * slope, -5, 0};
Point(3) = {10 - 35 * slope, 35, 0}; Point(4) = {2, 35, 0};
Point(5) = {10, 0, 0}; Point(6) = {20, 0, 0}; Point(7) = {20, 30, 0}; Point(8) = {10 - 30 * slope, 30, 0};
For i In {0:1}
  For j In {1:3}
    Line(4 * i + j) = {4 * i + j, 4 * i + j + 1};
  EndFor
  Line(4 * i + 4) = {4 * i + 4, 4 * i + 1};
  Curve Loop(i + 1) = {4 * i + 1 : 4 * i + 4}; Plane Surface(i + 1) = {i + 1};
EndFor
Physical Surface("shaft") = {1}; Physical Surface("hub") = {2};
Physical Curve("shaft_cone") = {2}; Physical Curve("shaft_bottom") = {1};
Physical Curve("hub_cone") = {8}; Physical Curve("hub_bottom") = {5};
Mesh.MeshSizeMax = h; Mesh.MeshSizeMin = h;
