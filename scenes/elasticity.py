"""Parts of the forms that scenes have in common: linear elasticity, materials, conditions."""

from __future__ import annotations

from typing import Any

import numpy as np

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import TaggedMesh


def lame_constants(young: Any, poisson: Any) -> tuple[Any, Any]:
    """Return mu and lambda in the unit of Young's modulus; in 2D those of plane strain."""
    return young / (2 * (1 + poisson)), young * poisson / ((1 + poisson) * (1 - 2 * poisson))


def strain(u: Any) -> Any:
    """Return the strain of a displacement."""
    return ufl.sym(ufl.grad(u))


def elasticity(V: Any, young: Any, poisson: Any = 0.3, dx: Any = ufl.dx) -> Any:
    """Return the bilinear form of an isotropic material."""
    mu, lame = lame_constants(young, poisson)
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    return (2 * mu * ufl.inner(strain(u), strain(v)) + lame * ufl.div(u) * ufl.div(v)) * dx


def no_load(V: Any) -> Any:
    """Return a linear form that is zero."""
    zero = fem.Constant(V.mesh, np.zeros(V.mesh.geometry.dim))
    return ufl.inner(zero, ufl.TestFunction(V)) * ufl.dx


def by_body(bodies: TaggedMesh, values: dict[str, float]) -> fem.Function:
    """Return a function of degree 0 that has a given value in each named body."""
    function = fem.Function(fem.functionspace(bodies.mesh, ("DG", 0)))
    for name, value in values.items():
        function.x.array[bodies.cell_tags.find(bodies.tags[name])] = value
    return function


def fixed(V: Any, facets: np.ndarray, value: Any = None, component: int | None = None) -> Any:
    """Return the condition that u, or one component of it, has a value on facets; default zero.

    `value` is a number or a vector, or a `fem.Constant` that may be changed later.
    """
    dim = V.mesh.topology.dim
    if component is None:
        if not isinstance(value, fem.Constant):
            value = np.zeros(dim) if value is None else np.asarray(value, dtype=float)
        return fem.dirichletbc(value, fem.locate_dofs_topological(V, dim - 1, facets), V)
    if not isinstance(value, fem.Constant):
        value = dolfinx.default_scalar_type(0.0 if value is None else value)
    sub = V.sub(component)
    return fem.dirichletbc(value, fem.locate_dofs_topological(sub, dim - 1, facets), sub)
