"""B for obstacles at places on both sides of the present one."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.dual.moved import moved_jump
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.problem.contact_system import ContactSystem
from dolfinx_tresca.problem.obstacles import along
from dolfinx_tresca.solution.beside import JumpsBeside

#: Change of the distance from an obstacle over the extent of the mesh, in central differences of
#: the pairing: their error is about its square, and rounding over it.
BESIDE = 1e-5


def jumps_beside(
    contact: ContactSystem,
    constant: fem.Constant,
    direction: Array,
    *,
    in_all_steps: bool = False,
) -> JumpsBeside | None:
    """Return B for obstacles a little before and after along a Constant. Collective.

    Args:
        contact: the problem, after a solve.
        constant: a Constant.
        direction: change of its values, in their shape.
        in_all_steps: whether the Constant changes in all load steps so far, in place of after the
            accepted ones, whose slip is then carried over to the changed place.

    Returns:
        None if no obstacle depends on it. The caller destroys the operators.

    Raises:
        InputError: an obstacle moves in the load step of the last solve, or nodes find or lose it
            in between.
    """
    obstacles = contact.obstacles
    moves = obstacles.depending_on(constant)
    if not moves.any():
        return None
    jump, origin = contact.jump, None
    if not in_all_steps:
        assert contact.solved is not None
        origin = contact.solved[0].history.origin
        moves_in_step = moves & contact.moved_in_solve
        for pair, moved, (_, t) in zip(contact.pairs, moves_in_step, jump.slices, strict=True):
            if moved and contact.comm.allreduce(bool(origin[t].any()), op=MPI.LOR):
                raise InputError(
                    f"contact pair {pair}: the derivative with respect to the place of an "
                    "obstacle is not known for a load step in which move_to() moves it."
                )
    size = np.inf
    if direction.any():
        size = obstacles.step_of_unit_change(constant, direction, jump)
    step = BESIDE * obstacles.extent * (size if np.isfinite(size) else 0.0)
    bounds, found = contact.slip_bounds(), []
    for factor in (step, -step):
        with along(constant, direction, factor):
            one = moved_jump(jump, contact.pairs, contact.geometry, moves)
        turned = one.along_axes(bounds)
        if turned is not one:
            one.destroy()
        found.append(turned)
    result = JumpsBeside(found[0], found[1], step or 1.0, bounds, jump, origin)
    if not contact.comm.allreduce(result.are_beside(jump), op=MPI.LAND):
        result.destroy()
        raise InputError(
            "nodes are at the edge of what faces an obstacle, or of its search limit: there is "
            "no derivative with respect to its place. Compare two solutions."
        )
    return result
