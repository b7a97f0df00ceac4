"""An interior-point method for the laws of contact and friction with a known A. Numpy and scipy.

It finds initial guesses for `SemismoothNewton`, where that method fails: it loses digits near the
solution, but the number of its steps hardly depends on that of bodies, and it needs no guess.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array

from dolfinx_tresca._base.arrays import LEAST_DIVISOR, Array, Indices
from dolfinx_tresca._base.tolerances import MOST_STEPS
from dolfinx_tresca.solvers.feasible_set import FeasibleSet
from dolfinx_tresca.solvers.problem import DualProblem
from dolfinx_tresca.solvers.products import NodalMaps, WholeModel

#: The method ends when the complementarity y'z is below this multiple of its value at the start.
#: That value is far above the energy of the solution: on walls and piles, some steps of Newton's
#: method remain. With 1e-16, rounding makes systems of walls singular.
COMPLEMENTARY = 1e-12

#: Part of the way to the boundary of the cones that a step takes at most.
TO_BOUNDARY = 0.99

#: The centring of a step, the factor by which it is to multiply y'z, is (1 - t)^2 for the length t
#: of the previous step, but between these two numbers; in the first step, it is the largest.
LEAST_CENTRING, LARGEST_CENTRING = 0.05, 0.8

#: First softness of the constraints, in units of that with which Newton's method starts; it falls
#: with the root of y'z. With 1, piles of stones take 12 % more steps of Newton's method.
FIRST_SOFTNESS = 100.0


class SecondOrderCones:
    """The m cones y_0 >= |(y_1, y_2)|, with y = H x + h (m, 3), that contain the multipliers x.

    They are the half-lines of pressures, with y_1 = y_2 = 0, and a cone for each linear function of
    the pressure that bounds friction, such as c + F p and c + l. If the bound is a constant, so is
    y_0, and the cone is called a disc. Without a bound, or if it is infinite, there is no cone.

    Each component of y depends on one multiplier or none: H has the number `_scale` (m, 3) in the
    column `_position` (m, 3); -1: none.

    Attributes:
        movable: (size,) 1; 0 for multipliers that are zero, since their slip bound is.
        constant: (m, 3) h.
    """

    def __init__(self, admissible: FeasibleSet, diagonal: Array) -> None:
        """Find the cones of this rank; `diagonal` (size,) is diag(A). Not collective."""
        self.size = admissible.size
        # the one or two tangential multipliers of each disc, (n_discs, 2)
        order = np.argsort(admissible.node, kind="stable")
        node = admissible.node[order]
        tangents = np.full((len(admissible.radius), 2), -1)
        axis = np.arange(len(node)) - np.searchsorted(node, node)  # 0 or 1 in the node's disc
        tangents[node, axis] = admissible.tangential[order]
        self.movable = 1.0 - admissible.at_tangents((~admissible.movable).astype(float))
        # half-lines of pressures; y is in units of energy^(1/2), equally for the three components
        none = np.full((len(admissible.normal), 2), -1)
        positions: list[Indices] = [np.column_stack([admissible.normal, none])]
        scales = [np.tile(np.sqrt(diagonal[admissible.normal])[:, None], 3)]
        constants: list[Array] = [np.zeros(len(admissible.normal))]
        # for each linear bound c + s p a cone with y_0 = c + s p, and a disc where s = 0
        disc_scale = np.sqrt(admissible.disc_means(diagonal))
        for constant, slope in admissible.linear_bounds():
            has_cone = admissible.movable & np.isfinite(constant) & (tangents[:, 0] >= 0)
            bounded = np.flatnonzero(has_cone)
            slope = np.where(admissible.normal_of >= 0, slope, 0.0)[bounded]
            normals = np.where(slope > 0.0, admissible.normal_of[bounded], -1)
            positions.append(np.column_stack([normals, tangents[bounded]]))
            factors = np.column_stack([slope, np.ones_like(slope), np.ones_like(slope)])
            scales.append(disc_scale[bounded, None] * factors)
            constants.append(disc_scale[bounded] * constant[bounded])
        self._position = np.vstack(positions)
        self._scale = np.where(self._position >= 0, np.vstack(scales), 0.0)
        self.constant = np.zeros_like(self._scale)
        self.constant[:, 0] = np.concatenate(constants)

    def linear(self, x: Array) -> Array:
        """Return H x (m, 3)."""
        return np.asarray(self._scale * np.append(x, 0.0)[self._position])  # -1: the appended zero

    def transposed(self, z: Array) -> Array:
        """Return H'z (size,)."""
        result = np.zeros(self.size + 1)
        np.add.at(result, self._position, self._scale * z)
        return result[:-1]

    def between(self, blocks: Array) -> csr_array:
        """Return H'D H (size, size) for blocks D (m, 3, 3), one for each cone."""
        values = self._scale[:, :, None] * blocks * self._scale[:, None]
        rows = np.broadcast_to(self._position[:, :, None], values.shape)
        columns = np.broadcast_to(self._position[:, None], values.shape)
        used = (rows >= 0) & (columns >= 0)
        entries = values[used], (rows[used], columns[used])
        return csr_array(coo_array(entries, shape=(self.size, self.size)))  # adds up the cones


