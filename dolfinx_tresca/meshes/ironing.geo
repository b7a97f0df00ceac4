// Shallow ironing: a stiff block with a round lower face is pressed on a foundation and slides along it.
// Fischer and Wriggers 2006, Computer Methods in Applied Mechanics and Engineering 195. Plane.
//
//   foundation (0,12) x (0,4)
//   block      (0.2,1.4) x (4.2,5.4); its lower face is an arc through (0.2,4.5), (0.8,4.2), (1.4,4.5)
//
// N       cells along the foundation, a multiple of 4; the block has N/10 cells along its arc, an even
//         number at least
//
// All lengths in millimetres.

DefineConstant[
  N = {120, Min 20, Max 480, Step 20, Name "Cells along the foundation"}
];

Point(1) = {0, 0, 0};
Point(2) = {12, 0, 0};
Point(3) = {12, 4, 0};
Point(4) = {0, 4, 0};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 1};
Curve Loop(1) = {1:4};
Plane Surface(1) = {1};

Point(5) = {0.2, 4.5, 0};
Point(6) = {0.8, 4.2, 0};
Point(7) = {1.4, 4.5, 0};
Point(8) = {1.4, 5.4, 0};
Point(9) = {0.2, 5.4, 0};
Point(10) = {0.8, 4.95, 0};  // the centre of the arc
Circle(5) = {5, 10, 6};
Circle(6) = {6, 10, 7};
Line(7) = {7, 8};
Line(8) = {8, 9};
Line(9) = {9, 5};
Curve Loop(2) = {5:9};
Plane Surface(2) = {2};

half = Round(N/20);
Transfinite Curve {1, 3} = N + 1;
Transfinite Curve {2, 4} = N/4 + 1;
Transfinite Curve {5, 6} = half + 1;
Transfinite Curve {8} = 2*half + 1;
Transfinite Curve {7, 9} = half + 1;
Transfinite Surface {1};
Transfinite Surface {2} = {5, 7, 8, 9};
Recombine Surface {1, 2};

Physical Surface("foundation", 1) = {1};
Physical Surface("block", 2) = {2};
Physical Curve("foundation_bottom", 10) = {1};
Physical Curve("foundation_top", 11) = {3};
Physical Curve("block_arc", 12) = {5, 6};
Physical Curve("block_top", 13) = {8};
