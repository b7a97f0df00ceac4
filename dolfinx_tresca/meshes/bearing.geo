// A roller bearing across its axis: two rings and rollers between them, without clearance. Plane.
//
//   M       rollers, the first one below
//   N       cells are 0.4 mm / N where rollers touch the rings
//
// All lengths in millimetres.

DefineConstant[
  N = {4, Min 1, Max 32, Step 1, Name "Cells in 0.4 mm"},
  M = {16, Min 4, Max 20, Step 1, Name "Rollers"}
];

bore = 20; inner = 26; outer = 34; outside = 40; // radii
fine = 0.4/N; coarse = 2;

centre = newp;
Point(centre) = {0, 0, 0};

// A circle through the contacts, and the points between them.
Macro Raceway
  first = newp;
  For k In {0:2*M - 1}
    phi = k*Pi/M - Pi/2;
    Point(first + k) = {radius*Cos(phi), radius*Sin(phi), 0, (k % 2 == 0) ? fine : coarse};
  EndFor
  raceway[] = {};
  For k In {0:2*M - 1}
    c = newc;
    Circle(c) = {first + k, centre, first + (k + 1) % (2*M)};
    raceway[] += {c};
  EndFor
Return

// A circle of four arcs.
Macro Edge
  first = newp;
  For k In {0:3}
    Point(first + k) = {radius*Cos(k*Pi/2), radius*Sin(k*Pi/2), 0, coarse};
  EndFor
  edge[] = {};
  For k In {0:3}
    c = newc;
    Circle(c) = {first + k, centre, first + (k + 1) % 4};
    edge[] += {c};
  EndFor
Return

radius = bore;
Call Edge;
hole[] = edge[];
radius = inner;
Call Raceway;
inside[] = raceway[];
radius = outer;
Call Raceway;
around[] = raceway[];
radius = outside;
Call Edge;
housing[] = edge[];

loop = newcl;
Curve Loop(loop) = inside[];
Curve Loop(loop + 1) = hole[];
Curve Loop(loop + 2) = housing[];
Curve Loop(loop + 3) = around[];
s = news;
Plane Surface(s) = {loop, loop + 1};
Plane Surface(s + 1) = {loop + 2, loop + 3};
Physical Surface("inner ring", 101) = {s};
Physical Surface("outer ring", 102) = {s + 1};
Physical Curve("bore", 1) = hole[];
Physical Curve("housing", 2) = housing[];
Physical Curve("raceways", 3) = {inside[], around[]};

sides[] = {};
r = (outer - inner)/2;
For k In {0:M - 1}
  phi = 2*k*Pi/M - Pi/2;
  x = (inner + r)*Cos(phi); y = (inner + r)*Sin(phi);
  p = newp;
  Point(p) = {x, y, 0, coarse};
  For i In {0:3}
    Point(p + 1 + i) = {x + r*Cos(phi + i*Pi/2), y + r*Sin(phi + i*Pi/2), 0,
                        (i % 2 == 0) ? fine : coarse};
  EndFor
  c = newc;
  For i In {0:3}
    Circle(c + i) = {p + 1 + i, p, p + 1 + (i + 1) % 4};
  EndFor
  s = news;
  Curve Loop(s) = {c:c + 3};
  Plane Surface(s) = {s};
  Physical Surface(Sprintf("roller %g", k + 1), 201 + k) = {s};
  sides[] += {c:c + 3};
EndFor
Physical Curve("rollers", 4) = sides[];
