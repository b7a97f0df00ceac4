"""Friction with two axes: against a conic solver, an analytic block, and what must not matter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import clarabel
import numpy as np
import pytest
from models import ABOVE, FRONT, block, model_of
from rubbing import BOUND, YOUNG, rubbing
from scenes import EPS, dual_program, global_vector, node_function, rotation
from scipy.sparse import csc_array

from dolfinx import fem

from dolfinx_tresca import (
    ContactSolution,
    ContactStatus,
    ContactState,
    Coulomb,
    InputError,
    Tresca,
)
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.scene.friction import Friction

#: Slip bound of the rubbing blocks [stress].
G = BOUND * YOUNG

#: Wanted residual, and how many times the tractions' error may be larger, over the largest bound.
RTOL, TRACTION_FACTOR = 1e-9, 1e4


def solved(model: Any, **options: Any) -> ContactSolution:
    """Return a converged solution."""
    with model.problem() as problem:
        solution = problem.solve(**{"rtol": RTOL, **options})
    solution.raise_if_failed()
    return solution


def rubbed(comm: MPI.Comm, friction: Friction, **arguments: Any) -> Any:
    return model_of(rubbing(comm, "tetrahedron", friction=friction, **arguments))


def node_vectors(solution: ContactSolution, name: str) -> np.ndarray:
    """Return a vector field (n, 3) at the contact nodes of all ranks, in the order of places."""
    surface = solution.surface
    points = surface.pressure.function_space.tabulate_dof_coordinates()
    own = surface.pressure.function_space.dofmap.index_map.size_local
    values = getattr(surface, name).x.array.reshape(len(points), -1)[:own]
    return global_vector(solution.u.function_space.mesh.comm, points[:own], values)


def axes_of(direction: Sequence[float]) -> np.ndarray:
    """Return the axes (2, 3) on a horizontal surface."""
    first = np.array([direction[0], direction[1], 0.0]) / np.hypot(*direction[:2])
    return np.array([first, np.cross([0.0, 0.0, 1.0], first)])


def conic_tractions(scene: Any, bounds: np.ndarray, direction: Sequence[float]) -> np.ndarray:
    """Return the tractions (n, 3) of nodes with bounds (n, 2), by an interior-point method.

    The operators are those of circles: all that is known of ellipses is in the cones.
    """
    with dual_program(scene) as dual:
        jump, (pair,) = dual.jump, dual.jump.pairs
        A, b = np.column_stack([dual.apply(e) for e in np.eye(dual.b.size)]), dual.b
        scale, (normal, tangential) = jump.stress_scale, jump.slices[0]
        # in units of stress, and with numbers of size 1
        A, b = A / np.outer(scale, scale), b / scale
        factor = np.abs(np.diag(A)).max()
        rows, right, cones = [], [], []
        rows.append(-np.eye(len(b))[normal])
        right.append(np.zeros(len(rows[-1])))
        cones.append(clarabel.NonnegativeConeT(len(rows[-1])))
        axes = axes_of(direction)
        for node, semi_axes in enumerate(bounds):
            own = np.flatnonzero(pair.tangent_node == node)
            along = np.zeros((2, len(b)))
            along[:, tangential.start + own] = axes @ pair.tangents[own].T
            for axis in np.flatnonzero(semi_axes == 0.0):
                rows.append(along[[axis]])
                right.append(np.zeros(1))
                cones.append(clarabel.ZeroConeT(1))
            kept = semi_axes > 0.0
            cone = -along[kept] / semi_axes[kept, None]
            rows.append(np.vstack([np.zeros(len(b)), cone]))
            right.append(np.append(1.0, np.zeros(kept.sum())))
            cones.append(clarabel.SecondOrderConeT(1 + int(kept.sum())))
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
        solver = clarabel.DefaultSolver(
            csc_array(np.triu(0.5 * (A + A.T) / factor)),
            -b / factor,
            csc_array(np.vstack(rows)),
            np.concatenate(right),
            cones,
            settings,
        )
        found = solver.solve()
        assert str(found.status) in ("Solved", "AlmostSolved")
        traction = np.zeros((len(pair.nodes), 3))
        np.add.at(
            traction, pair.tangent_node, np.array(found.x)[tangential, None] * pair.tangents
        )
        points = scene.V.tabulate_dof_coordinates()[pair.nodes]
    return global_vector(MPI.COMM_SELF, points, traction)


@pytest.mark.parametrize(
    "bounds", [(1.0, 0.3), (0.1, 1.0), (1.0, 0.0), (0.0, 0.5)], ids=lambda pair: f"{pair}"
)
def test_tractions_are_those_of_a_conic_solver(bounds):
    direction = (1.0, 0.4, 0.2)
    g = G * np.array(bounds)
    solution = solved(rubbed(MPI.COMM_SELF, Tresca(tuple(g), direction=direction)))
    scene = rubbing(MPI.COMM_SELF, "tetrahedron", friction=Tresca(G))
    expected = conic_tractions(scene, np.tile(g, (len(solution.surface.points), 1)), direction)
    error = np.abs(node_vectors(solution, "traction") - expected).max()
    assert error <= TRACTION_FACTOR * RTOL * g.max()
    assert solution.energy_error_bound <= 1e-6
