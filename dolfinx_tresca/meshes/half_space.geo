// The meridian of an elastic body with a flat top, for a ball that is pressed on it: a body of
// revolution about the axis x = 0, as good as a half-space if its size is many contact radii.
//
//   the origin is the middle of the top; the body is below, down to y = -Size and out to x = Size
//
// Size    radius and depth of the body
// h       size of the cells at the origin
// Growth  size of the cells divided by their distance from the origin, far from the origin
// Top     radius of the part of the top that may come into contact
//
// Lengths may be in any unit.

DefineConstant[
  Size = {10, Name "Radius and depth"}
  h = {0.01, Name "Size of cells at the origin"}
  Growth = {0.08, Name "Growth of cells"}
  Top = {1, Name "Radius of the top that may touch"}
];

Point(1) = {0, 0, 0};
Point(2) = {Top, 0, 0};
Point(3) = {Size, 0, 0};
Point(4) = {Size, -Size, 0};
Point(5) = {0, -Size, 0};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 5};
Line(5) = {5, 1};
Curve Loop(1) = {1 : 5};
Plane Surface(1) = {-1};

Physical Surface("body", 1) = {1};
Physical Curve("contact", 11) = {1};
Physical Curve("bottom", 12) = {4};
Physical Curve("axis", 13) = {5};

Field[1] = Distance;
Field[1].PointsList = {1};
Field[2] = MathEval;
Field[2].F = Sprintf("max(%g, %g*F1)", h, Growth);
Background Field = 2;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
