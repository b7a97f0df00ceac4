"""Scenes with a pressure as an unknown of its own: for Poisson's ratios up to 0.5."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

import basix.ufl
import ufl
from dolfinx import fem

from dolfinx_tresca._base.compat import collapse
from scenes.elasticity import lame_constants, strain
from scenes.rubber_block import RubberBlock, neo_hookean
from scenes.scene import Scene

#: Measure with the same quadrature points in a form and in its derivative. Otherwise UFL estimates
#: different degrees for the two, and Newton's method converges linearly.
EVERYWHERE = ufl.dx(metadata={"quadrature_degree": 4})


def with_pressure(
    scene: Scene, young: float, poisson: float, element: tuple[str, int] = ("Lagrange", 1)
) -> Scene:
    """Return a scene of degree 2 in displacement and pressure p = lambda div u. Collective.

    Args:
        scene: scene in the displacement alone; all bodies get one material.
        young: Young's modulus.
        poisson: Poisson's ratio, above 0 and up to 0.5.
        element: family and degree of the pressure's element; the default is that of Taylor-Hood.
    """
    W = mixed_space(scene.mesh, element)
    (u, p), (v, q) = ufl.TrialFunctions(W), ufl.TestFunctions(W)
    mu, compliance = _material(scene.mesh, young, poisson)
    a = 2 * mu * ufl.inner(strain(u), strain(v)) + p * ufl.div(v) + q * ufl.div(u)
    a -= compliance * p * q
    L = ufl.replace(scene.L, {ufl.TestFunction(scene.V): v})
    return replace(scene, V=W, a=a * ufl.dx, L=L, bcs=[_conditions(scene, W)])


def strain_energy(w: fem.Function, young: float, poisson: float) -> Any:
    """Return the form of the strain energy [energy] of displacement and pressure."""
    u, p = ufl.split(w)
    mu, compliance = _material(w.function_space.mesh, young, poisson)
    return (mu * ufl.inner(strain(u), strain(u)) + compliance / 2 * p**2) * ufl.dx


def with_mean_pressure(scene: Scene, young: float, poisson: float) -> Scene:
    """Return a scene of degree 2 whose pressures, constant in each simplex, are eliminated.

    The mean of the divergence, which is of degree 1, is its value in the middle of a cell.
    """
    mu, lame = (fem.Constant(scene.mesh, value) for value in lame_constants(young, poisson))
    u, v = ufl.TrialFunction(scene.V), ufl.TestFunction(scene.V)
    middle = ufl.dx(metadata={"quadrature_degree": 1})
    a = 2 * mu * ufl.inner(strain(u), strain(v)) * ufl.dx
    return replace(scene, a=a + lame * ufl.div(u) * ufl.div(v) * middle)


def _material(mesh: Any, young: float, poisson: float) -> tuple[fem.Constant, fem.Constant]:
    """Return mu and 1 / lambda, which is zero for Poisson's ratio 0.5."""
    mu = young / (2 * (1 + poisson))
    return fem.Constant(mesh, mu), fem.Constant(mesh, (1 - 2 * poisson) / (2 * mu * poisson))


def mixed_space(mesh: Any, pressure: tuple[str, int]) -> Any:
    """Return the mixed space of displacements of degree 2 and pressures."""
    cell, (family, degree) = mesh.basix_cell(), pressure
    u = basix.ufl.element("Lagrange", cell, 2, shape=(mesh.geometry.dim,))
    p = basix.ufl.element(family, cell, degree)
    return fem.functionspace(mesh, basix.ufl.mixed_element([u, p]))


def _conditions(scene: Scene, W: Any) -> Any:
    """Return all conditions of a scene as one, on the displacements of a mixed space."""
    values, flags = fem.Function(scene.V), fem.Function(scene.V)
    for bc in scene.bcs:
        bc.set(values.x.array)
        flags.x.array[bc.dof_indices()[0]] = 1.0
    V, dofs = collapse(W.sub(0))
    given, held = fem.Function(V), fem.Function(V)
    for function, on_scene in ((given, values), (held, flags)):
        function.interpolate(on_scene)
        function.x.scatter_forward()
    own = np.flatnonzero(held.x.array > 0.5).astype(np.int32)
    own = own[np.argsort(dofs[own])]
    return fem.dirichletbc(given, [dofs[own], own], W.sub(0))


def rubber_with_pressure(
    rubber: RubberBlock,
    compliance: float,
    element: tuple[str, int] = ("Lagrange", 1),
    dx: Any = EVERYWHERE,
) -> RubberBlock:
    """Return a block of degree 2 in displacement and pressure p = ln J / compliance. Collective.

    Its Dirichlet conditions have the present values of the given block's conditions.

    Args:
        rubber: block with the displacement as the only unknown.
        compliance: 1 / lambda; 0: the block keeps its volume.
        element: family and degree of the pressure's element; the default is that of Taylor-Hood.
        dx: measure of the terms with the pressure.
    """
    W = mixed_space(rubber.scene.mesh, element)
    w = fem.Function(W)
    u, p = ufl.split(w)
    log_J = ufl.ln(ufl.det(ufl.Identity(len(u)) + ufl.grad(u)))
    inverse = fem.Constant(rubber.scene.mesh, compliance)
    energy = neo_hookean(u, lam=0.0) * EVERYWHERE + (p * log_J - inverse / 2 * p**2) * dx
    bcs = [_conditions(replace(rubber.scene, bcs=rubber.bcs), W)]
    return replace(rubber, u=w, F=ufl.derivative(energy, w, ufl.TestFunction(W)), bcs=bcs)
