"""The equilibrium of bodies and tools held by contact: equations for the multipliers.

A tool is an obstacle held by forces, or a cut bolt that is pulled. It is like a floating body
without deformation. Let c be the amounts of its free motions. Then its contact forces balance the
given forces e along each motion, and the gaps follow c:

    G'lambda = e,    r = (d; s) - B u - G c,    where a column of G is the jump of a motion.

These are the equations of floating bodies (`Equilibrium`) with U = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from petsc4py import PETSc

import numpy as np
from scipy.sparse import csr_array, diags_array, eye_array, hstack, kron
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import eigsh

from dolfinx_tresca._base.arrays import ROUNDING, Array, Indices, dense, dots, in_space, scaled_rows
from dolfinx_tresca._base.bodies import Bodies
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.errors import MechanismError
from dolfinx_tresca.floating.rigid_modes import NAMED_PART, RigidBodyModes
from dolfinx_tresca.scene.obstacle import RigidMotion
from dolfinx_tresca.solvers.constraints import (
    EqualityConstraints,
    Reductions,
    balance,
    eigenpairs,
    factored,
)
from dolfinx_tresca.solvers.feasible_set import FeasibleSet
from dolfinx_tresca.solvers.problem import FrictionDeficit

#: Contact must also balance the given loads increased by this fraction: exactly at the limit of
#: friction the rigid displacement would not be determined.
LOAD_RESERVE = 1e-6

#: Contact does not resist a rigid body mode if its squared jump, in the rows that Lambda lets act,
#: is at most this fraction of the largest squared jump of the body's modes.
UNRESISTED_SQUARE = 1e-6

#: Number of motions that are computed, for an error message, if contact does not resist some joint
#: motions of many bodies: all of them would take a dense eigenvalue problem.
MOTIONS = 6

#: Number of modes at and above which a few motions are computed in place of all motions.
MANY = 100


class FreeMotion(NamedTuple):
    """A motion of a rigid tool, for which a force is given.

    Attributes:
        tool: name of the tool, for messages.
        name: name of the motion, for messages.
        pairs: numbers of the pairs whose primary side the tool is.
        direction: (6,) translation, then rotation about `point`, of the motion with the amount 1.
        point: (3,) point about which the tool turns [length].
        force: work of the given forces in the motion with the amount 1.
    """

    tool: str
    name: str
    pairs: list[int]
    direction: Array
    point: Array
    force: float

    def displacement(self, places: Array) -> Array:
        """Return the displacement (n, d) of the tool at places (n, d), for the amount 1."""
        moved = self.direction[:3] + np.cross(self.direction[3:], in_space(places) - self.point)
        return np.asarray(moved[:, : places.shape[1]])


@dataclass(frozen=True)
class Tools:
    """The k free motions of all tools of a problem, which `FloatingBodies.with_tools` adds.

    Attributes:
        motions: the motions; those of a tool follow one another.
        jumps: (size, k) G, sparse: the jumps in the rows of B for the amount 1 of each motion.
    """

    motions: list[FreeMotion]
    bodies: Bodies
    jumps: csr_array

    @classmethod
    def from_rows(
        cls, motions: list[FreeMotion], bodies: Bodies, by_pair: Sequence[Any], stress_scale: Array
    ) -> Tools:
        """Compute G, with `by_pair` and `stress_scale` of the `JumpOperator`. Not collective.

        The primary side moves: the jump is minus the motion along the normal or tangent of a row.
        It counts with the node's area on pairs of the tool. Division by the root of the node's area
        on all pairs, which is part of `stress_scale`, then scales it like the rows of B.
        """
        G = np.zeros((len(stress_scale), len(motions)))
        for column, motion in zip(G.T, motions, strict=True):
            for number in motion.pairs:
                rows, pair = by_pair[number], by_pair[number].operators
                weighted = motion.displacement(pair.places) * pair.weights[:, None]
                column[rows.normal] -= dots(weighted, pair.normals)[pair.normal_node]
                column[rows.tangential] -= dots(weighted[pair.tangent_node], pair.tangents)
        return cls(motions, bodies, csr_array(stress_scale[:, None] * G))

    def places(self, c: Array, before: Array) -> Array:
        """Return each pair's `RigidMotion.matrix` (pairs, 3, 4) after a solve has moved the tools.

        The amounts c (k,) of the free motions move the tools from `before` (pairs, 3, 4).
        """
        result, steps = before.copy(), np.zeros((len(before), 6))  # as `FreeMotion.direction`
        for motion, amount in zip(self.motions, c, strict=True):
            steps[motion.pairs] += amount * motion.direction
            for pair in motion.pairs:
                step = RigidMotion.about(motion.point, steps[pair, 3:], steps[pair, :3])
                result[pair] = step.after(RigidMotion.from_matrix(before[pair])).matrix
        return result


@dataclass(frozen=True)
class Equilibrium:
    """Floating bodies under one load: equations of the multipliers, and rigid displacements.

    Let K_p be K plus the fixing springs, and U the displacements that forces of these springs cause
    (`FixingSprings.response`). With coefficients c, u = K_p^-1 (f - B'lambda) + U c satisfies
    K u = f - B'lambda if and only if

        G'lambda + S c = e,    G = B U,  e = U'f:

    that is, contact forces and soft springs of the scene, with the stiffness S, balance loads.

    Attributes:
        factors: (k,) factors by which the columns of U are multiplied, such that a column of G has
            length 1 in the rows that Lambda lets act; if it is 0 there, S has a diagonal 1 or -1.
    """

    constraints: EqualityConstraints
    bodies: FloatingBodies
    factors: Array

    def add_rigid_displacements(self, x: Array, u: PETSc.Vec, c: Array) -> float:
        """Add the displacements U (factors * c) to u = K_p^-1 (f - B'x). Collective.

        The result is the energy norm of the rigid displacements that equilibrium still lacks.
        """
        u.array += self.bodies.displacements @ (self.factors * c)
        return self.constraints.soft_violation(x, c)

    def resultants(self, f: PETSc.Vec) -> tuple[Array, float]:
        """Return e = factors * U'f (k,) of a load f, and its largest term sum. Collective."""
        result, terms = self.bodies.resultants(f.array)
        largest = (self.factors * terms).max(initial=0.0)
        return self.factors * result, float(largest)

    def explain(self, deficit: FrictionDeficit) -> str:
        """Return a text on a body that friction cannot hold, for NO_FIXED_POINT. Collective."""
        times = deficit.load / deficit.friction if deficit.friction > 0.0 else np.inf
        size = f"{times:.4g} times" if 1.001 <= times < 100.0 else "more than"
        return (
            f"Nothing holds {self.bodies.describe(self.factors * deficit.motion)}. The loads "
            f"along this motion are {size} the friction that the pressures under these loads "
            "allow: the body slides or tips without end. Prescribe its displacement instead of the "
            "load, reduce the load, or press harder"
        )


@dataclass(frozen=True)
class FloatingBodies:
    """Bodies with rigid body modes that K resists weakly or not at all, and the modes' jumps.

    They do not depend on the load; `under` returns the `Equilibrium` under a load. The motions of
    tools follow the modes of bodies, with U = 0: k is the number of both together.

    Attributes:
        displacements: U (owned degrees of freedom, k), sparse, caused by the fixing springs.
        stiffness: (k, k) stiffness of K against U, sparse.
        jumps: (size, k) B U, sparse; for the motions of tools the columns of `Tools.jumps`.
        tool_motions: the motions of tools.
    """

    modes: RigidBodyModes
    displacements: csr_array
    stiffness: csr_array
    jumps: csr_array
    tool_motions: Sequence[FreeMotion] = ()

    @classmethod
    def none(cls, bodies: Bodies, comm: Any, dim: int, unknowns: int, size: int) -> FloatingBodies:
        """Return no floating bodies, for tools alone, with U (unknowns, 0) and G (size, 0)."""
        components = bodies.rigid_modes(dim).T[:, :0]
        stiffness, floats, body = np.empty(0), np.empty(0, np.bool_), np.empty(0, np.intp)
        modes = RigidBodyModes(comm, bodies, csr_array((0, 0)), stiffness, floats, body, components)
        return cls(modes, csr_array((unknowns, 0)), csr_array((0, 0)), csr_array((size, 0)))

    def with_tools(self, tools: Tools) -> FloatingBodies:
        """Return these bodies with the motions of tools after their modes. Not collective."""
        U, stiffness, motions = self.displacements.copy(), self.stiffness.copy(), tools.motions
        U.resize(U.shape[0], U.shape[1] + len(motions))
        stiffness.resize(U.shape[1], U.shape[1])
        jumps = hstack([self.jumps, tools.jumps], format="csr")
        return FloatingBodies(self.modes, U, stiffness, jumps, motions)

    def describe(self, components: Array) -> str:
        """Return names of the tools, or else bodies, that move, and of their motions. Collective.

        The motions (k,) or (k, columns) of tools count if they are as large as those of bodies.
        """
        of_bodies, of_tools = np.split(components, [len(components) - len(self.tool_motions)])
        # what nothing balances moves without end, and a tool that is balanced hardly at all
        most, tool_most = np.abs(of_bodies).max(initial=0.0), np.abs(of_tools).max(initial=0.0)
        if not self.modes.comm.bcast(bool(tool_most > 1e-6 * most)):
            return self.modes.describe(of_bodies)
        amounts = np.linalg.norm(of_tools.reshape(len(of_tools), -1), axis=1)
        moving: dict[str, list[str]] = {}
        for motion, amount in zip(self.tool_motions, amounts, strict=True):
            if amount > NAMED_PART * amounts.max():
                moving.setdefault(motion.tool, []).append(motion.name)
        text = "; ".join(f"{tool}: {', '.join(names)}" for tool, names in moving.items())
        return str(self.modes.comm.bcast(text))

    def resultants(self, f: Array) -> tuple[Array, Array]:
        """Return the resultants U'f (k,) of loads f on this rank, and term sums (k,). Collective.

        A term sum is the sum of |U| |f| over the nodes, where |.| is the length of a vector at a
        node, which does not depend on the axes. A resultant below the rounding of its terms is 0.
        """
        # `sums` of components at each node; in mixed spaces, U = 0 and it adds up any unknowns
        U, dim = self.displacements, self.modes.dim
        nodes = -(-len(f) // dim)  # rounded up
        sums = kron(eye_array(nodes), np.ones((1, dim)), format="csr")[:, : len(f)]
        lengths, forces = (sums @ U.power(2)).sqrt(), np.sqrt(sums @ f**2)
        terms: Array = reduce_array(self.modes.comm, lengths.T @ forces)
        result: Array = reduce_array(self.modes.comm, U.T @ f)
        result[np.abs(result) <= ROUNDING * terms] = 0.0
        return result, terms

    def under(self, load: Array, feasible_set: FeasibleSet, reductions: Reductions) -> Equilibrium:
        """Return the equilibrium under a load, if contact can hold the bodies. Collective.

        Raises:
            MechanismError: neither K nor contact resists a motion, or nothing balances the loads;
                the message names the body and its motion, and the error's `motion` has the
                displacements (owned degrees of freedom,) of all bodies.
        """
        # the body of each motion; motions of a tool have a number above those of bodies
        bodies, tools = self.modes.body, slice(len(self.modes.body), None)
        if self.tool_motions:
            pairs = np.array([motion.pairs[0] for motion in self.tool_motions])
            bodies = np.append(bodies, self.modes.bodies.count + pairs)
        # `carrying`: jumps in the rows whose multipliers Lambda lets act; `length`: their norms
        carries = feasible_set.project(np.ones(feasible_set.size)) != 0.0
        carrying = scaled_rows(self.jumps, carries.astype(np.float64))
        gram = reductions.sparse_inner(carrying, carrying)
        length = np.sqrt(reductions.from_first_rank(gram.diagonal()))
        # compared for each body by itself, since jumps depend on the size and the mesh of a body
        largest = _largest_of_group(length, bodies)
        length[length <= np.sqrt(UNRESISTED_SQUARE) * largest] = 0.0

        # floating bodies and tools, whose stiffness is exactly 0 (`FixingSprings.response`), need
        # contact that resists all their motions, here scaled to jumps of length 1
        stiffness = self.stiffness.diagonal()
        floats = np.flatnonzero(stiffness == 0.0)
        lengths = np.where(length > 0.0, length, largest)[floats]
        scale = 1.0 / np.where(lengths > 0.0, lengths, 1.0)
        scaled = diags_array(scale) @ gram[floats][:, floats] @ diags_array(scale)
        motions, further_bodies = _unresisted(csr_array(scaled), bodies[floats])
        if motions.size:
            components = np.zeros((len(length), motions.shape[1]))
            components[floats] = scale[:, None] * motions
            most = np.square(components).sum(axis=0).argmax()  # the largest motion
            motion = reductions.from_first_rank(components[:, most])
            nor = f"; nor {further_bodies} more" if further_bodies else ""
            advice = " Leave this motion of a tool out of free=." if self.tool_motions else ""
            raise MechanismError(
                f"nothing holds {self.describe(components)}{nor}, "
                "and no contact resists that. Fix part of the boundary with a Dirichlet condition, "
                f"add a soft spring to a, or give the contact friction.{advice}",
                self.displacements @ motion,
            )

        # modes without such jumps are scaled by their stiffness, negative if K is unstable
        factors = 1.0 / np.where(length > 0.0, length, np.sqrt(np.abs(stiffness)))
        by_factor = diags_array(factors, format="csr")
        resultants, terms = self.resultants(load)
        resultants[tools] = [motion.force for motion in self.tool_motions]
        terms[tools] = np.abs(resultants[tools])
        own_terms = np.where(length > 0.0, factors * terms, 0.0)
        # bodies that touch the same nodes pass their loads on: they belong to one group
        of_body = csr_array((np.ones(len(bodies)), bodies, np.arange(len(bodies) + 1)))
        group = connected_components(of_body.T @ abs(gram) @ of_body, directed=False)[1]
        constraints = EqualityConstraints(
            columns=csr_array(self.jumps @ by_factor),
            softness=csr_array(by_factor @ self.stiffness @ by_factor),
            values=factors * resultants,
            term_sums=_largest_of_group(own_terms, group[bodies]),
            reductions=reductions,
        )
        return Equilibrium(self._balanced(constraints, factors, feasible_set), self, factors)

    def _balanced(
        self, constraints: EqualityConstraints, factors: Array, feasible_set: FeasibleSet
    ) -> EqualityConstraints:
        """Return the equations if contact forces can satisfy them, and else raise. Collective.

        Loads are increased by `LOAD_RESERVE` for this check. If only rounding is left unbalanced,
        it is added to `values`; more, up to the reserve, proves nothing, as for one of 200 piles.
        Beyond it, the error names the motion that the loads cause.
        """
        increased = replace(constraints, values=(1.0 + LOAD_RESERVE) * constraints.values)
        balanced = balance(increased, feasible_set)
        if balanced.satisfied:
            return constraints
        terms = np.maximum(constraints.term_sums, np.abs(constraints.values))
        if balanced.unbounded or (np.abs(balanced.excess) > LOAD_RESERVE * terms).any():
            motion = factors * balanced.shift
            raise MechanismError(
                f"no contact forces balance the loads on {self.describe(motion)}. The "
                "loads pull it off what it touches, tip it over, or overcome friction there: "
                "look at their directions and at the friction, or hold the body by Dirichlet "
                "conditions or springs.",
                self.displacements @ motion,
            )
        is_rounding = (np.abs(balanced.excess) <= 1e-8 * terms).all()
        values = constraints.values + is_rounding * balanced.excess / (1.0 + LOAD_RESERVE)
        return replace(constraints, values=values)


def _unresisted(gram: csr_array, body: Indices) -> tuple[Array, int]:
    """Return motions that contact does not resist, of a body or of bodies that move together.

    These are eigenvectors, with eigenvalues up to a limit, of the inner products `gram` (m, m) of
    jumps, scaled to length 1, of m modes of the bodies `body` (m,). Single bodies that move while
    all others rest come first, then bodies that move together. The limit for joint motions of n
    bodies is smaller, since the resistance falls with n: to about 1 / n^4 for a stack.

    Returns:
        the components (m, count) of motions in the modes, all of one group of bodies, empty if
        contact resists all motions; and the number of further bodies that contact does not hold.
    """
    m, entries = len(body), gram.tocoo()
    within = body[entries.row] == body[entries.col]  # all other bodies at rest
    own = csr_array((entries.data[within], (entries.row[within], entries.col[within])), gram.shape)
    together = UNRESISTED_SQUARE / max(len(np.unique(body)), 1) ** 4
    # first single bodies, then all; eigenvalues of up to 1e-13 are rounding of jumps of length 1
    for matrix, least in ((own, UNRESISTED_SQUARE), (gram, max(together, 1e-13))):
        # pivots have the signs of the eigenvalues less `least` (Sylvester)
        factors = factored(matrix - least * eye_array(m)) if m > 0 else None
        if m == 0 or (factors is not None and (factors.U.diagonal() > 0.0).all()):
            continue
        if matrix is own or m < MANY:
            values, vectors = eigenpairs(matrix)
        else:
            values, vectors = eigsh(matrix, MOTIONS, sigma=-least, v0=np.ones(m))
        motions = dense(vectors[:, values <= least])
        moving = _moving(motions, body)
        if len(moving):
            # the first moving body's modes, projected onto the motions, move what depends on it
            group = motions @ motions[body == moving[0]].T
            return group, len(np.setdiff1d(moving, _moving(group, body)))
    return np.empty((m, 0)), 0


def _moving(motions: Array, body: Indices) -> Indices:
    """Return the bodies that move in `motions` (m, count) of m modes of the bodies `body` (m,)."""
    lengths = np.linalg.norm(motions, axis=1)
    # twice or half the number changes no message of the tests
    return np.asarray(np.unique(body[lengths > 1e-3 * lengths.max(initial=0.0)]))


def _largest_of_group(values: Array, group: Indices) -> Array:
    """Return for each of the values (k,) the largest value with the same number in `group`."""
    largest = np.zeros(int(group.max(initial=-1)) + 1)
    np.maximum.at(largest, group, values)
    return np.asarray(largest[group])
