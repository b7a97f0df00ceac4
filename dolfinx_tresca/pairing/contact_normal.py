"""The contact normal: the direction along which gaps and normal jumps are measured.

Where two smooth surfaces touch, their normals are opposed, and either one is the contact normal.
Facets approximate surfaces, so the normals of both sides differ by angles of the size by which the
normals turn from facet to facet. The first variation of the gap is the jump of the displacement
along the normal of the side whose normal is better known: at a kink, on a chamfer, next to a sharp
edge or at a rim, this is the partner's. So the contact normal is the mean of the own normal and of
the reversed normal of the partner, each weighted by the inverse square of the angle by which the
side's normal turns over the facet there, in the direction in which the two normals differ: a bore
turns round its shaft, and not along it. If the sides are exchanged, the normal is reversed.

The normal multiplier acts along this direction on both sides, with opposite signs. The gap is the
vector between the surfaces, projected onto this direction; N u is by how much u closes the gap.
A rigid obstacle that the mesh resolves keeps its normal (`obstacle_integrals.RESOLVED_ANGLE`).
"""

from __future__ import annotations

import numpy as np

import basix

from dolfinx_tresca._base.arrays import Array, Indices, Mask, dots, unit
from dolfinx_tresca.pairing.facets import MESH_ROUNDING, SurfaceNodes, tangents

#: Angle between opposed normals [rad], beyond the angles by which both turn, up to which points are
#: paired: flat facets farther from being parallel touch at their ends only. With twice this angle a
#: chamfer of 45 degrees is paired with its wall; with half, wedges lose partners as they rotate.
OPPOSED_ANGLE = 0.5
#: Length of a mean of unit normals up to which they cancel; the own normal then takes its place.
CANCELLED = 0.1

#: Sum of the slopes at both ends of a side of a facet, relative to their difference, up to which
#: the surface counts as curved over the side. Towards 1, at a kink between flat facets, the height
#: falls to zero. (With half of this, heights on irregular meshes would change.)
UNEVEN = 0.5
#: Angle by which normals turn over a facet next to a kink [rad] up to which the fitted normals at
#: the kink are kept; from twice this angle on, the facet's own normal takes their place. (With
#: zero, the friction of a block on a plank that it dents varies by 1 % as nodes pass.)
KINK_ANGLE = 0.1
#: Angle by which normals turn over a facet [rad] below which the facet counts as flat, so that
#: rounding does not decide between two flat sides, whose normals are equal to this accuracy.
FLAT_ANGLE = 1e-3

#: Weights of the Tikhonov regularisation in `fitted_normals`, relative to that of a neighbour's
#: height: of the two slopes, of the mean curvature and of two differences of curvatures. With few
#: neighbours the fit stays close to a sphere with the mean normal.
TILT_COST, CURVATURE_COSTS = 1e-1, (0.0, 1e-3, 1e-3)


def contact_normals(own: Array, partner: Array, own_turn: Array, partner_turn: Array) -> Array:
    """Return the unit contact normals (..., 3) at points of the secondary side.

    The outward unit normals `own` and `partner` (..., 3) turn over facets by angles (...) [rad].
    """
    square, partner_square = own_turn**2 + FLAT_ANGLE**2, partner_turn**2 + FLAT_ANGLE**2
    share = (partner_square / (square + partner_square))[..., None]  # of the own normal
    normals = share * own - (1.0 - share) * partner
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.asarray(np.divide(normals, length, out=own.copy(), where=length > CANCELLED))


