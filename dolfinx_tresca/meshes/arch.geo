// A semicircular arch of voussoirs with radial joints, each a body of its own. Plane.
//
//   R, T    radius of the centre line, thickness
//   M       voussoirs, from the left to the right
//   N       cells across the arch; each voussoir has N/2 along it
//
// All lengths in metres.

DefineConstant[
  N = {4, Min 2, Max 32, Step 2, Name "Cells across"},
  M = {25, Min 3, Max 99, Step 1, Name "Voussoirs"},
  R = {1, Min 0.1, Max 10, Step 0.1, Name "Radius"},
  T = {0.12, Min 0.01, Max 1, Step 0.01, Name "Thickness"}
];

centre = newp;
Point(centre) = {0, 0, 0};
joints[] = {};
For k In {0:M-1}
  left = k*Pi/M - Pi/2;
  right = (k + 1)*Pi/M - Pi/2;
  p = newp;
  Point(p) = {(R - T/2)*Sin(left), (R - T/2)*Cos(left), 0};
  Point(p + 1) = {(R - T/2)*Sin(right), (R - T/2)*Cos(right), 0};
  Point(p + 2) = {(R + T/2)*Sin(right), (R + T/2)*Cos(right), 0};
  Point(p + 3) = {(R + T/2)*Sin(left), (R + T/2)*Cos(left), 0};
  c = newc;
  Circle(c) = {p, centre, p + 1};
  Line(c + 1) = {p + 1, p + 2};
  Circle(c + 2) = {p + 2, centre, p + 3};
  Line(c + 3) = {p + 3, p};
  Transfinite Curve {c, c + 2} = N/2 + 1;
  Transfinite Curve {c + 1, c + 3} = N + 1;
  s = news;
  Curve Loop(s) = {c:c + 3};
  Plane Surface(s) = {s};
  Transfinite Surface {s};
  Recombine Surface {s};
  Physical Surface(Sprintf("voussoir %g", k + 1), 101 + k) = {s};
  If (k == 0)
    Physical Curve("left_springing", 1) = {c + 3};
  Else
    joints[] += {c + 3};
  EndIf
  If (k == M - 1)
    Physical Curve("right_springing", 2) = {c + 1};
  Else
    joints[] += {c + 1};
  EndIf
EndFor
Physical Curve("joints", 7) = joints[];
