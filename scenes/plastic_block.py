"""A block of metal with linear hardening that is pressed on a rigid plane; mm, MPa, N."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

import basix.ufl
import ufl
from dolfinx import fem

from dolfinx_tresca import Frictionless, NonlinearContactProblem, RigidPlane
from dolfinx_tresca._base.compat import interpolation_points
from dolfinx_tresca.scene.friction import Friction
from scenes.blocks import ABOVE, BELOW, FRONT, LEFT, block
from scenes.elasticity import fixed, lame_constants, strain
from scenes.scene import Scene

#: Young's modulus, yield stress, hardening modulus [MPa], Poisson's ratio.
YOUNG, YIELD, HARDENING, POISSON = 70_000.0, 250.0, 5_000.0, 0.3

#: Degree of the quadrature; the history of the material is stored at its points.
QUADRATURE = 2


def uniaxial_path(strains: Sequence[float]) -> np.ndarray:
    """Return stresses (n,) [MPa] of a bar under compressive strains; tension is not possible."""
    plastic, hardening, result = 0.0, 0.0, []
    for e in strains:
        trial = YOUNG * (e - plastic)
        excess = max(trial - YIELD - HARDENING * hardening, 0.0) / (YOUNG + HARDENING)
        plastic, hardening = plastic + excess, hardening + excess
        result.append(max(trial - YOUNG * excess, 0.0))
    return np.array(result)


@dataclass(frozen=True)
class PlasticBlock:
    """The parts of a problem with a history.

    Attributes:
        scene: space, tags and pairs; its forms are of an elastic block.
        u: the displacement.
        F: the residual form.
        J: derivative of the residual.
        bcs: Dirichlet conditions.
        push: displacement of the top [mm], changed in place.
        before_assembly: function that computes stress and tangent; None if the forms contain them.
        on_accept: function that stores the present plastic strains as the history.
        history: plastic strain and equivalent plastic strain of the last accepted step.
    """

    scene: Scene
    u: fem.Function
    F: Any
    J: Any
    bcs: list[Any]
    push: fem.Constant
    before_assembly: Callable[[], None] | None
    on_accept: Callable[[], None]
    history: tuple[fem.Function, fem.Function]

    def problem(self, **changes: Any) -> NonlinearContactProblem:
        """Return the problem; `changes` replace or add arguments. Collective."""
        given = {
            "F": self.F,
            "u": self.u,
            "J": self.J,
            "pairs": self.scene.pairs,
            "bcs": self.bcs,
            "before_assembly": self.before_assembly,
            "on_accept": self.on_accept,
            **changes,
        }
        return NonlinearContactProblem(**given)


def plastic_block(
    comm: MPI.Comm,
    n: Sequence[int] = (2, 2, 2),
    *,
    numeric: bool = False,
    clamped: bool = False,
    friction: Friction | None = None,
) -> PlasticBlock:
    """Return a unit cube of a von Mises material whose top is displaced. Collective.

    Args:
        comm: communicator of the mesh.
        n: cells along each of the three axes.
        numeric: whether numpy computes stress and tangent at the points of quadrature; otherwise
            they are UFL expressions.
        clamped: whether the top moves as a whole; otherwise the state is uniaxial.
        friction: law of friction; None: frictionless.
    """
    scene = block(
        comm,
        n,
        boxes=True,
        across=() if clamped else (LEFT, FRONT),
        friction=friction or Frictionless(),
        obstacles=[(BELOW, RigidPlane(np.zeros(3), (0.0, 0.0, 1.0)))],
    )
    mesh = scene.mesh
    push = fem.Constant(mesh, np.zeros(3) if clamped else np.float64(0.0))
    held = fixed(scene.V, scene.facet_tags.find(ABOVE), push, None if clamped else 2)
    u, v, du = fem.Function(scene.V), ufl.TestFunction(scene.V), ufl.TrialFunction(scene.V)
    dx = ufl.Measure("dx", domain=mesh, metadata={"quadrature_degree": QUADRATURE})

    def at_points(*shape: int) -> Any:
        element = basix.ufl.quadrature_element(
            mesh.basix_cell(), value_shape=shape, degree=QUADRATURE
        )
        return fem.functionspace(mesh, element)

    of_tensors, of_scalars = at_points(3, 3), at_points()
    plastic, hardening = fem.Function(of_tensors), fem.Function(of_scalars)
    mu, lame = lame_constants(YOUNG, POISSON)
    points = interpolation_points(of_tensors.element)

    def yielding(e: Any) -> tuple[Any, Any, Any]:
        """Return the elastic trial stress, the direction of flow and the plastic multiplier."""
        elastic = e - plastic
        trial = 2 * mu * elastic + lame * ufl.tr(elastic) * ufl.Identity(3)
        deviator = ufl.dev(trial)
        size = ufl.sqrt(1.5 * ufl.inner(deviator, deviator) + 1e-20)
        excess = size - YIELD - HARDENING * hardening
        amount = ufl.conditional(ufl.gt(excess, 0.0), excess / (3 * mu + HARDENING), 0.0)
        return trial, 1.5 / size * deviator, amount

    trial, direction, amount = yielding(strain(u))
    before_assembly: Callable[[], None] | None = None
    if numeric:
        stress, tangent = fem.Function(of_tensors), fem.Function(at_points(3, 3, 3, 3))
        strains = fem.Function(of_tensors)
        at = fem.Expression(strain(u), points)

        def before_assembly() -> None:
            strains.interpolate(at)
            found = radial_return(
                strains.x.array.reshape(-1, 3, 3),
                plastic.x.array.reshape(-1, 3, 3),
                hardening.x.array,
            )
            for function, values in zip((stress, tangent), found, strict=True):
                function.x.array[:] = values.ravel()

        i, j, k, m = ufl.indices(4)
        F = ufl.inner(stress, strain(v)) * dx
        J = tangent[i, j, k, m] * strain(du)[k, m] * strain(v)[i, j] * dx
    else:
        F = ufl.inner(trial - 2 * mu * amount * direction, strain(v)) * dx
        J = ufl.derivative(F, u, du)
    flow = fem.Expression(plastic + amount * direction, points)
    growth = fem.Expression(hardening + amount, points)

    def on_accept() -> None:
        # both new values depend on both old values, so both are computed before either is stored
        new = fem.Function(of_tensors), fem.Function(of_scalars)
        for function, expression in zip(new, (flow, growth), strict=True):
            function.interpolate(expression)
        for old, function in zip((plastic, hardening), new, strict=True):
            old.x.array[:] = function.x.array

    return PlasticBlock(
        scene,
        u,
        F,
        J,
        [*scene.bcs, held],
        push,
        before_assembly,
        on_accept,
        (plastic, hardening),
    )


def radial_return(
    strains: np.ndarray, plastic: np.ndarray, hardening: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return stresses (n, 3, 3) and consistent tangents (n, 3, 3, 3, 3) [MPa].

    Simo and Hughes (1998), Computational inelasticity, box 3.2.

    Args:
        strains: (n, 3, 3) total strains.
        plastic: (n, 3, 3) plastic strains of the last step.
        hardening: (n,) equivalent plastic strains of the last step.
    """
    mu, lame = lame_constants(YOUNG, POISSON)
    one = np.eye(3)
    volumetric = np.einsum("ij,kl->ijkl", one, one)
    symmetric = 0.5 * (np.einsum("ik,jl->ijkl", one, one) + np.einsum("il,jk->ijkl", one, one))
    deviatoric = symmetric - volumetric / 3.0
    elastic = lame * volumetric + 2.0 * mu * symmetric
    trial = np.einsum("ijkl,nkl->nij", elastic, strains - plastic)
    deviator = np.einsum("ijkl,nkl->nij", deviatoric, trial)
    size = np.sqrt(1.5 * np.einsum("nij,nij->n", deviator, deviator))
    excess = np.maximum(size - YIELD - HARDENING * hardening, 0.0)
    amount, divisor = excess / (3.0 * mu + HARDENING), np.where(excess > 0.0, size, 1.0)
    direction = 1.5 / divisor[:, None, None] * deviator
    stress = trial - 2.0 * mu * amount[:, None, None] * direction
    ratio = amount / divisor
    flows = (excess > 0.0) / (3.0 * mu + HARDENING)
    tangent = (
        elastic
        - np.einsum("n,ijkl->nijkl", 6.0 * mu**2 * ratio, deviatoric)
        - np.einsum("n,nij,nkl->nijkl", 4.0 * mu**2 * (flows - ratio), direction, direction)
    )
    return stress, tangent