def determinants(y: Array) -> Array:
    """Return det y = y_0^2 - |(y_1, y_2)|^2 (m,) for y (m, 3) in cones: > 0 despite rounding."""
    length = np.linalg.norm(y[:, 1:], axis=1)
    difference = np.maximum(y[:, 0] - length, np.finfo(float).eps * y[:, 0])
    return np.asarray(difference * (y[:, 0] + length))


def reflected(y: Array) -> Array:
    """Return the reflection J y = (y_0, -y_1, -y_2), (m, 3)."""
    return np.asarray(y * np.array([1.0, -1.0, -1.0]))


def inverse_limit(y: Array, step: Array) -> Array:
    """Return 1 / t (m,) for the largest t with y + t step in its cone; 0 if there is no largest."""
    # the hyperbolic rotation of y to (root, 0, 0) keeps the cone, and takes the step to
    # (along, across): the end is in the cone if root + t along >= t |across|
    root = np.sqrt(determinants(y))
    unit = y / root[:, None]
    along = (reflected(unit) * step).sum(axis=1)
    factor = (along + step[:, 0]) / (1.0 + unit[:, 0])
    across = step[:, 1:] - factor[:, None] * unit[:, 1:]
    inverse = (np.linalg.norm(across, axis=1) - along) / root
    return np.asarray(np.maximum(inverse, 0.0))


def turned(v: Array, axis: Array) -> Array:
    """Return v (m, 3) after the hyperbolic rotation that takes (1, 0, 0) to the axis (m, 3)."""
    along = (axis[:, 1:] * v[:, 1:]).sum(axis=1)
    factor = v[:, 0] + along / (1.0 + axis[:, 0])
    result: Array = v + factor[:, None] * axis
    result[:, 0] = axis[:, 0] * v[:, 0] + along
    return result


class Scaling:
    """The symmetric maps W of Nesterov and Todd (1997) with W z = W^-1 y, for y and z in cones.

    W is a size s times the hyperbolic rotation that takes (1, 0, 0) to the axis w, with det w = 1
    (`determinants`): W^2 = s^2 (2 w w' - J) takes z to y, where J reflects y_1 and y_2.

    Attributes:
        common: (m, 3) W z, which is W^-1 y.
        determinant: (m,) det (W z).
        inverse_square: (m, 3, 3) W^-2.
    """

    def __init__(self, y: Array, z: Array) -> None:
        """Compute the maps for points y, z (m, 3) inside of the cones."""
        # with y and z scaled to determinant 1, w is (y + J z) / sqrt(2 + 2 y'z)
        det_y, det_z = determinants(y), determinants(z)
        unit_y, unit_z = y / np.sqrt(det_y)[:, None], z / np.sqrt(det_z)[:, None]
        mean = np.sqrt(0.5 + 0.5 * np.maximum((unit_y * unit_z).sum(axis=1), 1.0))
        axis = (unit_y + reflected(unit_z)) / (2.0 * mean)[:, None]
        self._size = ((det_y / det_z) ** 0.25)[:, None]
        self.common = self._size * turned(z, axis)
        self.determinant = np.sqrt(det_y * det_z)
        # W^-1 is the rotation to J w, divided by s
        self._inverse_axis = reflected(axis)
        squares = 2.0 * self._inverse_axis[:, :, None] * self._inverse_axis[:, None]
        blocks = squares - np.diag([1.0, -1.0, -1.0])
        self.inverse_square = blocks / self._size[:, :, None] ** 2

    def invert(self, v: Array) -> Array:
        """Return W^-1 v (m, 3)."""
        return turned(v, self._inverse_axis) / self._size


