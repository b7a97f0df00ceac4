// Half of a layer of thickness 1 on half of a block that is as good as a half-plane. Plane.
//
// Layer   half length of the layer
// L       half width and depth of the block
// Load    half width of the loaded strip on top of the layer
// Zone    cells have the size h up to this distance from the middle of the contact
// h       size of the cells there
// Growth  how much the size of the cells grows per distance further away
//
// Lengths may be in any unit.

DefineConstant[
  Layer = {8, Name "Half length of the layer"}
  L = {400, Name "Half width and depth of the block"}
  Load = {0.05, Name "Half width of the load"}
  Zone = {1.6, Name "Radius of the zone of small cells"}
  h = {0.1, Name "Size of cells at the contact"}
  Growth = {0.2, Name "Growth of cells"}
];

Point(1) = {0, 0, 0};
Point(2) = {Layer, 0, 0};
Point(3) = {Layer, 1, 0};
Point(4) = {Load, 1, 0};
Point(5) = {0, 1, 0};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 5};
Line(5) = {5, 1};
Curve Loop(1) = {1:5};
Plane Surface(1) = {1};

Point(11) = {0, 0, 0};
Point(12) = {0, -L, 0};
Point(13) = {L, -L, 0};
Point(14) = {L, 0, 0};
Point(15) = {Layer, 0, 0};
Line(11) = {11, 12};
Line(12) = {12, 13};
Line(13) = {13, 14};
Line(14) = {14, 15};
Line(15) = {15, 11};
Curve Loop(2) = {11:15};
Plane Surface(2) = {2};

Physical Surface("layer", 1) = {1};
Physical Surface("block", 2) = {2};
Physical Curve("layer_contact", 11) = {1};
Physical Curve("load", 12) = {4};
Physical Curve("block_contact", 21) = {15};
Physical Curve("bottom", 22) = {12};
Physical Curve("symmetry", 3) = {5, 11};

Field[1] = MathEval;
Field[1].F = Sprintf("%g + %g*max(0, sqrt(x^2 + y^2) - %g)", h, Growth, Zone);
Background Field = 1;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
