"""What the errors of the primary side say of the secondary cells that hold it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca._base.assembly import assembled
from dolfinx_tresca.pairing.contact_operators import ContactOperators
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.scene.pair import ContactPair


def raised_to_opposite(
    cell_errors: fem.Function, pairs: Sequence[ContactPair], operators: Sequence[ContactOperators]
) -> fem.Function:
    """Return errors of cells, in secondary ones no less than in those before them. Collective.

    Secondary nodes carry the multipliers: between two of them nothing keeps the primary surface
    from penetrating and gaping, and that is in no cell's strain. Where the secondary side is the
    stiffer one its own errors are small; if its cells stay coarse for that, finer ones on the soft
    side soon lessen nothing any more. So a secondary cell counts here with the squared errors of
    all cells before it, if these are more than its own: one that has many before it comes first.

    Args:
        cell_errors: of each cell, of degree 0 [energy^(1/2), or any other unit].
        pairs: of the problem.
        operators: of each pair.
    """
    mesh = cell_errors.function_space.mesh
    result = cell_errors.copy()
    nodes, cells = fem.functionspace(mesh, ("Lagrange", 1)), cell_errors.function_space
    one, cell = ufl.TestFunction(nodes), ufl.TestFunction(cells)
    for pair, operator in zip(pairs, operators, strict=True):
        if isinstance(pair.primary, RigidObstacle):
            continue
        ds = ufl.Measure("ds", domain=mesh, subdomain_data=pair.facet_tags)
        density, areas = (
            assembled(factor * one * ds(pair.primary), nodes)
            for factor in (cell_errors**2 / ufl.FacetArea(mesh), 1.0)
        )
        np.divide(density.x.array, areas.x.array, out=density.x.array, where=areas.x.array > 0.0)
        opposite = assembled(operator.transfer(density) * cell * ds(pair.secondary), cells)
        # the projection overshoots: what is negative says nothing
        squares = np.maximum(np.square(result.x.array), opposite.x.array)
        result.x.array[:] = np.sqrt(squares)
    return result