class SmoothSurface:
    """The smooth surface that facets approximate: exact where its geometry is given, else fitted.

    The normals n_c of the fitted surface are known at the corners x_c (`fitted_normals`). Over each
    point of a straight facet the mean of the heights of the tangent planes, weighted with the hat
    functions h_c, is twice the height (sagitta) of a parabolic surface. So this height is the sum
    over pairs of corners of h_c h_d (n_d - n_c).(x_d - x_c) / 2, to second order in the facet's
    size. On a parabolic surface (n_c + n_d).(x_d - x_c) is zero; next to a kink between flat
    facets, where the normal leans at one corner only, it is as large as the difference: there the
    height is zero, and beyond `KINK_ANGLE` the surface is the facet itself. If any facet has curved
    edges (degree 2), none has a height, and their normals are those of the facets.

    Attributes:
        turns: (n,) angle by which the normal turns over each facet [rad]: twice the largest angle
            between its normal and those at its corners; next to a kink it falls to zero.
        is_flat: whether no facet of this rank has a height, and no normal turns.
        beyond_edges: (n, k, 3) outward unit normals of the smooth patches beyond the sharp edges at
            each facet (`_normals_beyond_edges`), or zero. At the ends of a curve (2D) the body is
            taken to go on at right angles, as at the corner of a box.
        corner_normals: (n, corners, 3) outward unit normals of the surface at corners of facets.
    """

    def __init__(self, nodes: SurfaceNodes) -> None:
        """Fit the surface; valid on facets with two rings around (`halos`). Not collective."""
        facets = nodes.facets
        self.facets, self._facet_normals = facets, facets.mean_normals
        self._corners = facets.points[:, : facets.corners]
        self._first, self._second = np.triu_indices(facets.corners, 1)  # pairs of corners
        self._along = self._corners[:, self._second] - self._corners[:, self._first]
        # a node is at the rim if it is on a side that belongs to one facet only
        side_corners = basix.topology(basix.CellType[facets.cell])[facets.dim - 1]
        sides_of_facets = nodes.facet_nodes[:, side_corners].reshape(-1, facets.dim)
        sides, count = np.unique(np.sort(sides_of_facets), axis=0, return_counts=True)
        at_rim = np.isin(nodes.facet_nodes, sides[count == 1])  # (n, corners)
        self.corner_normals = fitted_normals(nodes)[nodes.facet_nodes]
        smooth = self._smoothness(nodes, at_rim)
        if facets.dim == 1:
            # The normals at both ends of a curve (2D) turn until the curve is parabolic over the
            # facet: with the end c and the opposite corner d, (n_c + n_d).(x_d - x_c) becomes zero,
            # as far as the curve is smooth. In 3D, nodes at the rim have neighbours enough.
            for c, d in ((0, 1), (1, 0)):
                ends = np.flatnonzero(at_rim[:, c] & ~at_rim[:, d])
                along = unit(self._corners[ends, d] - self._corners[ends, c])
                both = self.corner_normals[ends, c] + self.corner_normals[ends, d]
                lean = dots(both, along) * smooth[ends]
                self.corner_normals[ends, c] -= lean[:, None] * along
            self.corner_normals = unit(self.corner_normals)

        cosines = dots(self.corner_normals, self._facet_normals[:, None])  # (n, corners)
        self._height_factors = self._corner_pair_heights(smooth, cosines)
        # beside kinks, the corners of facets get the facet's normal, see `KINK_ANGLE`
        excess = np.clip(turned_angles(cosines) / KINK_ANGLE - 1.0, 0.0, 1.0)
        kinked = ((1.0 - smooth) * excess)[:, None, None]
        self._fitted_normals = self.corner_normals
        self.corner_normals = (1.0 - kinked) * self._fitted_normals
        self.corner_normals += kinked * self._facet_normals[:, None]

        # where the geometry is known, its normals take the place of `corner_normals`
        self._exact = np.asarray(np.isfinite(facets.offsets[:, :1]).any(axis=(1, 2)))
        if self._exact.any():
            exact = np.flatnonzero(self._exact)
            x = np.tile(facets.lagrange_points(1), (len(exact), 1))
            _, normals = facets.exact_surface_at(np.repeat(exact, facets.corners), x)
            self.corner_normals[exact] = normals.reshape(-1, facets.corners, 3)
        self.corner_normals = unit(self.corner_normals)
        self.turns = turned_angles(dots(self.corner_normals, self._facet_normals[:, None]))
        self.is_flat = not (self._height_factors.any() or (self.turns > FLAT_ANGLE).any())

        # `_at_end` (n,) is 1 for facets where the surface ends: at a sharp edge, or at a rim. In 3D
        # flat facets at a rim do not count: a slab of one layer of cells has no others. Those that
        # turn by `KINK_ANGLE` do, others count in part, and those with known geometry never
        self.beyond_edges = _normals_beyond_edges(nodes)
        curved = np.minimum(self.turns / KINK_ANGLE, 1.0) ** 2 if facets.dim == 2 else 1.0
        at_curved_rim = curved * (at_rim.any(axis=1) & ~self._exact)
        self._at_end = np.maximum(self.beyond_edges.any(axis=(1, 2)), at_curved_rim)
        if facets.dim == 1:  # unit vectors out of both ends of the curve, along it
            ahead = self._corners - self._corners[:, ::-1]
            ahead *= (at_rim / np.linalg.norm(ahead, axis=2))[:, :, None]
            self.beyond_edges = np.concatenate([self.beyond_edges, ahead], axis=1)

    def _corner_pair_heights(self, smooth: Array, cosines: Array) -> Array:
        """Return the factors (n, pairs of corners) of h_c h_d in the fitted height [length].

        They are multiplied by `smooth` (n,), which is zero next to kinks (`_smoothness`), and zero
        on all facets if none has a height beyond rounding, or any is bent. `cosines` (n, corners)
        are those of the angles between the normals at corners and the facet's normal.
        """
        # n_c.(x_d - x_c) are sines of angles, times a length. Heights on a circle, whose slopes are
        # tangents, would be too small with sines and too large with tangents; the geometric mean
        # is right to fourth order in the angle. Cosines of folded facets may be negative: 0.5 is
        # the least that counts.
        means = 0.5 * (cosines[:, self._first] + cosines[:, self._second])
        stretch = np.sqrt(np.maximum(means, 0.5))
        # n_c.(x_d - x_c) and n_d.(x_d - x_c) of the pairs of corners
        start = dots(self.corner_normals[:, self._first], self._along)
        end = dots(self.corner_normals[:, self._second], self._along)
        heights = 0.5 * (end - start) / stretch * smooth[:, None]
        sizes = np.ptp(self._corners, axis=1).max(axis=1)
        rounding = (MESH_ROUNDING + self.facets.rounding) * sizes
        has_height = bool((np.abs(heights).max(axis=1, initial=0.0) > rounding).any())
        return np.asarray(heights * (has_height and not self.facets.bent))

    def _smoothness(self, nodes: SurfaceNodes, at_rim: Mask) -> Array:
        """Return a factor (n,) for each facet: 1 on parabolic surfaces, 0 next to kinks.

        Nodal normals are less accurate `at_rim` (n, corners). So a facet there is as smooth as the
        least smooth facet around its other corners that is not at the rim itself. If there is none,
        the facets of a curve (2D) count as kinked; on a surface, such as a strip one facet wide,
        the least smooth of all facets around counts.
        """
        # slopes n_c.(x_d - x_c) and n_d.(x_d - x_c) at both ends of a side, (n, pairs of corners):
        # opposite on a parabola, equal at a kink
        start = dots(self.corner_normals[:, self._first], self._along)
        end = dots(self.corner_normals[:, self._second], self._along)
        turned = np.abs(end - start).max(axis=1, initial=0.0)
        uneven = np.abs(end + start).max(axis=1, initial=0.0)
        unevenness = np.divide(uneven, turned, out=np.zeros_like(turned), where=turned > 0.0)
        own = np.clip((1.0 - unevenness) / (1.0 - UNEVEN), 0.0, 1.0)
        inner = ~at_rim.any(axis=1)
        # least smoothness of the inner facets, and of all facets, around the corners of each facet
        of_inner = nodes.reduced(np.minimum, own[inner, None], np.inf, inner)[nodes.facet_nodes]
        around = np.where(at_rim, np.inf, of_inner).min(axis=1, initial=np.inf)
        of_all = nodes.reduced(np.minimum, own[:, None], np.inf)[nodes.facet_nodes].min(axis=1)
        without_inner = 0.0 if self.facets.dim == 1 else of_all
        outer = np.where(np.isinf(around), without_inner, around)
        return np.where(inner, own, outer)

    def points(self, facet: Indices, x: Array) -> Array:
        """Return points (n, q, 3) of the fitted surface over facets (n,) at x (q, dim) [length]."""
        points = self.facets.basis(x) @ self.facets.points[facet]
        hats = np.tile(self.facets.hats(x), (len(facet), 1))
        heights = self.heights(np.repeat(facet, len(x)), hats).reshape(points.shape[:2])
        return np.asarray(points + heights[:, :, None] * self._facet_normals[facet][:, None])

    def heights(self, facet: Indices, hats: Array) -> Array:
        """Return fitted heights (n,) [length] over facets (n,), with hat functions (n, corners)."""
        return dots(hats[:, self._first] * hats[:, self._second], self._height_factors[facet])

    def offsets_and_normals(self, facet: Indices, x: Array) -> tuple[Array, Array]:
        """Return vectors [length] from facets (n,) to the surface, and its unit normals, (n, 3).

        Each is at a reference point x (n, dim). The surface is the exact one if it is known, else
        the fitted one, or the facets themselves if any is bent.
        """
        facets, hats = self.facets, self.facets.hats(x)
        if facets.bent:
            normals = facets.area_vectors_at(facet, x)
        else:
            normals = np.einsum("nc,nci->ni", hats, self.corner_normals[facet])
        normals = unit(normals)
        offsets = self.heights(facet, hats)[:, None] * self._facet_normals[facet]
        exact = self._exact[facet]
        if exact.any():
            offsets[exact], normals[exact] = facets.exact_surface_at(facet[exact], x[exact])
        return offsets, normals

    def turns_along(self, facet: Indices, lean: Array, to_ends: bool = False) -> Array:
        """Return the angles (n,) [rad] by which normals turn over facets (n,) along `lean`.

        `lean` (n, 3) is the sum of both sides' normals. With `to_ends` angles are larger where the
        surface is kinked (those of fitted normals) or ends, so that the partner's normals decide.
        """
        normals = self._facet_normals[facet]
        along = lean - dots(lean, normals)[:, None] * normals
        of_corners = self._fitted_normals if to_ends else self.corner_normals
        # sines and cosines of the angles, times the length of `along`
        corner_sines = [dots(corner[facet], along) for corner in of_corners.swapaxes(0, 1)]
        if self.facets.dim == 1:  # where contact ends, both corners of a curve lean alike
            sines = np.abs(corner_sines).max(axis=0)
        else:  # in space a facet itself may lean
            sines = np.ptp(corner_sines, axis=0) / 2
        cosines = np.sqrt(np.maximum(dots(along, along) - sines**2, 0.0))
        least = 0.5 * np.pi * to_ends * self._at_end[facet]
        return np.asarray(np.maximum(2.0 * np.arctan2(sines, cosines), least))

    def may_touch(
        self, own: tuple[Indices, Array], partner: SmoothSurface, theirs: tuple[Indices, Array]
    ) -> Mask:
        """Return whether this surface and a partner may touch at opposite points (n,).

        `own` and `theirs` are the points' facets (n,) and outward unit normals (n, 3), to be
        opposed up to `OPPOSED_ANGLE` plus the angles by which both turn. A sharp edge has all
        normals between those of its patches: beside an edge of either side, points may also touch
        if the opposite normal is opposed to the edge, but not if to the patch beyond it.
        """
        facet, normals = own
        partner_facet, partner_normals = theirs
        cosine = -dots(normals, partner_normals)
        # the angles by which both turn matter where normals are not opposed up to `OPPOSED_ANGLE`
        turned = np.zeros(len(facet))
        leaning = np.flatnonzero(cosine < np.cos(OPPOSED_ANGLE))
        lean = (normals + partner_normals)[leaning]
        turned[leaning] += self.turns_along(facet[leaning], lean)
        turned[leaning] += partner.turns_along(partner_facet[leaning], lean)
        least = np.cos(np.minimum(OPPOSED_ANGLE + turned, 0.5 * np.pi))
        at_edge, beyond_edge = np.zeros((2, len(facet)), dtype=np.bool_)
        for outward, facing, beyond in (
            (normals, partner_normals, self.beyond_edges[facet]),
            (partner_normals, normals, partner.beyond_edges[partner_facet]),
        ):
            opposed = -dots(beyond, facing[:, None])  # (n, patches beyond edges)
            aligned = dots(beyond, outward[:, None])
            # the reversed normal of the opposite point leans towards the patch beyond the edge
            at_edge |= (opposed > cosine[:, None] * aligned).any(axis=1)
            beyond_edge |= (opposed >= least[:, None]).any(axis=1)
        return np.asarray((cosine >= least) | at_edge & ~beyond_edge)