def interior_point(
    problem: DualProblem, model: WholeModel, admissible: FeasibleSet, r0: Array, softness: float
) -> tuple[Array, Array]:
    """Return multipliers x (size,) and c (k,) near a solution with the model M of A. Collective.

    With y = H x + h and z in the same cones (`SecondOrderCones` of `admissible`), it solves

        M x + r0 - G c - H'(z - o) = 0,   G'x + S c = e,   y'z = 0,

    where r0 (size,) is the gradient at zero. For Tresca's law H'o is zero, and these are conditions
    of a minimum: (y_1, y_2) are tractions and (z_1, z_2) slips, but for signs and units. For cones
    that open with the pressure, a minimum without o would have a friction that opens the gap by F
    |slip|. Hence o = (|(z_1, z_2)|, 0, 0) takes this opening back (de Saxcé and Feng 1998, The
    bipotential method); the equations are then those of Coulomb's law. With a given o, the problem
    is convex (Acary, Cadoux, Lemaréchal and Malick 2011); here o changes with z in each step.

    A step solves the linearised equations with W dz + W^-1 dy = s m v^-1 - v in each cone, where W
    is Nesterov and Todd's scaling, v = W z, s the centring, and m the mean of y'z. Inserting dy =
    H dx and E, the derivative of z - o, makes this a system for dx and dc with M + H'E W^-2 H. The
    step ends inside of the cones. Constraints are softened as in `SemismoothNewton.step`, by a
    multiple of `softness` that falls towards zero. The start is the solution with W = I and z = -y,
    both moved into the cones. The result may be far from a solution: callers compute its residual.
    """
    reductions, constraints = problem.reductions, problem.constraints
    G = constraints.columns
    cone_map = SecondOrderCones(admissible, model.diagonal)
    movable = diags_array(cone_map.movable, format="csr")

    def largest(values: Array) -> float:
        return reductions.largest(float(values.max(initial=0.0)))

    def solution(blocks: Array, right: Array, missing: Array, soft: float) -> tuple[Array, Array]:
        S = constraints.softness_with(FIRST_SOFTNESS * soft * softness)
        maps = NodalMaps(movable, cone_map.between(blocks), movable)
        return model.solve_on_face(maps, right, G, S, missing)

    # the start
    h = cone_map.constant
    identity = np.broadcast_to(np.eye(3), (len(h), 3, 3)).copy()
    x, c = solution(identity, -r0 - cone_map.transposed(h), constraints.values, 1.0)
    y = cone_map.linear(x) + h
    z = -y
    start_size = largest(np.linalg.norm(y, axis=1))
    if start_size == 0.0:  # no loads and constant bounds, or no cones
        return x, c
    for point in (y, z):  # moved along the axes of the cones until it is inside of all
        outside = largest(np.linalg.norm(point[:, 1:], axis=1) - point[:, 0])
        point[:, 0] += start_size + outside
    count = float(reductions.total(np.array(float(len(y)))))
    complementarity = at_start = float(reductions.inner(y.ravel(), z.ravel())) / count
    centring = LARGEST_CENTRING
    for _ in range(MOST_STEPS):
        # the right-hand side s m v^-1 - v, since v^-1 is J v / det v
        scaling = Scaling(y, z)
        v = scaling.common
        target = centring * complementarity / scaling.determinant[:, None] * reflected(v) - v
        # E, the derivative of z - o by z: H' ignores its first row in discs, o is 0 in half-lines
        slip = np.linalg.norm(z[:, 1:], axis=1)
        E = identity.copy()
        E[:, 0, 1:] = -z[:, 1:] / slip.clip(np.finfo(float).tiny)[:, None]
        # insert dz = W^-1 (target - W^-1 dy), where dy = H dx + lacking, into
        # M dx - G dc - H'E dz = H'E z - (M x + r0 - G c), since z - o = E z
        lacking = cone_map.linear(x) + h - y
        change = scaling.invert(target - scaling.invert(lacking))
        right = cone_map.transposed(np.einsum("mij,mj->mi", E, z + change))
        right -= model.apply(x) + r0 - G @ c
        soft = float(np.sqrt(complementarity / at_start))
        blocks = E @ scaling.inverse_square
        dx, dc = solution(blocks, right, constraints.residual(x, c), soft)
        dy = cone_map.linear(dx) + lacking
        dz = scaling.invert(target - scaling.invert(dy))
        # the longest step that stays in the cones
        limit = max(largest(inverse_limit(y, dy)), largest(inverse_limit(z, dz)))
        t = min(1.0, TO_BOUNDARY / max(limit, LEAST_DIVISOR))
        x, c, y, z = x + t * dx, c + t * dc, y + t * dy, z + t * dz
        complementarity = float(reductions.inner(y.ravel(), z.ravel())) / count
        if not complementarity > COMPLEMENTARY * at_start:
            break
        centring = min(max((1.0 - t) ** 2, LEAST_CENTRING), LARGEST_CENTRING)
    return x, c
