"""What tagged facets have at their nodes: areas, and values of fields that jump between cells."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.assembly import assembled

#: Quadrature by the values at the corners of each facet: what a node gets is what the facets have
#: there.
AT_CORNERS = {"quadrature_rule": "vertex", "quadrature_degree": 1}


def node_areas(Q: Any, facet_tags: Any, tags: Collection[int]) -> Array:
    """Return integrals (nodes, with ghosts) of hat functions over tagged facets. Collective.

    Args:
        Q: scalars of degree 1.
        facet_tags: of facets on the boundary of its mesh.
        tags: those that count.
    """
    areas: Array = assembled(ufl.TestFunction(Q) * _over(Q, facet_tags, tags), Q).x.array
    return areas


def facet_means(function: fem.Function, space: Any, facet_tags: Any, tag: int) -> fem.Function:
    """Return a Function with the values that tagged facets have at their nodes. Collective.

    A facet on the boundary belongs to one cell, whose value it has. Where several facets meet in a
    node that is their mean, weighed by area. Zero elsewhere.

    Args:
        function: a scalar or a vector, of any element that has values at corners of facets.
        space: of degree 1, of the same shape, for what is returned.
        facet_tags: of facets on the boundary of the mesh.
        tag: the surface.
    """
    ds = _over(space, facet_tags, (tag,))(metadata=AT_CORNERS)
    test = ufl.TestFunction(space)
    one = ufl.as_ufl(1.0) if test.ufl_shape == () else ufl.as_vector([1.0] * len(test))
    total, areas = (assembled(ufl.inner(of, test) * ds, space).x.array for of in (function, one))
    result = fem.Function(space)
    np.divide(total, areas, out=result.x.array, where=areas > 0.0)
    return result


def _over(space: Any, facet_tags: Any, tags: Collection[int]) -> Any:
    """Return the measure of tagged facets: under one number, for which forms are compiled."""
    facets = facet_tags.indices[np.isin(facet_tags.values, list(tags))]
    numbered = dolfinx.mesh.meshtags(
        space.mesh, facet_tags.dim, facets, np.ones(len(facets), dtype=np.int32)
    )
    return ufl.Measure("ds", domain=space.mesh, subdomain_data=numbered, subdomain_id=1)
