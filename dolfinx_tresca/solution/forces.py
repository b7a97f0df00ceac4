"""Resultant forces and moments: of contact on bodies, and of supports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from scipy.sparse import vstack

import ufl
from dolfinx import fem

from dolfinx_tresca._base.arguments import checked_vector
from dolfinx_tresca._base.arrays import Array, Indices, Mask, in_space, integer
from dolfinx_tresca._base.compat import owned_dofs
from dolfinx_tresca._base.functions import assembled, owned_values
from dolfinx_tresca._base.parallel import exchange, gather_rows, largest_abs, reduce_array
from dolfinx_tresca.errors import ContactError, InputError, shown
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.stiffness.frames import BodyFrames
from dolfinx_tresca.stiffness.system import LinearSystem


@dataclass(frozen=True)
class Resultant:
    """Force and moment of contact on a body or on one side of a pair, or of a support on bodies.

    Attributes:
        force: (d,) resultant force [force]; in 2D per unit of thickness.
        moment: (3,) resultant moment about `point` [force length]; in 2D (1,), about the axis out
            of the plane.
        point: (d,) reference point of the moment [length].
    """

    force: Array
    moment: Array
    point: Array

    def about(self, point: npt.ArrayLike) -> Resultant:
        """Return the resultant about another point, d finite coordinates. Not collective."""
        centre = checked_vector("the point of a moment", point, len(self.point))
        return Resultant(self.force, self.moment + moments(self.point - centre, self.force), centre)


class BoltForce(NamedTuple):
    """The force in a bolt that the mesh cuts in two (`Preload`), positive in tension.

    Attributes:
        force: the force [force].
        change: the force less the preload: zero while the bolt is pulled, and then due to loads.
    """

    force: float
    change: float


def moments(arm: Array, force: Array) -> Array:
    """Return moments (..., 3), in 2D (..., 1), of forces (..., d) with arms (..., d)."""
    turning = np.cross(in_space(arm), in_space(force)).astype(np.float64)
    return turning if force.shape[-1] == 3 else turning[..., 2:]


def resultants_on(
    comm: Any, places: Array, forces: Array, index: Indices, count: int, point: Array
) -> tuple[Resultant, ...]:
    """Return `count` resultants of forces (n, d) at places (n, d), about a point (d,). Collective.

    The index (n,) says for each force to which resultant it belongs, such as that of its body.
    """
    both = np.hstack([forces, moments(places - point, forces)])
    sums = np.zeros((count, both.shape[1]))
    np.add.at(sums, index, both)
    dim = forces.shape[1]
    return tuple(Resultant(row[:dim], row[dim:], point) for row in reduce_array(comm, sums))


def nodal_resultants(
    V: Any, forces: Array, displaced: fem.Function | None, index: Indices, count: int
) -> tuple[Resultant, ...]:
    """Return resultants of forces on nodes, about the centre of all loaded nodes. Collective.

    This is the centre of the loaded nodes' bounding box, or the origin without forces. The forces
    (owned degrees of freedom of V,) act on nodes displaced by `displaced`; None: on undeformed
    bodies. For index (owned nodes,) and count see `resultants_on`.
    """
    comm, dim = V.mesh.comm, V.mesh.geometry.dim
    rows = forces.reshape(-1, dim)
    places = V.tabulate_dof_coordinates()[: len(rows), :dim]
    if displaced is not None:
        places = places + owned_values(displaced)
    loaded = places[rows.any(axis=1)]
    bounds = [loaded.min(axis=0, initial=np.inf), (-loaded).min(axis=0, initial=np.inf)]
    low, negated_high = reduce_array(comm, bounds, MPI.MIN)
    centre = 0.5 * (low - negated_high) if np.isfinite(low).all() else np.zeros(dim)
    return resultants_on(comm, places, rows, index, count, centre)


def resultants_between(
    V: Any, label: npt.NDArray[np.int64], pairs: Sequence[PairOperators], forces: Sequence[Array]
) -> dict[tuple[int, int], Resultant]:
    """Return (i, j) -> the resultant on body i by body j, for bodies i < j in contact. Collective.

    Forces of obstacles, and forces within a body, do not count. Moments are about the mean of the
    points at which the forces act, weighted by their sizes. Forces (n, d) are those on the nodes of
    each pair's secondary side; the label (owned nodes,) is the body of a node.
    """
    comm, dim = V.mesh.comm, V.mesh.geometry.dim
    # an entry for each primary node that exerts a share of the force on a secondary node: the
    # bodies of both nodes, and the share as a force on the body with the lower number
    shares = vstack([pair.primary for pair in pairs], format="coo")
    secondary = np.concatenate([pair.nodes for pair in pairs])[shares.row]
    partners, column = np.unique(shares.col.astype(np.int64), return_inverse=True)
    # ask the ranks that own these partners for the partners' bodies
    start, end = V.dofmap.index_map.local_range
    owners = (partners[:, None] >= np.array(comm.allgather(end))).sum(axis=1)
    asked, source = exchange(comm, partners, owners)
    answers, _ = exchange(comm, label[asked - start], source)
    on, by = label[secondary], answers[column]
    sign = np.sign(by - on)  # 1: the secondary node is on the body with the lower number
    on_lower = (sign * shares.data)[:, None] * np.concatenate(forces)[shares.row]
    places = np.concatenate([pair.places for pair in pairs])[shares.row]
    weights = np.linalg.norm(on_lower, axis=1)[:, None]
    # sum force, moment about the origin, weighted place and weight for each two bodies
    rows = np.hstack([on_lower, moments(places, on_lower), weights * places, weights])
    acts = weights[:, 0] > 0.0  # not within a body
    bodies = np.column_stack([np.minimum(on, by), np.maximum(on, by)])

    def summed(bodies: npt.NDArray[Any], rows: Array) -> tuple[npt.NDArray[Any], Array]:
        """Return the different rows of bodies (n, 2), ascending, and the sums of their rows."""
        different, index = np.unique(bodies, axis=0, return_inverse=True)
        sums = np.zeros((len(different), rows.shape[1]))
        np.add.at(sums, index.ravel(), rows)
        return different, sums

    own_bodies, own_sums = summed(bodies[acts], rows[acts])
    both, sums = summed(gather_rows(comm, own_bodies), gather_rows(comm, own_sums))
    origin, result = np.zeros(dim), {}
    for (i, j), row in zip(both.tolist(), sums, strict=True):
        force, moment, place = np.split(row[:-1], [dim, len(row) - dim - 1])
        result[i, j] = Resultant(force, moment, origin).about(place / row[-1])
    return result


@dataclass(frozen=True)
class Supports:
    """Supports of the bodies at a solution: Dirichlet conditions, and springs on surfaces.

    Attributes:
        residual: internal minus external forces at u without contact, a form of rank 1.
        u: the displacement in this form; for bodies that have turned, that in their frames.
        contact_force: contact forces on all nodes [force].
        facet_tags: tags of the surfaces on which supports may be.
    """

    residual: ufl.Form
    system: LinearSystem
    u: fem.Function
    contact_force: fem.Function
    facet_tags: Any

    def reaction(
        self,
        where: Any,
        point: npt.ArrayLike | None,
        *,
        displaced: fem.Function | None = None,
        frames: BodyFrames | None = None,
    ) -> Resultant:
        """Return the force and moment of a support, see `ContactProcess.reaction`. Collective.

        Forces act on nodes displaced by `displaced`; None: on undeformed bodies. The `frames` are
        those of linear bodies that have turned.
        """
        V, u = self.contact_force.function_space, self.u
        if u.function_space.element != V.element:
            raise InputError(
                "reaction() needs forms of the displacement alone, not of a mixed space."
            )
        forces = self._at_nodes(self.residual)
        if frames is not None:  # loads are in space, internal forces in the frames
            loads = self._at_nodes(ufl.replace(self.residual, {u: fem.Function(u.function_space)}))
            forces = frames.into_space(forces - loads) + loads
        forces -= self.contact_force.x.array[: len(forces)]
        # no forces may be left at free nodes
        free, contact = ~self.system.prescribed, self.contact_force.x.array
        unbalanced, *largest = largest_abs(self.system.comm, forces[free], forces, contact)
        # solutions of the default accuracy leave less than a hundredth of this
        if unbalanced > 2e-2 * max(largest):
            # rounding errors of forces are below 1e-10 of the forces of a displacement as large as
            # u whose sign changes from node to node: in these the terms of an internal force do not
            # cancel. Loads are far above this
            opposite = fem.Function(u.function_space)
            parity = np.arange(len(u.x.array)) // u.function_space.dofmap.bs % 2
            opposite.x.array[:] = u.x.array * (1.0 - 2.0 * parity)
            opposite.x.scatter_forward()
            opposite_forces = self._at_nodes(ufl.derivative(self.residual, u, opposite))
            (greatest,) = largest_abs(u.function_space.mesh.comm, opposite_forces)
            if unbalanced > 1e-10 * greatest:
                raise ContactError(
                    "loads, prescribed values or coefficients have changed since the solution, or "
                    "it has not converged: forces at free nodes are "
                    f"{unbalanced / max(largest):.2g} of the largest force. Call solve() before "
                    "reaction()."
                )
        held, springs = self._held_and_springs(where)
        forces = np.where(held, forces, 0.0)
        if springs:
            forces -= self._at_nodes(springs)
        index = np.zeros(V.dofmap.index_map.size_local, dtype=np.intp)
        (result,) = nodal_resultants(V, forces, displaced, index, 1)
        return result if point is None else result.about(point)

    def _at_nodes(self, form: Any) -> Array:
        """Return a form of rank 1, assembled at the owned degrees of freedom. Collective."""
        V = self.contact_force.function_space
        return owned_values(assembled(form, V, self.system.entity_maps)).ravel()

    def _held_and_springs(self, where: Any) -> tuple[Mask, ufl.Form | None]:
        """Return which owned degrees of freedom a support prescribes, and its springs. Collective.

        The support is a Dirichlet condition, or the conditions and springs on a surface, given by
        its tag. Springs are the terms of the residual on the surface that depend on u; else None.
        """
        V = self.contact_force.function_space
        held = np.zeros(len(self.system.prescribed), dtype=np.bool_)
        tag, springs = integer(where), []
        if tag is None:
            if not any(where is bc for bc in self.system.bcs):
                raise InputError(
                    "reaction() needs the tag of a surface, or a Dirichlet condition in the list "
                    f"bcs of the problem, found {shown(where)}."
                )
            held[owned_dofs(where, len(held))] = True
        else:
            facets = self.facet_tags.find(tag)
            if reduce_array(V.mesh.comm, len(facets)) == 0:
                raise InputError(f"no facet has the tag {tag}.")
            nodes = fem.locate_dofs_topological(V, self.facet_tags.dim, facets)
            nodes = nodes[nodes < V.dofmap.index_map.size_local]
            held.reshape(-1, V.dofmap.bs)[nodes] = True
            for integral in self.residual.integrals():
                tags = np.atleast_1d(integral.subdomain_id())
                if integral.integral_type() == "exterior_facet" and tag in tags:
                    if self.u in ufl.algorithms.extract_coefficients(integral.integrand()):
                        springs.append(integral.reconstruct(subdomain_id=tag))
        held &= self.system.prescribed
        if not springs and not reduce_array(V.mesh.comm, int(held.sum())):
            raise InputError(
                f"nothing holds the bodies at {shown(where)}: no condition and no spring."
            )
        return held, ufl.Form(springs) if springs else None
