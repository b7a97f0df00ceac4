"""The equilibrium of bodies held by contact: equations for the multipliers."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
from scipy.sparse import csr_array, diags_array, eye_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import eigsh

from dolfinx_tresca._base.arrays import Array, Indices, dense
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.errors import MechanismError
from dolfinx_tresca.floating.fixing import SpringResponse
from dolfinx_tresca.optimise.problem import FrictionDeficit
from dolfinx_tresca.optimise.reductions import Reductions
from dolfinx_tresca.optimise.sets.balance import balance
from dolfinx_tresca.optimise.sets.block_eigenpairs import eigenpairs
from dolfinx_tresca.optimise.sets.constraints import EqualityConstraints
from dolfinx_tresca.optimise.sets.feasible_set import FeasibleSet
from dolfinx_tresca.optimise.sets.friction_cones import FrictionCones
from dolfinx_tresca.optimise.sets.positive_definite import is_positive_definite

#: An unbalanced load counts as rounding if it is at most this fraction of the size of the loads.
UNBALANCED_PART = 1e-8

#: Contact must also balance the given loads increased by this fraction: exactly at the limit of
#: friction the rigid displacement would not be determined.
LOAD_RESERVE = 1e-6

#: Contact does not resist a rigid body mode if the mode's squared jump is at most this fraction of
#: the largest squared jump of the body's modes.
UNRESISTED_SQUARE = 1e-6

#: With hundreds of bodies, an eigenvalue of the Gram matrix of the modes' jumps counts as rounding
#: if it is at most this number. (The jumps are scaled to length 1.)
ROUNDING_SQUARE = 1e-13

#: Number of motions that are computed if contact does not resist some motions of many bodies. The
#: error message names the bodies that move in these motions. To compute all motions of hundreds of
#: bodies would take a dense eigenvalue problem. An error message also names this number of groups
#: of bodies, at most. The number changes nothing but the message.
MOST_NAMED = 6

#: Number of modes at and above which a few motions are computed in place of all motions.
MANY = 100

#: A mode counts as moving if its largest component in unresisted motions exceeds this fraction of
#: the largest component of all modes, and modes as moving together if the cosine of the angle
#: between their components exceeds it. Twice or half the number changes no message of the tests.
MOVING = 1e-3


@dataclass(frozen=True)
class Equilibrium:
    """Floating bodies under one load: equations of the multipliers, and rigid displacements.

    Let K_p be K plus the fixing springs. In a system with the matrix K_p, forces of these springs
    alone cause displacements U c with some coefficients c. Then u = K_p^-1 (f - B'lambda) + U c
    satisfies K u = f - B'lambda if and only if

        G'lambda + S c = e,    G = B U,  e = U'f:

    that is, contact forces and the soft springs of the scene, with their stiffness S, balance the
    loads.

    Attributes:
        constraints: the equations of equilibrium G'lambda + S c = e.
        modes: U (owned degrees of freedom, k), sparse; scaled such that a column of G has length 1,
            or a smaller length if S resists its mode more than contact does.
        describe: function that names the body that moves and its motion, for multipliers (k,) of
            the constraints. Collective.
    """

    constraints: EqualityConstraints
    modes: csr_array
    describe: Callable[[Array], str]

    def move(self, x: Array, u: PETSc.Vec, c: Array) -> float:
        """Add the displacements U c to u. Collective.

        Args:
            x: (size,) multipliers.
            u: the vector K_p^-1 (f - B'x), to which U c is added.
            c: (k,) multipliers of the constraints.

        Returns:
            the energy norm of the rigid displacements that are then still missing for equilibrium.
        """
        u.array += self.modes @ c
        return self.constraints.violation(x, c)

    def resultants(self, f: PETSc.Vec) -> tuple[Array, float]:
        """Return the resultants U'f (k,), and the largest sum of their terms' absolute values.

        Collective.

        Args:
            f: forces on all unknowns.
        """
        terms = self.modes.T @ f.array, abs(self.modes).T @ np.abs(f.array)
        comm = f.comm.tompi4py()
        result, sizes = (np.asarray(reduce_array(comm, one)) for one in terms)
        return result, float(sizes.max(initial=0.0))

    def explain(self, deficit: FrictionDeficit) -> str:
        """Return which body slides, and by which factor the load exceeds friction. Collective."""
        times = deficit.load / deficit.friction if deficit.friction > 0.0 else np.inf
        return (
            f"Nothing holds {self.describe(deficit.motion)}. The loads along this motion are "
            f"{times:.4g} times the friction that the pressures under these loads allow: the body "
            "slides without end. Prescribe its displacement instead of the load, reduce the load, "
            "or press harder"
        )


class FloatingBodies:
    """Bodies with rigid body modes that K resists weakly or not at all, and the modes' jumps."""

    def __init__(self, response: SpringResponse, jump: Callable[[csr_array], csr_array]) -> None:
        """Compute the jumps of the displacements in `response`. Collective.

        Args:
            response: displacements that forces of the springs that fix the bodies alone cause.
            jump: function that returns B U for a sparse matrix U of displacements.
        """
        self._response = response
        self._jumps = jump(response.displacements)

    def under(
        self, load: Array, feasible_set: FeasibleSet | FrictionCones, reductions: Reductions
    ) -> Equilibrium:
        """Return the equilibrium under a load, after a check that contact can hold the bodies.

        Collective.

        Args:
            load: this rank's part of f, the right-hand side of K u = f - B'lambda.
            feasible_set: Lambda.
            reductions: object that computes sums over the ranks.

        Raises:
            MechanismError: contact cannot hold a body; the message names the body and its motion,
                and the error's `motion` has the displacements (owned degrees of freedom,) of all
                bodies.
        """
        response = self._response
        resultants, sizes = response.resultants(load)
        try:
            constraints, factors = equilibrium_constraints(
                feasible_set,
                self._jumps,
                response.stiffness,
                resultants,
                sizes,
                response.modes.body,
                reductions,
                response.modes.describe,
            )
        except MechanismError as error:
            error.motion = response.displacements @ error.motion
            raise
        return Equilibrium(
            constraints,
            response.displacements * factors,
            lambda motion: response.modes.describe(factors * motion),
        )


def equilibrium_constraints(
    feasible_set: FeasibleSet | FrictionCones,
    jumps: csr_array,
    stiffness: csr_array,
    resultants: Array,
    sizes: Array,
    bodies: Indices,
    reductions: Reductions,
    describe: Callable[[Array], str],
) -> tuple[EqualityConstraints, Array]:
    """Return the equations of equilibrium, after a check that some x in Lambda satisfies them.

    Collective.

    Args:
        feasible_set: Lambda.
        jumps: (size, k) B U, the jumps of k rigid body modes, sparse.
        stiffness: (k, k) stiffness of K against the modes; zero rows for modes that K does not
            resist.
        resultants: (k,) U'f, the resultants of the loads along the modes.
        sizes: (k,) size of the terms of each resultant, see `SpringResponse.resultants`.
        bodies: (k,) the body of each mode.
        reductions: object that computes sums over the ranks.
        describe: function that names the motion with given components (k,) or (k, columns) of the
            modes.

    Returns:
        the equations, and the factors (k,) that scale the modes in them.

    Raises:
        MechanismError: neither K nor contact resists a motion, or nothing balances the loads; the
            error's `motion` has the components (k,) of the motion in the modes.
    """
    carrying = diags_array(feasible_set.carrying.astype(np.float64), format="csr") @ jumps
    gram = reductions.sparse_inner(carrying, carrying)
    length = np.sqrt(reductions.from_first_rank(gram.diagonal()))
    # compared for each body by itself, since jumps depend on the size and the mesh of a body
    largest = _largest_of_group(length, bodies)
    length[length <= np.sqrt(UNRESISTED_SQUARE) * largest] = 0.0
    resisted = stiffness.diagonal()
    floats = np.flatnonzero(resisted == 0.0)
    size = np.where(length > 0.0, length, np.where(largest > 0.0, largest, 1.0))
    by_size = diags_array(1.0 / size, format="csr")
    scaled = (by_size @ gram @ by_size)[floats][:, floats]
    unresisted = reductions.from_first_rank(_unresisted(scaled, bodies[floats]))
    if unresisted.size:
        weak = np.zeros((len(size), unresisted.shape[1]))
        weak[floats] = unresisted / size[floats, None]
        motions = _by_group(weak, bodies)
        named = "; nor ".join(describe(motion) for motion in motions[:MOST_NAMED])
        more = len(motions) - MOST_NAMED
        raise MechanismError(
            f"nothing holds {named}{f'; nor {more} more' * (more > 0)}, and no contact resists "
            "that. Fix part of the boundary with a Dirichlet condition, add a soft spring to a, or "
            "give the contact friction.",
            motions[0][:, np.square(motions[0]).sum(axis=0).argmax()],
        )
    # modes without jumps are scaled by the stiffness of the springs that hold them, which together
    # with an unstable K may be negative
    factors = 1.0 / np.where(length > 0.0, length, np.sqrt(np.abs(resisted)))
    by_factor = diags_array(factors, format="csr")
    constraints = EqualityConstraints(
        columns=csr_array(jumps @ by_factor),
        softness=csr_array(by_factor @ stiffness @ by_factor),
        values=factors * resultants,
        sizes=_largest_of_group(
            np.where(length > 0.0, factors * sizes, 0.0), _held_together(gram, bodies)
        ),
        reductions=reductions,
        nodes=feasible_set.nodes(),
    )
    checked = _solvable(constraints, feasible_set, factors, describe)
    return checked, factors


def _unresisted(gram: csr_array, bodies: Indices) -> Array:
    """Return m motions that contact does not resist, by their components (k, m) in the modes.

    The number m may be zero. In each motion a single body moves while all others rest; if there is
    no such motion, all bodies move together. The limit for joint motions of n bodies is smaller,
    since the resistance falls with n: the least eigenvalue of a stack of n bodies is about 1 / n^4.

    Args:
        gram: (k, k) products of the modes' jumps, sparse, 1 on the diagonal.
        bodies: (k,) the body of each mode.
    """
    k, number = len(bodies), len(np.unique(bodies))
    if k == 0:
        return np.zeros((0, 0))
    entries = gram.tocoo()
    same = bodies[entries.row] == bodies[entries.col]
    pattern = (entries.row[same], entries.col[same])
    own = csr_array((entries.data[same], pattern), shape=gram.shape)  # all other bodies at rest
    together = max(UNRESISTED_SQUARE / number**4, ROUNDING_SQUARE)
    motions: Array = np.zeros((k, 0))
    for matrix, least in ((own, UNRESISTED_SQUARE), (gram, together)):
        if is_positive_definite(matrix - least * eye_array(k)):
            continue
        if matrix is own or k < MANY:
            values, vectors = eigenpairs(matrix)
        else:
            values, vectors = eigsh(matrix, MOST_NAMED, sigma=-least, v0=np.ones(k))
        motions = np.hstack([motions, dense(vectors[:, values <= least])])
    return motions


def _by_group(motions: Array, bodies: Indices) -> list[Array]:
    """Return motions for each group of bodies that can only move together, zero elsewhere.

    Args:
        motions: (k, m) components of motions in the modes of all bodies; each motion may be a sum
            of independent motions of several groups.
        bodies: (k,) the body of each mode.
    """
    lengths = np.linalg.norm(motions, axis=1)
    moves = lengths > MOVING * lengths.max()
    directions = np.where(moves, motions.T / np.where(moves, lengths, 1.0), 0.0)
    cosines = directions.T @ directions
    groups = _held_together(csr_array(np.where(np.abs(cosines) > MOVING, cosines, 0.0)), bodies)
    return [motions * (groups == group)[:, None] for group in np.unique(groups[moves])]


def _held_together(gram: csr_array, bodies: Indices) -> Indices:
    """Return a group number (k,) for each mode: equal for modes of bodies that contact couples."""
    k, body = len(bodies), np.unique(bodies, return_inverse=True)[1]
    of_body = csr_array((np.ones(k), (np.arange(k), body)), shape=(k, k))
    graph = abs(gram) + of_body @ of_body.T
    groups: Indices = connected_components(graph, directed=False)[1]
    return groups


def _largest_of_group(sizes: Array, group: Indices) -> Array:
    """Return for each of the sizes (k,) the largest size in the same group (k,)."""
    largest = np.zeros(int(group.max(initial=-1)) + 1)
    np.maximum.at(largest, group, sizes)
    result: Array = largest[group]
    return result


def _solvable(
    constraints: EqualityConstraints,
    feasible_set: FeasibleSet | FrictionCones,
    factors: Array,
    describe: Callable[[Array], str],
) -> EqualityConstraints:
    """Return equations with a solution in Lambda, equal to the given equations up to rounding.

    If no solution exists only because of the rounding of the loads, the right-hand sides change.

    Args:
        constraints: the equations.
        feasible_set: Lambda.
        factors: (k,) factors by which the equations scale the rigid body modes.
        describe: function that names the motion with given components (k,) of the modes.

    Raises:
        MechanismError: nothing balances the loads along a motion; the error's `motion` has the
            components (k,) of the motion in the modes.
    """
    found = balance(constraints, feasible_set, reserve=LOAD_RESERVE)
    if found.satisfied:
        return constraints
    sizes = np.maximum(constraints.sizes, np.abs(constraints.values))
    if found.unbounded or (np.abs(found.excess) > UNBALANCED_PART * sizes).any():
        motion = factors * found.shift
        raise MechanismError(
            f"no contact forces balance the loads on {describe(motion)}. The loads pull it off "
            "what it touches, tip it over, or overcome friction there: look at their directions "
            "and at the friction, or hold the body by Dirichlet conditions or springs.",
            motion,
        )
    return dataclasses.replace(
        constraints, values=constraints.values + found.excess / (1.0 + LOAD_RESERVE)
    )
