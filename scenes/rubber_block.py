"""A block of neo-Hookean rubber pressed on a rigid plate; lengths and stresses without units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.optimize import brentq

import ufl
from dolfinx import fem

from dolfinx_tresca import Frictionless, NonlinearContactProblem, RigidObstacle, RigidPlane
from dolfinx_tresca.scene.friction import Friction
from scenes.blocks import ABOVE, BELOW, FRONT, LEFT, block
from scenes.elasticity import fixed
from scenes.scene import Scene

MU, LAMBDA = 1.0, 1.5


def neo_hookean(u: fem.Function, mu: float = MU, lam: float = LAMBDA) -> Any:
    """Return the energy density of compressible rubber (in 2D plane strain)."""
    dim = len(u)
    F = ufl.Identity(dim) + ufl.grad(u)
    log_J = ufl.ln(ufl.det(F))
    return mu / 2 * (ufl.inner(F, F) - dim - 2 * log_J) + lam / 2 * log_J**2


def uniaxial_stress(stretch: float, dim: int, mu: float = MU, lam: float = LAMBDA) -> float:
    """Return the force over the undeformed area of a block that is free to grow thicker."""

    def across(side: float) -> float:
        return mu * (side - 1 / side) + lam * np.log(stretch * side ** (dim - 1)) / side

    side = brentq(across, 0.2, 5.0, xtol=1e-15)
    log_J = np.log(stretch * side ** (dim - 1))
    return float(mu * (stretch - 1 / stretch) + lam * log_J / stretch)


@dataclass(frozen=True)
class RubberBlock:
    """The parts of a nonlinear contact problem.

    Attributes:
        scene: space, tags and pairs; its forms are of a linear block.
        u: the displacement.
        F: the residual form.
        bcs: Dirichlet conditions.
        push: displacement of the top (dim,) or along the axis (), changed in place.
    """

    scene: Scene
    u: fem.Function
    F: Any
    bcs: list[Any]
    push: fem.Constant

    def but(self, **changes: Any) -> RubberBlock:
        """Return the block with attributes of its pairs changed."""
        return replace(self, scene=self.scene.but(**changes))

    def problem(self, **changes: Any) -> NonlinearContactProblem:
        """Return the problem; `changes` replace or add arguments. Collective."""
        given = {"F": self.F, "u": self.u, "pairs": self.scene.pairs, "bcs": self.bcs, **changes}
        return NonlinearContactProblem(**given)


def rubber_block(
    comm: MPI.Comm,
    n: Sequence[int],
    *,
    size: Sequence[float] | None = None,
    degree: int = 1,
    clamped: bool = False,
    friction: Friction | None = None,
    obstacle: RigidObstacle | None = None,
    turn: np.ndarray | None = None,
    boxes: bool = True,
) -> RubberBlock:
    """Return a block whose top is displaced. Collective.

    Args:
        comm: communicator of the mesh.
        n: cells along each axis.
        size: length of the block along each axis; None: 1.
        degree: degree of the displacement.
        clamped: whether the top moves as a whole; otherwise it is free to move sideways, and two
            sides of the block are planes of symmetry (in 2D one side).
        friction: law of friction; None: frictionless.
        obstacle: obstacle below the block; None: a plate that touches the block.
        turn: rotation (dim, dim) of the whole scene; only with `clamped`.
        boxes: whether cells are quadrilaterals or hexahedra, not triangles or tetrahedra.
    """
    dim = len(n)
    turn = np.eye(dim) if turn is None else turn
    plate = RigidPlane(np.zeros(dim), turn[:, -1])
    scene = block(
        comm,
        n,
        size=size,
        degree=degree,
        boxes=boxes,
        across=() if clamped else (LEFT, FRONT)[: dim - 1],
        friction=friction or Frictionless(),
        obstacles=[(BELOW, obstacle or plate)],
    )
    top = scene.facet_tags.find(ABOVE)
    x = scene.mesh.geometry.x
    x[:, :dim] = x[:, :dim] @ turn.T
    push = fem.Constant(scene.mesh, np.zeros(dim) if clamped else np.float64(0.0))
    held = fixed(scene.V, top, push, None if clamped else dim - 1)
    u, v = fem.Function(scene.V), ufl.TestFunction(scene.V)
    # by default, hexahedra have 216 points of quadrature
    F = ufl.derivative(neo_hookean(u) * ufl.dx(degree=4 * degree), u, v)
    return RubberBlock(scene, u, F, [*scene.bcs, held], push)
