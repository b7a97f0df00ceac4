"""A belt round a fixed drum: the formula of Euler and Eytelwein, in steps in which slip spreads."""

from __future__ import annotations

import dataclasses

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca import Coulomb, RigidSphere
from scenes.blocks import LEFT, YOUNG, block

#: Coefficient, angle of contact, cells along it, thickness of the belt over the drum's radius.
FRICTION, ANGLE, CELLS, THICKNESS = 0.3, np.pi, 24, 0.05

#: Force on the free end, which goes to the right at the top; and requested residual.
FORCE, RTOL = 0.1, 1e-8


def test_slip_spreads_over_a_belt():
    """One end is pulled: against the first, and then with it, from the free end's force on.

    The drum takes the moment of friction about its axis. Newton's method alone ended without a
    fixed point when the end was first pulled.
    """
    scene = block(
        MPI.COMM_SELF,
        (CELLS, 1),
        size=(ANGLE, THICKNESS),
        load=(0.0, 0.0, 0.0),
        poisson=0.0,
        pull=FORCE / THICKNESS,
        boxes=True,
    )
    x = scene.mesh.geometry.x
    along, radius = x[:, 0].copy(), 1.0 + x[:, 1]
    x[:, 0], x[:, 1] = -radius * np.sin(along), -radius * np.cos(along)
    part, _ = scene.V.sub(0).collapse()
    end = fem.Function(part)  # turns round the axis with the drum
    held = fem.locate_dofs_topological((scene.V.sub(0), part), 1, scene.facet_tags.find(LEFT))
    pair = dataclasses.replace(
        scene.pair, primary=RigidSphere((0, 0), 1.0), friction=Coulomb(FRICTION)
    )
    middle = 1.0 + 0.5 * THICKNESS
    spread = ANGLE / CELLS
    # nothing rubs at the end that is held, which has half a cell
    exponent = FRICTION * (ANGLE - 0.5 * spread) / middle
    stretch = FORCE / (THICKNESS * YOUNG * FRICTION) * np.expm1(exponent)
    logarithms = []
    with scene.problem(pairs=[pair], bcs=[fem.dirichletbc(end, held, scene.V.sub(0))]) as problem:
        for pull in (0.0, 0.2, 0.5, 1.5):
            end.interpolate(lambda x, pull=pull: -pull * stretch * x[1])
            solution = problem.solve(rtol=RTOL)
            solution.raise_if_failed()
            problem.accept()
            (moment,) = solution.resultants((0, 0))[0].moment
            logarithms.append(np.log1p(-moment / middle / FORCE))
    # the trapezoidal rule
    tolerance = exponent * spread**2
    assert abs(logarithms[0] + exponent) < tolerance
    assert (np.diff(logarithms) > 0.0).all()
    assert abs(logarithms[-1] - exponent) < tolerance
