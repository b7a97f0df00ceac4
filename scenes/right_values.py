"""Machine parts with their load steps, and the values that statics or a formula gives for them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.optimize import brentq

from dolfinx_tresca import MechanismError
from scenes.machine_parts import (
    BEAM,
    BELT,
    BLOCK_WEIGHT,
    CONE,
    CORD,
    CROSSED,
    DRUM,
    FORMER,
    JOINT,
    ON_CONE,
    ON_FLANK,
    ON_JOINT,
    ON_TOP,
    POISSON,
    ROOT,
    RUBBER,
    SOFT_CYLINDER,
    WRAP,
    WRAPPED,
    beam_on_former,
    belt,
    crossed_cylinders,
    cube_on_table,
    dovetail,
    lap_joint,
    taper,
    triple_junction,
    wavy_plank,
)
from scenes.scene import Scene
from scenes.turning import saint_venant_kirchhoff


@dataclass(frozen=True)
class MachinePart:
    """A scene, its load steps, and the value that it must have after the last one.

    Attributes:
        scene: function that makes the scene.
        loads: loads one after another; a body that the last one moves away carries the others.
        right: the right value, or a text about it.
        value: function from scene, problem and last solution to the value; None: the last load that
            was carried.
        nonlinear: whether bodies are of St. Venant-Kirchhoff's material.
        changes: arguments of `Scene.problem`.
    """

    scene: Callable[[MPI.Comm], Scene]
    loads: Sequence[float]
    right: float | str
    value: Callable[[Scene, Any, Any], float] | None = None
    nonlinear: bool = False
    changes: Mapping[str, Any] = field(default_factory=dict)

    def follow(
        self,
        comm: MPI.Comm,
        solve: Callable[[Any], Any],
        construct: Callable[..., Any] = Scene.problem,
    ) -> float:
        """Move the scene through its loads, as far as it stands; return the value. Collective.

        Args:
            comm: communicator of the scene.
            solve: function that solves and accepts a load step of a problem, and returns the
                solution.
            construct: function from the scene and `changes` to the problem of linear bodies.
        """
        scene, carried = self.scene(comm), 0.0
        made = saint_venant_kirchhoff(scene) if self.nonlinear else construct(scene, **self.changes)
        with made as problem:
            for load in self.loads:
                scene.data.move(load)
                try:
                    solution = solve(problem)
                except MechanismError:
                    break
                carried = load
            return carried if self.value is None else self.value(scene, problem, solution)


def belt_ratio(scene: Scene, problem: Any, solution: Any) -> float:
    """Return the reaction at the pulled end of the belt over the force on the other end."""
    return float(problem.reaction(scene.bcs[0]).force[0] / BELT)


def tip(scene: Scene, problem: Any, solution: Any) -> float:
    """Return the deflection of the end of the beam."""
    lowest = solution.u.x.array[1::2].min(initial=0.0)
    return -float(scene.mesh.comm.allreduce(lowest, op=MPI.MIN))


def tip_deflection(load: float) -> float:
    """Return the deflection of the end of the beam on its former, by beam theory, for load > 1."""
    free = BEAM / load
    touching = BEAM - free
    return (touching**2 / 2.0 + touching * free + free**2 / 3.0) / FORMER


def hub_reaction(scene: Scene, problem: Any, solution: Any) -> float:
    """Return the reaction of the hub's support along the axis over the normal force of contact."""
    return float(problem.reaction(scene.bcs[1]).force[1] / solution.normal_force)


def flank_force(scene: Scene, problem: Any, solution: Any) -> float:
    """Return the normal force on the flank of the dovetail."""
    return float(np.abs(solution.pair_resultants[0].force.sum()) / np.sqrt(2.0))


def peak_over_hertz(scene: Scene, problem: Any, solution: Any) -> float:
    """Return the peak pressure over Hertz's, which is that of a ball on a plane, for the force."""
    force, modulus = solution.normal_force, SOFT_CYLINDER / (1.0 - POISSON**2) / 2.0
    radius = (0.75 * force * CROSSED / modulus) ** (1.0 / 3.0)
    return float(solution.peak_pressure / (1.5 * force / np.pi / radius**2))


def upward_force(scene: Scene, problem: Any, solution: Any) -> float:
    """Return the force on the plank downwards, which is that on the block upwards."""
    return float(np.abs(solution.pair_resultants[0].force[1]))


