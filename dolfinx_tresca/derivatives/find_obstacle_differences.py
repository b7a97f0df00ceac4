"""Central differences of B with respect to a Constant on which positions of obstacles depend.

They are part of the derivatives with respect to this Constant.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.contact.contact_system import ContactSystem
from dolfinx_tresca.derivatives.obstacle_differences import ObstacleDifferences
from dolfinx_tresca.dual.moved import moved_jump
from dolfinx_tresca.dual.nodal_values import replaced, values_of
from dolfinx_tresca.errors import InputError

#: Step of the central differences: the change of the distance from an obstacle, relative to the
#: extent of the mesh. The truncation error is about the square of the step, the rounding error
#: about the rounding of one value divided by the step.
DIFFERENCE_STEP = 1e-5


def obstacle_differences(
    contact: ContactSystem,
    constant: fem.Constant,
    direction: Array,
    *,
    in_all_steps: bool = False,
) -> ObstacleDifferences | None:
    """Return the central differences of B in a direction of a Constant. Collective.

    Args:
        contact: the problem, after a solve.
        constant: the Constant, on which positions of obstacles may depend.
        direction: change of the Constant, an array of the shape of its value.
        in_all_steps: whether the Constant changes in all load steps so far. If not, it changes only
            after the last accepted step: the slip of the accepted steps stays the same vector at
            each node.

    Returns:
        The differences, which the caller destroys; None if no obstacle depends on the Constant.

    Raises:
        InputError: an obstacle moves in the load step of the last solve, or a node faces the
            obstacle at only one of the two displaced positions of the obstacle.
    """
    surfaces, obstacles = contact.surfaces, contact.surfaces.obstacles
    jump, origin = surfaces.jump, None
    moves = obstacles.depending_on(constant, jump)
    if not moves.any():
        return None
    if not in_all_steps:
        solved = contact.solved
        assert solved is not None
        origin, moves_in_step = solved.dual.history.origin, moves & solved.moved
        for pair, moved, (_, t) in zip(contact.pairs, moves_in_step, jump.slices, strict=True):
            if moved and contact.comm.allreduce(bool(origin[t].any()), op=MPI.LOR):
                raise InputError(
                    f"contact pair {pair}: the derivative with respect to the place of an "
                    "obstacle is not known for a load step in which move_to() moves it."
                )
    size = obstacles.step_of_unit_change(constant, direction, jump)
    step = DIFFERENCE_STEP * obstacles.extent * size
    bounds, found = surfaces.slip_bounds(), []
    for factor in (step, -step):
        with replaced([constant], [values_of(constant) + factor * np.ravel(direction)]):
            one = moved_jump(jump, contact.pairs, surfaces.state.geometry, moves)
        turned = one.along_axes(bounds)
        if turned is not one:
            one.destroy()
        found.append(turned)
    result = ObstacleDifferences(found[0], found[1], step or 1.0, bounds, jump, origin)
    if not contact.comm.allreduce(result.have_rows_of(jump), op=MPI.LAND):
        result.destroy()
        raise InputError(
            "nodes are at the edge of what faces an obstacle, or of its search limit: there is "
            "no derivative with respect to its place. Compare two solutions."
        )
    return result
