"""A semicircular arch of voussoirs under its own weight, in 2D; lengths in m, stresses in MPa."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from types import SimpleNamespace

from mpi4py import MPI

import numpy as np

import ufl

from dolfinx_tresca import ContactPair, ContactSolution, Coulomb, RigidPlane
from scenes.boxes import Body, boxes
from scenes.elasticity import elasticity
from scenes.scene import Scene

#: Radius of the centre line [m].
RADIUS = 1.0

#: Stone: Young's modulus [MPa], Poisson's ratio, weight [MN/m^3], coefficient of friction.
YOUNG, POISSON, WEIGHT, FRICTION = 1e4, 0.2, 0.025, 0.7

#: Tags of the left and the right springing, and of all joints.
LEFT, RIGHT, JOINTS = 1, 2, 7


def arch(
    comm: MPI.Comm,
    thickness: float,
    *,
    voussoirs: int = 25,
    divisions: tuple[int, int] = (2, 4),
    friction: float = FRICTION,
) -> Scene:
    """Return an arch on a rigid floor, of equal voussoirs with radial joints. Collective.

    One pair is for the left springing on the floor, one for the right springing, and one for all
    joints, which are found by contact of a surface with itself. Bodies are numbered from the left
    to the right. `data.joints` has the angles (voussoirs + 1,) of springings and joints from the
    crown, ascending.

    Args:
        comm: communicator of the mesh.
        thickness: thickness of the arch [m].
        voussoirs: number of voussoirs.
        divisions: numbers of cells of a voussoir along the arch and across it.
        friction: coefficient of friction.
    """
    joints = np.linspace(-0.5 * np.pi, 0.5 * np.pi, voussoirs + 1)
    radii = (RADIUS - 0.5 * thickness, RADIUS + 0.5 * thickness)

    def at(angle: float) -> Callable[[np.ndarray], np.ndarray]:
        return lambda x: np.abs(x[:, 0] - angle) < 1e-9

    parts = [Body(divisions, [ends, radii], move=bent) for ends in itertools.pairwise(joints)]
    made = boxes(comm, "quadrilateral", parts)
    springings = [(LEFT, [0], at(joints[0])), (RIGHT, [voussoirs - 1], at(joints[-1]))]
    sides = [(k, one) for k in range(1, voussoirs) for one in (0, 1)]  # left and right of joint k
    tags = made.tags(*springings, *((JOINTS, [k - 1 + one], at(joints[k])) for k, one in sides))
    law, floor = Coulomb(friction), RigidPlane((0.0, 0.0), (0.0, 1.0))
    feet = [ContactPair(tags, foot, floor, law) for foot in (LEFT, RIGHT)]
    data = SimpleNamespace(joints=joints)
    load = -WEIGHT * ufl.TestFunction(made.V)[1] * ufl.dx
    pairs = [*feet, ContactPair(tags, JOINTS, JOINTS, law)]
    return Scene(made.V, elasticity(made.V, YOUNG, POISSON), load, [], pairs, tags, data=data)


def bent(x: np.ndarray) -> np.ndarray:
    """Return points (n, 2) for angles from the crown and radii (n, 2)."""
    return x[:, 1:] * np.column_stack([np.sin(x[:, 0]), np.cos(x[:, 0])])


def thrusts(solution: ContactSolution, joints: np.ndarray) -> np.ndarray:
    """Return normal force, shear force and moment (voussoirs + 1, 3) of springings and joints.

    They act on the voussoir to the left of a joint (at the left springing: on the floor). The
    normal force is positive in compression, the shear force outwards. The moment is about the
    point on the centre line, positive if the resultant passes outside of this point.

    Args:
        solution: solution for an arch.
        joints: angles (voussoirs + 1,) from the crown.
    """
    normal = np.column_stack([np.cos(joints), -np.sin(joints)])  # towards the right springing
    outwards = np.column_stack([np.sin(joints), np.cos(joints)])
    centres = RADIUS * outwards
    last = len(joints) - 1
    left, right = (one for one in solution.pair_resultants[:2])
    found = [
        left.about(centres[0]),
        *(solution.resultants_between(k - 1, k, centres[k]) for k in range(1, last)),
        right.about(centres[last]),
    ]
    signs = np.array([-1.0] + [1.0] * last)  # the floor is left of the left springing
    forces = signs[:, None] * [one.force for one in found]
    moments = signs * [one.moment[0] for one in found]
    return np.column_stack(
        [
            -np.einsum("ni,ni->n", forces, normal),
            np.einsum("ni,ni->n", forces, outwards),
            moments,
        ]
    )
