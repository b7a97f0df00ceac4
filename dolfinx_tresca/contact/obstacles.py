"""Rigid obstacles and cut bolts of a problem: their motions, and the forces that hold them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import ROUNDING, Array, Mask, in_space
from dolfinx_tresca._base.bodies import Bodies
from dolfinx_tresca._base.parallel import errors_on_all_ranks, largest_abs, reduce_array
from dolfinx_tresca.contact.step_state import StepState
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.nodal_values import central_differences, values_of
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.floating.equilibrium import FreeMotion, Tools
from dolfinx_tresca.scene.friction import Preload
from dolfinx_tresca.scene.obstacle import FREEDOMS, RigidMotion
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.solution.forces import BoltForce, Resultant

#: A cut is flat if 1 - cos t is at most this for normals at angles t to their mean (0.08 degree).
FLAT = 1e-6


class Obstacles:
    """The rigid obstacles of a problem, and their distances when the surfaces were paired.

    A cut bolt (`Preload`) has a motion, too: that of its secondary side relative to its primary
    side. `extent` is the largest absolute coordinate of the mesh on all ranks [length].
    """

    def __init__(self, V: Any, pairs: Sequence[ContactPair]) -> None:
        """Keep the obstacles of the pairs, and measure the mesh. Collective."""
        self._V, self._pairs = V, pairs
        self._obstacles = [pair.obstacle for pair in pairs]
        self._at_pairing: list[Array] = []
        # (pairs, 3, 4) motions of bolts; the entries of obstacles are not read
        self._bolt_motions = np.tile(np.eye(3, 4), (len(pairs), 1, 1))
        (self.extent,) = largest_abs(V.mesh.comm, V.mesh.geometry.x)

    @property
    def motions(self) -> Array:
        """(pairs, 3, 4) `RigidMotion.matrix` of each pair's obstacle or bolt; else identity."""
        motions = self._bolt_motions.copy()
        for number, obstacle in enumerate(self._obstacles):
            if obstacle is not None:
                motions[number] = obstacle.motion.matrix
        return motions

    def place(self, motions: Array, *, only_held_by_forces: bool = False) -> None:
        """Move all bolts, and all obstacles or only those that forces hold, to their `motions`."""
        self._bolt_motions = motions.copy()
        for obstacle, matrix in zip(self._obstacles, motions, strict=True):
            if obstacle is not None and (obstacle.given_forces or not only_held_by_forces):
                obstacle.motion = RigidMotion.from_matrix(matrix)

    def between(self, before: Array, after: Array, fraction: float) -> Array:
        """Return `motions` for a part of the load: obstacles on their way, bolts as in `after`."""
        result = np.array(after)
        for number, obstacle in enumerate(self._obstacles):
            if obstacle is not None and fraction < 1.0:
                start = RigidMotion.from_matrix(before[number])
                end = RigidMotion.from_matrix(after[number])
                result[number] = start.towards(end, fraction, obstacle.centre).matrix
        return result

    def bolts(self, jump: JumpOperator) -> dict[int, tuple[Preload, Array]]:
        """Return number of pair -> preload, and mean normal (3,) of its flat cut. Collective."""
        comm, bolts = self._V.mesh.comm, {}
        for number, (pair, operators) in enumerate(zip(self._pairs, jump.pairs, strict=True)):
            if not isinstance(pair.friction, Preload):
                continue
            mean = reduce_array(comm, operators.weights @ operators.normals)
            axis = mean / (np.linalg.norm(mean) or 1.0)
            tilt = 1.0 - (operators.normals @ axis).min(initial=1.0)
            if comm.allreduce(tilt, op=MPI.MAX) > FLAT:
                raise InputError(
                    f"contact pair {pair} with a preload must be a flat cut across one bolt: cut "
                    "the bolt by a plane, and give each bolt a pair of its own."
                )
            bolts[number] = pair.friction, in_space(axis)
        return bolts

    def bolt_forces(
        self, jump: JumpOperator, resultants: Sequence[Resultant]
    ) -> dict[str, BoltForce]:
        """Return name of pair -> force in its bolt, from all pairs' resultants. Collective."""
        result = {}
        for number, (preload, axis) in self.bolts(jump).items():
            force = float(axis @ in_space(resultants[number].force))
            result[str(self._pairs[number])] = BoltForce(force, force - preload.value)
        return result

    def check_no_tools(self, purpose: str) -> None:
        """Check that there are no tools: obstacles and bolts with given forces. Not collective."""
        for pair in self._pairs:
            given = pair.obstacle is not None and pair.obstacle.given_forces
            if given or isinstance(pair.friction, Preload):
                raise InputError(
                    f"contact pair {pair}: {purpose} is not known with obstacles held by forces, "
                    "and with preloads."
                )

    def tools(self, jump: JumpOperator, bodies: Bodies, begun: bool) -> Tools | None:
        """Return free motions of obstacles held by forces, and of bolts; None: none. Collective.

        A bolt is pulled until the first load step is accepted (`begun`), and locked after that.
        """
        comm, dim = self._V.mesh.comm, self._V.mesh.geometry.dim
        motions: list[FreeMotion] = []
        bolts = {} if begun else self.bolts(jump)
        for number, (pair, obstacle) in enumerate(zip(self._pairs, self._obstacles, strict=True)):
            if number in bolts:
                preload, axis = bolts[number]
                along = np.append(axis, np.zeros(3))  # a translation, and no rotation
                name, force = f"bolt {pair}", preload.value
                motions.append(FreeMotion(name, "overlap", [number], along, np.zeros(3), force))
                continue
            if obstacle is None or obstacle.given_forces is None:
                continue
            given = obstacle.given_forces
            if pair.sliding == "finite":
                raise InputError(f"{obstacle}, held by forces, needs pairs with small sliding.")
            numbers = [k for k, primary in enumerate(self._obstacles) if primary is obstacle]
            if number != numbers[0]:  # an obstacle of several pairs moves once
                continue
            names = ("y",) if jump.system.axisymmetric else FREEDOMS[dim]
            free = names if given.free is None else given.free
            if not set(free) <= set(names):
                raise InputError(
                    f"{obstacle} may be free along {', '.join(names)} here, found {shown(free)}."
                )
            point = obstacle.motion.applied_to(given.about[:, None])[:, 0]
            places = np.vstack([jump.pairs[k].places for k in numbers])
            (arm,) = largest_abs(comm, places - point[:dim])
            load = np.append(given.force(), given.moment())
            for name in free:
                direction = np.eye(6)[FREEDOMS[3].index(name)]
                label = f"motion along {name[-1]}"
                if name.startswith("r"):
                    label = f"rotation about {name[-1]}"
                    # the amount 1 moves the farthest contact node by a length of about 1
                    direction /= arm or 1.0
                force = float(load @ direction)
                motions.append(FreeMotion(str(obstacle), label, numbers, direction, point, force))
        if not motions:
            return None
        if jump.system.is_tangent:
            raise InputError("obstacles held by forces, and preloads, need a ContactProblem.")
        return Tools.from_rows(motions, bodies, jump.by_pair, jump.stress_scale)

    def note_pairing(self, jump: JumpOperator) -> None:
        """Record distances and normals at the nodes of a new B, for `changed`. Collective."""
        self._at_pairing = self._distances(jump)

    def _distances(self, jump: JumpOperator) -> list[Array]:
        """Return distances and normals (n, 4) at pairs' undeformed nodes, or (0, 4). Collective."""
        has_obstacle = any(obstacle is not None for obstacle in self._obstacles)
        x = self._V.tabulate_dof_coordinates() if has_obstacle else np.zeros((0, 3))
        with errors_on_all_ranks(self._V.mesh.comm):
            return [
                np.column_stack(obstacle.at(x[operators.nodes])) if obstacle else np.zeros((0, 4))
                for obstacle, operators in zip(self._obstacles, jump.pairs, strict=True)
            ]

    def changed(self, jump: JumpOperator) -> Mask:
        """Return (pairs,) whether distances or normals differ from the last pairing. Collective."""
        rounding = ROUNDING * np.array([self.extent, 1.0, 1.0, 1.0])  # of distance and normal
        changed_on_rank = []
        for before, after in zip(self._at_pairing, self._distances(jump), strict=True):
            differs = np.abs(after - before) > rounding + ROUNDING * np.abs(before)
            changed_on_rank.append(int(differs.any()))
        return np.asarray(reduce_array(self._V.mesh.comm, np.array(changed_on_rank)) > 0)

    def rates(self, control: Any, direction: Array | None, jump: JumpOperator) -> Array:
        """Return the largest rates (pairs,) at which distances change with a control. Collective.

        A change of a normal counts times the extent of the mesh. The `direction` is that in which
        the control's values change; None: all of them do. Obstacles must not read Functions.
        """
        if direction is None:  # irrational ratios: effects of several values do not cancel
            direction = np.sqrt(1.0 + np.arange(values_of(control).size))
        comm, scale = self._V.mesh.comm, np.append(1.0, np.full(3, self.extent))
        rates = central_differences(
            comm,
            control,
            np.reshape(direction, (1, -1)),
            lambda: np.concatenate([distances * scale for distances in self._distances(jump)]),
            "an obstacle",
        )
        if rates is None:
            return np.zeros(len(self._pairs))
        ends = np.cumsum([len(distances) for distances in self._distances(jump)])[:-1]
        return np.array(largest_abs(comm, *np.split(rates[0], ends)))

    def jumps(self, state: StepState, before: Array, after: Array) -> tuple[Array, float]:
        """Return B times the displacement of obstacles (size,), and its largest component.

        Collective. This is the displacement of the points that end at the nodes of V, as `motions`
        change from `before` to `after`; its largest component [length] is that on this rank.
        """
        jump, dim = state.jump, self._V.mesh.geometry.dim
        jumps, largest = np.zeros(len(jump.gap)), 0.0
        for pair, start, end, own in zip(self._pairs, before, after, jump.own_rows, strict=True):
            if np.array_equal(start, end):
                continue
            # a point X of the obstacle goes from M_0 X to M_1 X; with M_1 X = x at a node displaced
            # by u, it moves by x - M_0 M_1^-1 x
            u = state.configuration if pair.sliding == "finite" else state.geometry
            points = self._V.tabulate_dof_coordinates().T.copy()  # (3, nodes)
            points[:dim] += u.x.array.reshape(-1, dim).T
            material = RigidMotion.from_matrix(end).reversed_from(points)
            moved = points - RigidMotion.from_matrix(start).applied_to(material)
            displacement = fem.Function(self._V)
            displacement.x.array[:] = moved[:dim].T.ravel()
            largest = max(largest, float(np.abs(displacement.x.array).max(initial=0.0)))
            rows = np.append(own.normal, own.tangential)
            jumps[rows] = jump.of_displacement(displacement)[rows]
        return jumps, largest
