"""Draw the contact normals of scenes in which one side is not smooth: docs/contact_normals.png.

The arrows are `problem.operators[0].normals` at the contact nodes; their colour is the gap.
Usage: tools/fenicsx python3 docs/contact_normals.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from mpi4py import MPI

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

import dolfinx
from dolfinx import fem

from dolfinx_tresca import ContactPair, Frictionless, RigidSphere, read_gmsh
from dolfinx_tresca.pairing.pair_surfaces import pair_surfaces

mpl.use("Agg")

CHAMFER = """
h = 0.25;
Point(1) = {0, 0, 0, h}; Point(2) = {1.4, 0, 0, h}; Point(3) = {2, 0.6, 0, h};
Point(4) = {2, 2.2, 0, h}; Point(5) = {0, 2.2, 0, h};
Point(6) = {2.05, -1.0, 0, h}; Point(7) = {2.8, -1.0, 0, h};
Point(8) = {2.8, 2.2, 0, h}; Point(9) = {2.05, 2.2, 0, h};
For i In {1:4}
  Line(i) = {i, i + 1};
EndFor
Line(5) = {5, 1}; Line(6) = {6, 7}; Line(7) = {7, 8}; Line(8) = {8, 9}; Line(9) = {9, 6};
Curve Loop(1) = {1:5}; Curve Loop(2) = {6:9}; Plane Surface(1) = {1}; Plane Surface(2) = {2};
Physical Surface("bodies") = {1, 2};
Physical Curve("secondary") = {2, 3}; Physical Curve("primary") = {9};
"""

RIM = """
c = Cos(15 * Pi / 180); s = Sin(15 * Pi / 180); h = 0.35;
Point(1) = {0, 0, 0, h};
Point(2) = {1, 0, 0, h}; Point(3) = {0, 1, 0, h}; Point(4) = {-1, 0, 0, h};
Point(6) = {c, s, 0, h}; Point(7) = {0, 1, 0, h}; Point(8) = {-c, s, 0, h};
Point(9) = {-1.4 * c, 1.4 * s, 0, h}; Point(10) = {0, 1.4, 0, h};
Point(11) = {1.4 * c, 1.4 * s, 0, h};
Circle(1) = {2, 1, 3}; Circle(2) = {3, 1, 4}; Line(3) = {4, 1}; Line(4) = {1, 2};
Circle(5) = {6, 1, 7}; Circle(6) = {7, 1, 8}; Line(7) = {8, 9};
Circle(8) = {9, 1, 10}; Circle(9) = {10, 1, 11}; Line(10) = {11, 6};
Curve Loop(1) = {1:4}; Curve Loop(2) = {5:10}; Plane Surface(1) = {1}; Plane Surface(2) = {2};
Physical Surface("bodies") = {1, 2};
Physical Curve("secondary") = {5, 6}; Physical Curve("primary") = {1, 2};
"""

CORNER = """
SetFactory("OpenCASCADE");
Rectangle(1) = {0, 0.02, 0, 1, 1};
Rotate { {0, 0, 1}, {0, 0.02, 0}, 20 * Pi / 180 } { Surface{1}; }
Rectangle(2) = {-0.8, -0.6, 0, 2.2, 0.6};
Physical Surface("bodies") = {1, 2};
Physical Curve("secondary") = {1, 4}; Physical Curve("primary") = {7};
Mesh.MeshSizeMax = 0.25;
"""

BLOCK = """
SetFactory("OpenCASCADE");
Rectangle(1) = {-2, 0, 0, 4, 1};
Physical Surface("bodies") = {1}; Physical Curve("secondary") = {1};
Mesh.MeshSizeMax = 0.9;
"""

BALL = RigidSphere(center=(0.25, -0.5), radius=0.5)

SCENES = {
    "a chamfer beside a wall:\nthe wall's normal": (CHAMFER, None),
    "a half ring that fits exactly:\nno tilt at its ends": (RIM, None),
    "a sharp corner on a plate:\nthe plate's normal": (CORNER, None),
    "a ball smaller than the cells:\nthe block's normal": (BLOCK, BALL),
}


def draw(axis: plt.Axes, text: str, obstacle: RigidSphere | None) -> None:
    """Draw a scene's mesh, and the contact normals of its secondary side."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.geo"
        path.write_text(text)
        tagged = read_gmsh(path, MPI.COMM_SELF)
    mesh, tags = tagged.mesh, tagged.tags
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    primary = obstacle or tags["primary"]
    pair = ContactPair(tagged.facet_tags, tags["secondary"], primary, Frictionless())
    prescribed = np.zeros(2 * V.dofmap.index_map.size_local, dtype=bool)
    found = pair_surfaces(V, prescribed, pair)
    x = mesh.geometry.x
    mesh.topology.create_connectivity(1, 2)
    outer = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    cells = dolfinx.mesh.entities_to_geometry(mesh, 2, np.arange(V.dofmap.list.shape[0]))
    axis.triplot(x[:, 0], x[:, 1], cells, color="0.85", linewidth=0.6)
    for line in dolfinx.mesh.entities_to_geometry(mesh, 1, outer):
        axis.plot(*x[line, :2].T, color="0.3", linewidth=1.2)
    if obstacle is not None:
        axis.add_patch(plt.Circle((0.25, -0.5), 0.5, color="0.75"))
    places = V.tabulate_dof_coordinates()[found.nodes, :2]
    axis.quiver(
        *(*places.T, *found.normals.T, found.gap),
        **{"angles": "xy", "scale_units": "xy", "scale": 3.0, "width": 0.012, "cmap": "viridis"},
    )
    axis.set_aspect("equal")
    axis.set_axis_off()


figure, axes = plt.subplots(1, len(SCENES), figsize=(13.0, 3.8), layout="constrained")
for axis, (title, scene) in zip(axes, SCENES.items(), strict=True):
    draw(axis, *scene)
    axis.set_title(title, fontsize=10)

figure.savefig(Path(__file__).parent / "contact_normals.png", dpi=110)
