"""Nodal areas of tagged facets, and nodal means of discontinuous fields over tagged facets."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.assembly import assembled

#: Quadrature at the corners of facets, which lumps integrals: only values at a node contribute to
#: the node's integral.
AT_CORNERS = {"quadrature_rule": "vertex", "quadrature_degree": 1}


def node_areas(Q: Any, facet_tags: Any, tags: Collection[int], axisymmetric: bool = False) -> Array:
    """Return integrals of hat functions over tagged facets, (nodes with ghosts,). Collective.

    Args:
        Q: scalar space of degree 1.
        facet_tags: tags of boundary facets of Q's mesh.
        tags: the tags of the facets to integrate over.
        axisymmetric: whether the facets are meridians of rings about the axis x = 0.
    """
    size = 2.0 * np.pi * ufl.SpatialCoordinate(Q.mesh)[0] if axisymmetric else ufl.as_ufl(1.0)
    form = size * ufl.TestFunction(Q) * _tagged_measure(Q, facet_tags, tags)
    areas: Array = assembled(form, Q).x.array
    return areas


def facet_means(function: fem.Function, space: Any, facet_tags: Any, tag: int) -> fem.Function:
    """Average a field over the tagged facets at each node. Collective.

    On a boundary facet the field has the values of the facet's cell. The result at a node is the
    mean over its tagged facets, weighted by area; it is zero at nodes without tagged facets.

    Args:
        function: a scalar or vector field of any element with values at the corners of facets.
        space: space of degree 1 for the result, with as many components as the field.
        facet_tags: tags of boundary facets of the mesh.
        tag: the tag of the facets.
    """
    ds = _tagged_measure(space, facet_tags, (tag,))(metadata=AT_CORNERS)
    test = ufl.TestFunction(space)
    one = ufl.as_ufl(1.0) if test.ufl_shape == () else ufl.as_vector([1.0] * len(test))
    total, areas = (assembled(ufl.inner(of, test) * ds, space).x.array for of in (function, one))
    result = fem.Function(space)
    np.divide(total, areas, out=result.x.array, where=areas > 0.0)
    return result


def _tagged_measure(space: Any, facet_tags: Any, tags: Collection[int]) -> Any:
    """Return the measure of all facets with any of the tags.

    All these facets get one new tag, so that a form is compiled only once, whatever the tags are.
    """
    facets = facet_tags.indices[np.isin(facet_tags.values, list(tags))]
    numbered = dolfinx.mesh.meshtags(
        space.mesh, facet_tags.dim, facets, np.ones(len(facets), dtype=np.int32)
    )
    return ufl.Measure("ds", domain=space.mesh, subdomain_data=numbered, subdomain_id=1)
