// Half of a hemisphere over half of a block, along which it is pulled. Both are cut by the plane of
// symmetry y = 0; the bodies share no point.
//
//   block       0 < x < 5, 0 < y < 1.5, -1 < z < 0
//   hemisphere  centre (1.2, 0, 1.02), radius 1; its lowest point is 0.02 above the block
//
// h   size of the cells near the way of the hemisphere; elsewhere they grow with distance

DefineConstant[ h = {0.1, Name "Size of cells at the contact"} ];

SetFactory("OpenCASCADE");
Geometry.OCCBoundsUseStl = 1; // tight boxes

Sphere(1) = {1.2, 0, 1.02, 1};
Rotate {{1, 0, 0}, {1.2, 0, 1.02}, Pi/2} { Volume{1}; } // no pole of its coordinates in the contact
Box(2) = {0, 0, -0.5, 5, 1.5, 1.52};
BooleanIntersection(3) = { Volume{1}; Delete; }{ Volume{2}; Delete; };
Box(4) = {0, 0, -1, 5, 1.5, 1};

e = 1e-3;
top() = Surface In BoundingBox {-e, -e, -e, 5 + e, 1.5 + e, e};
bottom() = Surface In BoundingBox {-e, -e, -1 - e, 5 + e, 1.5 + e, -1 + e};
cut() = Surface In BoundingBox {-e, -e, 1.02 - e, 5 + e, 1.5 + e, 1.02 + e};
middle() = Surface In BoundingBox {-e, -e, -1 - e, 5 + e, e, 1.02 + e};
round() = Surface In BoundingBox {-e, -e, 0.02 - e, 5 + e, 1.5 + e, 1.02 + e};
round() -= {cut(), middle()};

Physical Volume("hemisphere", 1) = {3};
Physical Volume("block", 2) = {4};
Physical Surface("hemisphere_round", 11) = {round()};
Physical Surface("hemisphere_cut", 12) = {cut()};
Physical Surface("block_top", 21) = {top()};
Physical Surface("block_bottom", 22) = {bottom()};
Physical Surface("symmetry", 3) = {middle()};

// distance from the way of the lowest point, the segment from x = 1.2 to x = 3.2
Field[1] = MathEval;
Field[1].F = Sprintf("%g + 0.3*max(0, sqrt(max(0, abs(x - 2.2) - 1)^2 + y^2 + z^2) - 0.7)", h);
Background Field = 1;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
Mesh.Algorithm = 6;
