"""Gaps between curved surfaces whose meshes were refined."""

from __future__ import annotations

import numpy as np
import pytest
from test_refinement import near

from dolfinx import fem

from dolfinx_tresca import MESHES, ContactPair, Frictionless, read_gmsh, refine
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.pairing.choice import pair_surfaces

RADIUS, INTERFERENCE = 10.0, 1e-3  # mm
CELLS = 6  # round a quarter of the hole

#: Of the largest facets over the circle [mm].
SAGITTA = RADIUS * (1.0 - np.cos(0.25 * np.pi / CELLS))


def on_cylinder(radius):
    def nearest(x):
        part = radius / np.hypot(x[0], x[1])
        return np.stack([x[0] * part, x[1] * part, x[2]])

    return nearest


@pytest.mark.parallel
@pytest.mark.parametrize("names", [("plate", "pin"), ("pin", "plate")])
def test_a_press_fit_keeps_its_interference(comm, names):
    """It is far less than the height of the surfaces over their facets, which must be known well.

    (In the root mean square to 1 %; with the mean of the facets' normals to 3 to 6 %.)
    """
    fit = read_gmsh(
        MESHES / "press_fit.geo", comm, N=CELLS, M=4, Hex=0, Thickness=8, Interference=INTERFERENCE
    )
    snap = {
        "plate_contact": on_cylinder(RADIUS),
        "pin_contact": on_cylinder(RADIUS + INTERFERENCE),
    }
    fit = refine(fit, near(fit, [7, 7, 0]) ** 0.05, 0.4, snap=snap)
    V = fem.functionspace(fit.mesh, ("Lagrange", 1, (3,)))
    secondary, primary = (fit.tags[f"{name}_contact"] for name in names)
    pair = ContactPair(fit.facet_tags, secondary, primary, Frictionless())
    count = V.dofmap.index_map.size_local
    x = V.tabulate_dof_coordinates()[:count]
    prescribed = np.zeros((count, 3), dtype=bool)
    prescribed[:, :2] = np.abs(x[:, :2]) < 1e-9  # planes of symmetry
    found = pair_surfaces(V, prescribed.ravel(), pair)
    error = found.gap + INTERFERENCE
    square, area = reduce_array(comm, [found.weights @ error**2, found.weights.sum()])
    assert np.sqrt(square / area) <= 0.015 * SAGITTA
