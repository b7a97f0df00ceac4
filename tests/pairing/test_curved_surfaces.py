"""Gaps between curved surfaces, which flat facets approximate."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx import fem

from scenes.assembled import points_of
from scenes.nodal import global_vector
from scenes.patches import KINDS, dim_of, patch
from scenes.scene import EPS

GAP = 0.02


def onto_spheres(x: np.ndarray) -> np.ndarray:
    """Bend two blocks so that their faces become concentric circles or spheres."""
    axis = 2 if np.ptp(x[:, 2]) > 0.0 else 1
    directions = x - 0.5 * (np.arange(3) < axis)
    directions[:, axis] = 1.0
    return (1.0 + x[:, axis, None]) * directions / np.linalg.norm(directions, axis=1)[:, None]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("degree", [1, 2])
def test_concentric_spheres_are_as_far_apart_as_their_radii(comm, kind, degree):
    """Errors fall with h^4, faster than the height of the surfaces over their facets, with h^2."""
    axis, errors = dim_of(kind) - 1, []
    for n in (5, 10):
        scene = patch(
            comm, kind, degree, upper=(n, 1), lower=(n + 1, 1), distort=0.0, warp=onto_spheres,
            gap=GAP,
        )  # fmt: skip
        operators = scene.operators()
        x = points_of(scene, operators)
        away_from_rim = np.abs(x[:, :axis] / x[:, axis, None]).max(axis=1) < 0.25
        errors.append(np.abs(operators.gap - GAP)[away_from_rim].max())
    assert errors[0] < 1e-4
    assert np.log2(errors[0] / errors[1]) > 3.5


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["triangle", "tetrahedron"])
def test_curved_surfaces_have_the_same_gaps_on_any_number_of_ranks(comm, kind):
    """Gaps depend on normals of facets around those that meet."""
    gaps = []
    for ranks in (MPI.COMM_SELF, comm):
        scene = patch(ranks, kind, upper=(12, 1), lower=(9, 1), warp=onto_spheres, gap=GAP)
        operators = scene.operators()
        gaps.append(global_vector(ranks, points_of(scene, operators), operators.gap))
    assert np.abs(gaps[0] - gaps[1]).max() <= 1e4 * EPS


@pytest.mark.parametrize("kind", ["triangle", "tetrahedron", "hexahedron"])
@pytest.mark.parametrize("exchanged", [False, True])
@pytest.mark.parametrize("degree", [1, 2])
def test_surfaces_that_touch_between_nodes_do_not_overlap(comm, kind, exchanged, degree):
    """A parabola touches a plane: means over facets may be less than all distances."""
    axis, size = dim_of(kind) - 1, 0.2

    def onto_parabola(x: np.ndarray) -> np.ndarray:
        height = 0.5 * ((x[:, :axis] - 0.43) ** 2).sum(axis=1) - GAP
        x[:, axis] += np.where(x[:, axis] > 1.0 + 0.5 * GAP, height, 0.0)
        return x

    sizes = {"upper": (5, 1), "lower": (5, 1), "distort": 0.0, "gap": GAP}
    scene = patch(comm, kind, degree, **sizes, warp=onto_parabola)
    (pair,) = scene.pairs
    if exchanged:
        scene = scene.but(secondary=pair.primary, primary=pair.secondary)
    with scene.problem() as problem:
        gaps = [problem.operators[0].gap.min()]
        displacement = fem.Function(scene.V)
        displacement.x.array[:] = 1e-6
        problem.update_geometry(displacement)
        gaps.append(problem.operators[0].gap.min())
    assert -0.005 * size**2 <= min(gaps) <= max(gaps) <= size**2
