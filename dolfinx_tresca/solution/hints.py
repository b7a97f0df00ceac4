"""Hints in the log at likely mistakes in a scene or its solution."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import ROUNDING, Array
from dolfinx_tresca._base.number import real
from dolfinx_tresca._base.parallel import log, reduce_array
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.floating.bodies import Bodies
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.scene.friction import DryFriction
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.solvers.friction_cones import FrictionCones

#: Largest coefficient of friction that a material may have: rubber on rubber has 1 to 4.
LARGEST_COEFFICIENT = 5.0


def hint_at_scene(
    V: Any, pairs: Sequence[ContactPair], operators: Sequence[PairOperators], bodies: Bodies
) -> None:
    """Log likely mistakes in the contact pairs. Collective.

    These mistakes are coefficients of friction that no material has, overlaps as deep as a body,
    and pairs with both sides on one body.

    Args:
        V: space of the displacement.
        pairs: the pairs.
        operators: operators of the pairs.
        bodies: bodies of the mesh.
    """
    comm, dim = V.mesh.comm, V.mesh.geometry.dim
    thickness = (bodies.bounds[:, 3:] - bodies.bounds[:, :3])[:, :dim].min(axis=1)
    for pair, paired in zip(pairs, operators, strict=True):
        coefficient = _coefficient(pair)
        if coefficient > LARGEST_COEFFICIENT:
            log(
                comm,
                "%s has a coefficient of friction of %g, which no material has: it is neither in "
                "percent nor an angle",
                *(pair, coefficient),
                level=logging.WARNING,
            )
        secondary = _bodies_at(bodies, paired.nodes, comm)
        thinnest = thickness[secondary].min(initial=np.inf)
        if not isinstance(pair.primary, RigidObstacle):
            primary = _bodies_at(bodies, _nodes_of(V, pair), comm)
            thinnest = min(thinnest, thickness[primary].min(initial=np.inf))
            alike = np.array_equal(secondary, primary) and secondary.sum() == 1
            if alike and not pair.touches_itself:
                log(
                    comm,
                    "both sides of %s are on body %d: it touches itself. If these should be two "
                    "bodies, they share nodes: mesh them without merging nodes",
                    *(pair, 1 + int(secondary.argmax())),
                    level=logging.WARNING,
                )
        depth = comm.allreduce(float((-paired.gap).max(initial=0.0)), op=MPI.MAX)
        if depth >= thinnest:
            log(
                comm,
                "%s overlaps by %.3g before anything moves, as deep as a body is thick: are the "
                "bodies where they should be, and the tags on the sides that face each other?",
                *(pair, depth),
                level=logging.WARNING,
            )


def hint_at_overlap(u: fem.Function, pairs: Sequence[ContactPair], jump: JumpOperator) -> None:
    """Warn where prescribed displacements push the sides of pairs into each other. Collective.

    Args:
        u: displacement of a solution [length].
        pairs: the pairs.
        jump: jumps of these pairs.
    """
    comm, points = jump.comm, u.function_space.tabulate_dof_coordinates()
    rounding = ROUNDING * comm.allreduce(float(np.abs(points).max(initial=0.0)), op=MPI.MAX)
    for pair, paired, closing in zip(pairs, jump.pairs, jump.closings(u), strict=True):
        depth = np.where(paired.prescribed, closing - paired.gap, 0.0)
        deepest = comm.allreduce(float(depth.max(initial=0.0)), op=MPI.MAX)
        if deepest <= rounding:
            continue
        number = comm.allreduce(len(np.unique(paired.nodes[depth > rounding])))
        # the least of all equally deep points: the same with any number of ranks
        deepest_points = points[paired.nodes[depth >= deepest - rounding]]
        place = min(comm.allgather(min(map(tuple, deepest_points.tolist()), default=(np.inf,))))
        log(
            comm,
            "%s overlaps by up to %.3g, at (%s): Dirichlet conditions prescribe the displacement "
            "along the normal at %d nodes of the secondary side, which so have no pressure to hold "
            "the sides apart. Prescribe no overlap, or make a side that can give way the secondary "
            "side",
            *(pair, deepest, ", ".join(f"{x:.4g}" for x in place), number),
            level=logging.WARNING,
            about=str(pair),
        )


def hint_at_weakening(comm: Any, cones: FrictionCones, x: Array, compliance: float) -> None:
    """Log a warning if slip bounds decrease with pressure or slip. Collective.

    With such bounds there may be several solutions. A decrease with the slip is harmless if its
    rate is less than 1 divided by the largest eigenvalue of A, both at the present slip and on
    average between zero and the present slip. (1 divided by this eigenvalue is the least traction
    that elastic bodies need for one more unit of slip.)

    Args:
        comm: communicator of the mesh.
        cones: friction cones whose bounds F(p, v) p are evaluated at the slips of a solution.
        x: (size,) multipliers of the solution.
        compliance: the largest eigenvalue of A, or a lower bound.
    """
    lam = cones.section(x)
    face = lam.face(2.0 * x)  # nodes on their circles slip
    by_pressure, by_slip = cones.slopes(x, face)
    assert cones.slip is not None
    at_rest = dataclasses.replace(cones, slip=np.zeros_like(cones.slip)).section(x).radius
    slips = face.slip & (cones.slip > 0.0)
    mean = np.zeros_like(by_slip)
    np.divide(lam.radius - at_rest, cones.slip, out=mean, where=slips)
    steepest = min(by_slip.min(initial=0.0), mean.min(initial=0.0))
    least = [by_pressure.min(initial=0.0), compliance * steepest]
    falling, weakening = reduce_array(comm, np.array(least), MPI.MIN)
    if falling < 0.0:
        log(
            comm,
            "the slip bound F(p, v) p of a contact pair decreases with the pressure at slipping "
            "nodes, by up to %.3g for each unit of pressure: there may be several solutions",
            -falling,
            level=logging.WARNING,
        )
    if weakening < -1.0:
        log(
            comm,
            "the slip bound of a contact pair decreases with the slip up to %.3g times as fast as "
            "elastic tractions do: there may be several solutions, and sliding may begin suddenly",
            -weakening,
            level=logging.WARNING,
        )


def _coefficient(pair: ContactPair) -> float:
    """Return the largest coefficient of friction that is a number; zero if there is none."""
    if not isinstance(pair.friction, DryFriction) or pair.friction.terms.curve is not None:
        return 0.0
    coefficient = pair.friction.terms.coefficient
    both = coefficient if isinstance(coefficient, tuple) else (coefficient,)
    numbers = [value.value if isinstance(value, fem.Constant) else real(value) for value in both]
    return max(float(0.0 if number is None else number) for number in numbers)


def _nodes_of(V: Any, pair: ContactPair) -> Any:
    """Return the nodes of the primary side that this rank owns. Collective."""
    facets = pair.facet_tags.find(pair.primary)
    nodes = fem.locate_dofs_topological(V, pair.facet_tags.dim, facets)
    return nodes[nodes < V.dofmap.index_map.size_local]


def _bodies_at(bodies: Bodies, nodes: Any, comm: MPI.Comm) -> Any:
    """Return whether each body (number,) has one of the nodes, on any rank. Collective."""
    node_counts = np.bincount(bodies.label[nodes], minlength=bodies.number)
    return reduce_array(comm, node_counts) > 0
