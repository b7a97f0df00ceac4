"""The contact normal: the direction along which gaps and normal jumps are measured.

Where two smooth surfaces touch, their normals are opposed, and either one is the contact normal.
Facets approximate surfaces, so the normals of both sides differ by angles of the size by which the
normals turn from facet to facet. The first variation of the gap between two surfaces is the jump
of the displacement along the normal of the side whose normal is better known: at a kink, on a
chamfer, next to a sharp edge or at the rim of a surface, this is the partner's; where a small
roller lies on a strip, it is the strip's. So the contact normal is the mean of the own normal and
of the reversed normal of the partner, each weighted by the inverse square of the angle by which the
side's normal turns over the facet there. The rule is symmetric: if the sides are exchanged, the
contact normal is reversed.

The normal multiplier acts along this direction on both sides, with opposite signs. The gap is the
vector between the surfaces, projected onto this direction, so that the rows of N are its variation.
A rigid obstacle that the mesh resolves keeps its exact normal (`obstacle.RESOLVED_ANGLES`).
"""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca.pairing.search.nodes import SurfaceNodes, free_normals
from dolfinx_tresca.pairing.search.smooth_surface import FLAT_ANGLE

#: Angle between opposed normals [rad], beyond the angles by which both turn, up to which points of
#: the surfaces are paired (29 degrees). Flat facets that are farther from being parallel cannot
#: touch but at their ends. With twice this angle a chamfer of 45 degrees is paired with the wall
#: that it recedes from, along a normal between both; with half of it, wedges lose their partners
#: after small rotations.
OPPOSED_ANGLE = 0.5

#: Length of the mean of unit normals up to which they cancel, and the own normal is kept.
CANCELLED = 0.1


def contact_normals(
    own: Array,
    partner: Array,
    own_turn: Array,
    partner_turn: Array,
) -> tuple[Array, Mask]:
    """Return the contact normals (n, 3) at points of the secondary side. Not collective.

    The second result is whether the normals of both sides are opposed at each point, (n,), as far
    as the angles allow by which they turn (`OPPOSED_ANGLE`).

    Args:
        own: (n, 3) outward unit normals of the secondary side.
        partner: (n, 3) outward unit normals of the primary side at the opposite points.
        own_turn: (n,) angles by which the normals of the secondary side turn over their facets
            [rad].
        partner_turn: (n,) angles by which the normals of the primary side turn [rad].
    """
    square, partner_square = own_turn**2 + FLAT_ANGLE**2, partner_turn**2 + FLAT_ANGLE**2
    share = (partner_square / (square + partner_square))[:, None]  # of the own normal
    normals = share * own - (1.0 - share) * partner
    angle = np.arccos(np.clip(-np.einsum("ni,ni->n", own, partner), -1.0, 1.0))
    length = np.linalg.norm(normals, axis=1)[:, None]
    normals = np.divide(normals, length, out=own.copy(), where=length > CANCELLED)
    return normals, np.asarray(angle <= OPPOSED_ANGLE + own_turn + partner_turn)


def nodal_contact_normals(means: Array, nodes: SurfaceNodes) -> Array:
    """Return unit contact normals (n, 3) at nodes, without prescribed components. Not collective.

    Args:
        means: (n, 3) means of the contact normals around each node; zero at nodes that face
            nothing, which keep their own normals.
        nodes: the nodes of the secondary side.
    """
    kept = np.linalg.norm(means, axis=1) <= CANCELLED
    return free_normals(np.where(kept[:, None], nodes.normals, means), nodes.free)