def friction_over_pressure(scene: Scene, problem: Any, solution: Any) -> float:
    """Return the sum of friction over that of the normal forces, of plates, head and nut."""
    forces = [
        resultant.force
        for pair, resultant in zip(scene.pairs, solution.pair_resultants, strict=True)
        if pair.name != "bolt"
    ]
    return float(np.divide(*np.abs(forces).sum(axis=0)[[0, 2]]))


def line_contact_force(approach: float) -> float:
    """Return the force [N/mm] on a cord between plates that approach each other, by Hertz."""

    def excess(force: float) -> float:
        compliance = 3.0 * force / np.pi / RUBBER  # Poisson's ratio is 0.5
        half_width = np.sqrt(compliance * CORD / 2.0)
        return float(compliance * (np.log(2.0 * CORD / half_width) - 0.5) - approach)

    return float(brentq(excess, 1e-6, 10.0))


#: Friction on the drum acts at its radius, the forces of the belt at that of its middle.
BELT_RATIO = float(np.exp(WRAPPED * WRAP * DRUM / (DRUM + BELT / 2.0)))

#: Force of the dovetail that is pulled by 100 MPa: on its flank friction acts against the pull.
FLANK = 100.0 * ROOT * np.sqrt(2.0) / (1.0 + ON_FLANK)

#: Scene -> case -> machine part.
PARTS: dict[str, dict[str, MachinePart]] = {
    "belt": {
        f"{n} cells, {name}: ratio of forces": MachinePart(
            partial(belt, cells=n, sliding="finite" if nonlinear else "small"),
            *([0.0, 0.05], BELT_RATIO, belt_ratio, nonlinear),
        )
        for name, nonlinear in (("linear", False), ("St. Venant-Kirchhoff", True))
        for n in (60, 120)
    },
    "beam on a former": {
        f"{n} cells: deflection [mm]": MachinePart(
            partial(beam_on_former, cells=n), [0.5, 1.1, 1.5, 2.5], tip_deflection(2.5), tip
        )
        for n in (100, 200)
    },
    "taper": {
        f"cells of {size} mm: pull over pressure": MachinePart(
            partial(taper, size=size),
            [-0.1, -0.2, -0.15, -0.1],
            *(ON_CONE * np.cos(CONE) - np.sin(CONE), hub_reaction),
            changes={"axisymmetric": True},
        )
        for size in (1.2, 0.6)
    },
    "dovetail": {
        f"cells of {size} mm{', sides exchanged' * exchanged}: force on the flank": MachinePart(
            partial(dovetail, size=size, exchanged=exchanged), [50.0, 100.0], FLANK, flank_force
        )
        for size in (0.8, 0.4)
        for exchanged in (False, True)
    },
    "crossed cylinders": {
        f"cells of {size} mm: peak over Hertz's": MachinePart(
            partial(crossed_cylinders, size=size), [0.05, 0.1], 1.0, peak_over_hertz
        )
        for size in (0.16, 0.1)
    },
    "cube on a table": {
        f"F = {F}, {n} cells: greatest push over weight": MachinePart(
            partial(cube_on_table, cells=n, friction=F),
            [part * limit for part in (0.5, 0.9, 0.99, 0.999, 1.001)],
            limit,
        )
        for F, limit in ((0.5, 0.5), (2.0, 1.0))  # it slides, or tips over
        for n in (4, 8)
    },
    "triple junction": {
        f"cells of {size}: greatest shear": MachinePart(
            partial(triple_junction, size=size),
            [part * ON_JOINT * (ON_TOP + BLOCK_WEIGHT) for part in (0.5, 0.9, 0.999, 1.001)],
            ON_JOINT * (ON_TOP + BLOCK_WEIGHT),
        )
        for size in (0.13, 0.065)
    },
    "wavy plank": {
        f"cells of {size} mm{', sides exchanged' * exchanged}: force [N/mm]": MachinePart(
            partial(wavy_plank, size=size, exchanged=exchanged),
            *(list(range(17, 23)), "the same with sides exchanged", upward_force),
        )
        for size in (0.16, 0.08)
        for exchanged in (False, True)
    },
    "lap joint": {
        f"cells of {size} mm: friction over pressure": MachinePart(
            partial(lap_joint, size=size), [0.0, 0.05, 0.2, 0.5], JOINT, friction_over_pressure
        )
        for size in (7.0, 5.0)
    },
}
