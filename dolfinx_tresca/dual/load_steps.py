"""Transfer from one pairing to the next, and over load steps: B, multipliers, and slip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Indices, LocalNumbers, Mask
from dolfinx_tresca._base.parallel import gather_rows, reduce_array, warn
from dolfinx_tresca._base.petsc import destroyed_on_error
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.pairing.pair_surfaces import pair_displaced_surfaces
from dolfinx_tresca.pairing.undeformed import straightened
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.stiffness.frames import BodyFrames


def displaced_jump(
    before: JumpOperator,
    pairs: Sequence[ContactPair],
    u: fem.Function,
    anew: Sequence[bool] | Mask,
    frames: BodyFrames | None = None,
) -> JumpOperator:
    """Return B of surfaces displaced by u [length], owned by the caller. Collective.

    The surfaces of a pair are paired anew if `anew` (pairs,) says so for the pair, or for another
    pair of its group; bonded pairs stay as in `before`. Since the gap d limits N times the total
    displacement, d is the distance of the displaced surfaces plus N u. The distance is measured to
    primary edges as u bends them, since they may face other nodes than before: so the N u that is
    added contains this bending. Bending of secondary edges is in neither term, since N times the
    total displacement contains it; their heights over their chords stay as in `before`.

    Raises:
        PairingError: the displaced surfaces cannot be paired.
    """
    # groups with a pair that is paired anew are paired anew as a whole
    system, V = before.system, u.function_space
    comm = V.mesh.comm
    stay = [old.bonded or not new for old, new in zip(before.pairs, anew, strict=True)]
    values = u.x.array.reshape(-1, V.dofmap.index_map_bs)
    straight_u = straightened(V, values)
    operators = list(before.pairs)
    for number, old in enumerate(before.pairs):
        numbers = old.undeformed.group.numbers
        if number == numbers[0] and not all(stay[k] for k in numbers):
            paired = pair_displaced_surfaces(V, old.undeformed, straight_u)
            for k, operator in zip(numbers, paired, strict=True):
                stay[k] = before.pairs[k].bonded
                operators[k] = before.pairs[k] if stay[k] else operator
    # gaps of these pairs; of a copy, since PETSc's vector of u would be left to garbage collection
    paired_at = u.copy()
    jump = JumpOperator(system, operators, frames)
    with destroyed_on_error(jump):
        closings = jump.closings(paired_at)
        for k, (new, old, pair) in enumerate(zip(operators, before.pairs, pairs, strict=True)):
            if stay[k]:
                continue
            old_count, new_count = reduce_array(comm, [len(old.nodes), len(new.nodes)])
            if new_count == 0 and old_count > 0:
                warn(
                    comm,
                    "contact pair %s: none of %d paired nodes faces the other side any more: "
                    "the surfaces have left each other, or have passed through each other in "
                    "too large a load step: then take smaller steps.",
                    *(pair, old_count),
                    about=str(pair),
                )
            if straight_u is not values:
                paired_at.x.array[:] = _bent_primary(V, straight_u, values, new).ravel()
                closings = jump.closings(paired_at)
            # the heights of curved edges in the previous B; 0 at new nodes
            position = _position(new.nodes, old.nodes)
            raised = np.append(old.secondary_sagitta, 0.0)[position]
            distance = new.distance + new.secondary_sagitta - raised + closings[k]
            operators[k] = replace(new, distance=distance, secondary_sagitta=raised)
        jump.set_gaps(operators)
    return jump


def _bent_primary(V: Any, straight_u: Array, u: Array, operators: PairOperators) -> Array:
    """Return the displacement (nodes, dim of space) of which N u is part of the gap. Collective.

    On primary nodes of the group this is `u`. Elsewhere it is `straight_u`, with the mean of the
    vertices at nodes between them. It is `straight_u` everywhere for obstacles, and if the exact
    surface of a side is known, whose height over facets is kept. Both are (nodes, dim) [length].
    """
    pair, sides = operators.undeformed.group.surfaces, operators.undeformed.sides
    if any(side.has_exact_surface for side in sides) or pair.obstacle is not None:
        return straight_u
    if pair.touches_itself:
        # tags do not tell primary from secondary nodes: primary is what faces secondary nodes
        numbers = np.unique(gather_rows(V.mesh.comm, np.unique(operators.primary.indices)))
        nodes = V.dofmap.index_map.global_to_local(numbers)
        nodes = nodes[nodes >= 0]
    else:
        facets = pair.facet_tags.find(pair.primary)
        nodes = fem.locate_dofs_topological(V, pair.facet_tags.dim, facets)
    result = straight_u.copy()
    result[nodes] = u[nodes]
    return result


class Carry:
    """Carries tractions and jumps over to another B of the same pairs, node by node.

    Tangential vectors stay the same in space, but for parts along which the new B has no tangent.
    Nodes without multipliers in the old B get zero.
    """

    def __init__(self, before: JumpOperator, after: JumpOperator) -> None:
        """Find the nodes of the new B, `after`, among those of the old B. Not collective."""
        self._before, self._after = before, after
        pairs = zip(before.pairs, after.pairs, strict=True)
        self._positions = [_position(new.nodes, old.nodes) for old, new in pairs]

    def multipliers(self, x: Array) -> Array:
        """Return the multipliers (size,) of the new B with the tractions of x. Not collective."""
        return self._carried(x * self._before.stress_scale) / self._after.stress_scale

    def jumps(self, jumps: Array) -> Array:
        """Return scaled jumps (size,) of the new B with the same lengths. Not collective."""
        return self._carried(jumps * self._before.length_scale) / self._after.length_scale

    def _carried(self, values: Array) -> Array:
        """Return tractions [stress] or jumps [length], (size,), in the rows of the new B."""
        pairs = zip(self._before.nodal_vectors(values), self._positions, strict=True)
        # for nodes that are new, `_position` is the index of the row of zeros that is appended here
        padded = [np.pad(vectors, ((0, 1), (0, 0)))[position] for vectors, position in pairs]
        return self._after.components(padded)


def _position(nodes: LocalNumbers, old_nodes: LocalNumbers) -> Indices:
    """Return the index (n,) of each node in `old_nodes`; len(old_nodes) if it is missing.

    Both arrays are ascending. A node on a sharp edge occurs once for each normal, in order.
    """
    # a key for each occurrence of a node: the node's number times `most`, plus 0, 1, ...
    most = max(len(nodes), len(old_nodes))
    occurrence = np.arange(len(nodes)) - np.searchsorted(nodes, nodes)
    old_occurrence = np.arange(len(old_nodes)) - np.searchsorted(old_nodes, old_nodes)
    keys = nodes.astype(np.int64) * most + occurrence
    old_keys = old_nodes.astype(np.int64) * most + old_occurrence
    index = np.searchsorted(old_keys, keys)
    is_old = np.append(old_keys, -1)[index] == keys  # -1 is no key
    return np.where(is_old, index, len(old_nodes))


@dataclass(frozen=True)
class SlipHistory:
    """The slip and the dissipation of the accepted load steps.

    In a quasi-static process, friction resists the slip T u - s of each step, where s is the slip
    origin, and dissipates energy (docs/theory/problem.md): one step of backward Euler's method.

    Attributes:
        origin: (size,) s, the tangential jump at which the slip of the step is zero, divided by
            `JumpOperator.length_scale`; zero in normal rows, and where surfaces are bonded.
        slipped: for each pair an array (owned nodes of V, d + 1) with the sum of the slip vectors
            of all steps, and the sum of their lengths [length]; nodes keep them without a partner.
        dissipation: dissipation of all steps [energy].
        begun: whether a step was accepted; if not, slips count from the undeformed bodies.
    """

    origin: Array
    slipped: tuple[Array, ...]
    dissipation: float = 0.0
    begun: bool = False

    @classmethod
    def none(cls, jump: JumpOperator) -> SlipHistory:
        """Return the history of undeformed bodies. Not collective."""
        V = jump.system.V
        shape = V.dofmap.index_map.size_local, V.mesh.geometry.dim + 1
        return cls(np.zeros(len(jump.gap)), tuple(np.zeros(shape) for _ in jump.pairs))

    @classmethod
    def from_displacement(cls, jump: JumpOperator, u: fem.Function) -> SlipHistory:
        """Return the history of one step whose slip is the tangential jump of u. Collective."""
        slip = jump.of_displacement(u) * jump.length_scale
        steps = []
        for pair, rows in zip(jump.pairs, jump.nodal_vectors(slip), strict=True):
            vectors = np.zeros_like(pair.normals) if pair.bonded else rows[:, 1:]
            steps.append(np.column_stack([vectors, np.linalg.norm(vectors, axis=1)]))
        return cls.from_slip(jump, steps, 0.0)

    @classmethod
    def from_slip(
        cls, jump: JumpOperator, slips: Sequence[Array], dissipation: float
    ) -> SlipHistory:
        """Return the history of one step, such as one on another mesh. Not collective.

        For each pair, slips (n, d + 1) [length] are slip vectors at its nodes and lengths of paths.
        """
        # as in `JumpOperator.components`: a zero normal component in front, and no lengths of paths
        vectors = [np.pad(slip[:, :-1], ((0, 0), (1, 0))) for slip in slips]
        origin = jump.components(vectors) / jump.length_scale
        return cls.none(jump).after(jump, origin, slips, dissipation)

    def after(
        self, jump: JumpOperator, slip: Array, steps: Sequence[Array], dissipation: float
    ) -> SlipHistory:
        """Return the history after a further load step. Not collective.

        The slip (size,) is added to `origin`: divided by `JumpOperator.length_scale`, and zero at
        sticking nodes, since residuals of the iteration would add up over the steps. For each pair,
        steps (n, d + 1) [length] are slip vectors at its nodes and lengths of paths.
        """
        slipped = tuple(slips.copy() for slips in self.slipped)
        for slips, step, pair in zip(slipped, steps, jump.pairs, strict=True):
            slips[pair.nodes] += step
        return SlipHistory(self.origin + slip, slipped, self.dissipation + dissipation, begun=True)