def _normals_beyond_edges(nodes: SurfaceNodes) -> Array:
    """Return the normals (n, k, 3) of the other smooth patches at the corners of each facet.

    There are rows enough for all facets; those that a facet does not need are zero or repeated.
    """
    own = nodes.facet_nodes
    # the entries of a node, one for each patch, follow each other in `nodes`
    numbers = nodes.numbers[own]
    start = np.searchsorted(nodes.numbers, numbers, side="left")
    end = np.searchsorted(nodes.numbers, numbers, side="right")
    most = (end - start).max(initial=1)
    entry = np.minimum(start[:, :, None] + np.arange(most), end[:, :, None] - 1)
    normals = nodes.normals[entry]  # (n, corners, most, 3)
    normals[entry == own[:, :, None]] = 0.0
    result = normals.reshape(len(own), most * own.shape[1], 3)
    return np.asarray(result[:, result.any(axis=(0, 2))])


def turned_angles(cosines: Array) -> Array:
    """Return angles (n,) [rad] by which normals turn over facets: twice the largest at a corner."""
    # cosines (n, corners) between a facet's normal and the normals at its corners
    return np.asarray(2.0 * np.arccos(np.clip(cosines.min(axis=1, initial=1.0), -1.0, 1.0)))


def fitted_normals(nodes: SurfaceNodes) -> Array:
    """Return unit normals (n, 3) of quadratic surfaces fitted to each node and its neighbours.

    The mean of the facets' normals has an error that is a fixed part of the angle between facets; a
    least-squares fit has none (Cazals and Pouget, Computer Aided Geometric Design 22, 2005). With
    too few neighbours `TILT_COST` keeps the mean. Valid at nodes whose facets are all on this rank.
    """
    count, corners = len(nodes.numbers), nodes.facets.corners
    # all pairs of two corners of a facet: a neighbour counts once for each facet that has both
    node = np.repeat(nodes.facet_nodes, corners, axis=1).ravel()
    neighbour = np.tile(nodes.facet_nodes, corners).ravel()
    node, neighbour = node[node != neighbour], neighbour[node != neighbour]
    x_axis, y_axis = tangents(nodes.normals).swapaxes(0, 1)
    offset = nodes.points[neighbour] - nodes.points[node]
    # the fit is in units of the distance of neighbours, along tangents and the mean normal
    squares = np.bincount(node, np.square(offset).sum(axis=1), minlength=count)
    spacing = np.sqrt(squares / np.maximum(np.bincount(node, minlength=count), 1))[node]
    x = dots(offset, x_axis[node]) / spacing
    y = dots(offset, y_axis[node]) / spacing
    height = dots(offset, nodes.normals[node]) / spacing
    # equal weights of the last two terms make the fit independent of the choice of axes
    terms = np.stack([x, y, x * x + y * y, x * x - y * y, 2.0 * x * y], axis=1)
    matrix, load = np.zeros((count, 5, 5)), np.zeros((count, 5))
    np.add.at(matrix, node, terms[:, :, None] * terms[:, None, :])
    np.add.at(load, node, terms * height[:, None])
    matrix += np.diag(np.square([TILT_COST, TILT_COST, *CURVATURE_COSTS]))
    slopes = np.linalg.solve(matrix, load[:, :, None])[:, :2, 0]
    return unit(nodes.normals - slopes[:, :1] * x_axis - slopes[:, 1:] * y_axis)
