"""Multipliers and jumps as DOLFINx Functions on the secondary surface; slips on another mesh."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx
from dolfinx import fem

from dolfinx_tresca._base import compat
from dolfinx_tresca._base.agreement import collective, comm_of_self
from dolfinx_tresca._base.arrays import Array, Indices, LocalNumbers, Mask
from dolfinx_tresca._base.functions import nodes_of_vertices, zero_like
from dolfinx_tresca._base.parallel import summed_at_nodes
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.pairing.contact_operators import ContactOperators
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.scene.pair import ContactPair


class ContactState(IntEnum):
    """State of a node of the secondary surface, as in the field `state`.

    Tresca friction acts on open nodes as well: they stick or slip, too. The states of pressed and
    bonded nodes are `PRESSED` or greater.
    """

    OUTSIDE = -1  #: no multiplier: fully prescribed, on both sides, or beyond the primary side
    OPEN = 0  #: no pressure, and no friction
    OPEN_STICK = 1  #: no pressure, and the tangential traction is below the slip bound
    OPEN_SLIP = 2  #: no pressure, and the tangential traction has reached the slip bound
    PRESSED = 3  #: pressed, without friction
    STICK = 4  #: pressed, and the tangential traction is below the slip bound
    SLIP = 5  #: pressed, and the tangential traction has reached the slip bound
    BONDED = 6  #: tied to the primary side


#: States that count as sticking.
STICKING = (ContactState.OPEN_STICK, ContactState.STICK, ContactState.BONDED)


class IntegerFunction(fem.Function):  # type: ignore[misc]
    """A Function whose values are categories; files store them as integers."""


@dataclass(frozen=True)
class SurfaceFields:
    """The solution on the secondary surface of one pair.

    The Functions are of degree 1 on `mesh`, the facets of the secondary side, also where the
    displacement is of degree 2. At nodes without a multiplier (state OUTSIDE) all fields are zero,
    except state and displacement. On sharp edges, where a node carries multipliers for several
    smooth patches, fields have the values of the largest patch.

    In problems with more than 50 pairs several pairs share a mesh; the fields of a pair have the
    state OUTSIDE on the facets of the others.

    All arrays have the order of the Functions, with a row for each node on this rank, ghosts
    included. Ghosts have zero weight, so `weights @ pressure.x.array`, summed over the ranks, is
    the force. On sharp edges this sum is approximate, since one pressure stands for all patches of
    a node; `ContactSolution.normal_force` is exact.

    Attributes:
        name: name of the pair.
        mesh: the mesh of the surface.
        pressure: contact pressure [stress], positive in compression.
        traction: tangential traction lambda_tau [stress], a vector; it acts on the primary body,
            and the opposite traction acts on the secondary body. None without friction.
        slip: tangential jump T u [length], a vector; secondary minus primary. With several load
            steps it is the sum of their slip vectors. None without friction.
        slip_increment: slip since the last accepted step, T u - s [length], a vector along the
            traction; before the first accepted step it is `slip` itself. None without friction.
        slip_path: length of a node's path over the other side [length]: the sum of its slip lengths
            over all steps in which it was pressed or had a positive slip bound; on sharp edges the
            longest slip of its patches counts. None without friction.
        gap: distance d - N u [length], positive: open. Negative where Dirichlet conditions, which
            prescribe the displacement along the normal, push a node into the other side.
        initial_gap: distance d before the bodies move [length], positive: open.
        state: values of `ContactState`.
        displacement: displacement of the secondary side [length] at the corners of its facets.
        normal: unit normal along which gap and pressure are measured: outward from the secondary
            side, or towards a rigid obstacle.
        weights: (n,) areas of nodes [length^2, in 2D length], on sharp edges the sum over all
            patches; zero at ghosts and at nodes without a multiplier.
        obstacle: the rigid primary side, at its position in this solution; None if the primary side
            is deformable.
        slides_far: whether the pair has finite sliding.
        entity_maps: the argument `entity_maps` of `fem.form` and `ContactProblem` for forms on the
            problem's mesh that contain these Functions: a dict in DOLFINx 0.9, a list from 0.10 on.
            Such forms can only be integrated over facets of this surface, by `ufl.ds` whose
            `domain` is the problem's mesh. Functions from `on_mesh` need no entity maps.
    """

    name: str
    mesh: Any
    pressure: fem.Function
    traction: fem.Function | None
    slip: fem.Function | None
    slip_increment: fem.Function | None
    slip_path: fem.Function | None
    gap: fem.Function
    initial_gap: fem.Function
    state: IntegerFunction
    displacement: fem.Function
    normal: fem.Function
    weights: Array
    obstacle: RigidObstacle | None
    slides_far: bool
    entity_maps: compat.EntityMaps
    _on_both_sides: Callable[[fem.Function], fem.Function] = field(repr=False)

    def __repr__(self) -> str:
        names = ", ".join(function.name for function in self.functions)
        return f"<SurfaceFields of {self.name}: {names}>"

    @property
    def points(self) -> Array:
        """(n, 3) coordinates of the nodes [length]."""
        return np.asarray(self.pressure.function_space.tabulate_dof_coordinates())

    @property
    def touching(self) -> Mask:
        """(n,) True at pressed and bonded nodes."""
        return np.asarray(self.state.x.array >= ContactState.PRESSED)

    @property
    def sticking(self) -> Mask:
        """(n,) True at bonded nodes, and where the tangential traction is below the slip bound.

        Pressed and open nodes count alike. False everywhere without friction.
        """
        return np.isin(self.state.x.array, STICKING)

    @collective(comm_of_self)
    def on_mesh(self, name: str) -> fem.Function:
        """Return a field as a Function on the problem's mesh, of degree 1. Collective.

        The values at nodes of the secondary side are those of the field. At nodes of the primary
        side they are means over the opposite part of the secondary side, and at other nodes zero.
        The sum of the values times `ContactOperators.areas` is equal on both sides; for a pressure
        this sum is the force. An integral over either side, in a form, equals this sum if the two
        sides face each other completely. If facets extend beyond the other side, the integral
        includes their whole area: multiply the Function by `ContactOperators.area_fraction` to
        leave out the part beyond.

        Args:
            name: name of the field, such as "pressure".

        Raises:
            InputError: the surface has no such field, as for friction fields without friction.
        """
        function = getattr(self, name, None) if isinstance(name, str) else None
        if not isinstance(function, fem.Function) or function is self.state:
            names = ", ".join(field.name for field in self.functions if field is not self.state)
            raise InputError(
                f"this surface has no field {shown(name)} to transfer; its fields are {names}."
            )
        return self._on_both_sides(function)

    @property
    def functions(self) -> tuple[fem.Function, ...]:
        """Fields for output: not `initial_gap`; `slip_increment`, `slip_path` from step 2 on."""
        steps = () if self.slip_increment is self.slip else ("slip_increment", "slip_path")
        names = ("displacement", "pressure", "traction", "slip", *steps, "gap", "state", "normal")
        fields = (getattr(self, name) for name in names)
        return tuple(field for field in fields if field is not None)


@dataclass(frozen=True)
class Surface:
    """The mesh of a pair's secondary side, and its map to the nodes of V; built once.

    Attributes:
        mesh: the facets of the secondary side, and those of the pairs that share the mesh.
        scalar: a scalar Function of degree 1 on `mesh`, which is copied to make others.
        vector: a vector Function of degree 1 on `mesh`, likewise.
        parent: (nodes of `scalar`, with ghosts) local number of the node of V at each node.
        work: a Function in V through which values reach ghosts, shared by all surfaces.
    """

    mesh: Any
    scalar: fem.Function
    vector: fem.Function
    parent: LocalNumbers
    work: fem.Function
    pair: ContactPair
    entity_maps: compat.EntityMaps

    @classmethod
    def of_pairs(cls, work: fem.Function, pairs: Sequence[ContactPair]) -> list[Surface]:
        """Return the secondary surface of each pair. Collective.

        Of more than 50 pairs several share a mesh, in the order of the pairs. (A mesh takes 6 MPI
        communicators, on several ranks 10, and MPICH has 2,048 of them.)
        """
        V, surfaces = work.function_space, []
        dim, facet_dim = V.mesh.geometry.dim, V.mesh.topology.dim - 1
        pairs_per_mesh = -(-len(pairs) // 50)  # rounded up
        for start in range(0, len(pairs), pairs_per_mesh):
            group = pairs[start : start + pairs_per_mesh]
            facets_of_pairs = [pair.facet_tags.find(pair.secondary) for pair in group]
            facets = np.unique(np.concatenate(facets_of_pairs))
            mesh, parent_nodes, entity_maps = compat.create_submesh(V.mesh, facet_dim, facets)
            Q = fem.functionspace(mesh, ("Lagrange", 1))
            Q_d = fem.functionspace(mesh, ("Lagrange", 1, (dim,)))
            # from a corner of a facet, a node of Q, to the surface's geometry node, to that of the
            # problem's mesh, to the node of V
            corners, nodes = Q.dofmap.list, Q.dofmap.index_map
            surface_nodes = compat.geometry_dofmap(mesh)[:, : corners.shape[1]]
            parent = np.zeros(nodes.size_local + nodes.num_ghosts, dtype=np.int32)
            parent[corners] = nodes_of_vertices(V)[parent_nodes[surface_nodes]]
            scalar, vector = fem.Function(Q), fem.Function(Q_d)
            for pair in group:
                surfaces.append(cls(mesh, scalar, vector, parent, work, pair, entity_maps))
        return surfaces

    def function(self, name: str, nodes: LocalNumbers, values: Array) -> fem.Function:
        """Return the Function on the surface, of degree 1, with values at `nodes`. Collective.

        The values (n,) or (n, d) are those at nodes of V (n,) that this rank owns; at nodes that no
        rank gives, the Function is zero, or the field "state" is OUTSIDE.
        """
        dim = self.mesh.geometry.dim
        columns, original = (dim, self.vector) if values.ndim == 2 else (1, self.scalar)
        whole = self.work.x.array.reshape(-1, dim)
        whole[:] = ContactState.OUTSIDE if name == "state" else 0.0
        whole[nodes, :columns] = values.reshape(-1, columns)
        self.work.x.scatter_forward()
        function = zero_like(original, name, IntegerFunction if name == "state" else fem.Function)
        function.x.array[:] = whole[self.parent, :columns].ravel()
        return function

    def on_both_sides(self, operators: PairOperators, function: fem.Function) -> fem.Function:
        """Return a field on the problem's mesh, see `SurfaceFields.on_mesh`. Collective."""
        columns = function.function_space.dofmap.index_map_bs
        own = self.scalar.function_space.dofmap.index_map.size_local
        V, values = self.work.function_space, function.x.array.reshape(-1, columns)[:own]
        # the rank that owns a node of V may have no cell of the surface at this node
        whole = summed_at_nodes(V.dofmap.index_map, self.parent[:own], values)
        transfer = ContactOperators(V, operators, self.pair)
        is_scalar = function.ufl_shape == ()
        return transfer.on_both_sides(whole[operators.nodes], function.name, scalar=is_scalar)

    def fields(
        self, operators: PairOperators, u: fem.Function, values: Mapping[str, Array]
    ) -> SurfaceFields:
        """Return the fields of a solution from name -> values at the pair's nodes. Collective.

        Values are (n,) or (n, d). Without friction there are no values of traction and slip, and in
        the first step none of `slip_increment`, which then is the slip.
        """
        functions: dict[str, Any] = dict.fromkeys(("traction", "slip", "slip_path"))
        for name, array in values.items():
            functions[name] = self.function(name, operators.nodes, array)
        functions.setdefault("slip_increment", functions["slip"])
        displacement, V = zero_like(self.vector, u.name), u.function_space
        displacement.x.array[:] = u.x.array.reshape(-1, V.dofmap.index_map_bs)[self.parent].ravel()
        owned = V.dofmap.index_map.size_local
        areas = np.bincount(operators.nodes, operators.weights, owned).astype(np.float64)
        weights = self.function("weights", np.arange(owned, dtype=np.int32), areas).x.array
        weights[self.scalar.function_space.dofmap.index_map.size_local :] = 0.0  # ghosts
        return SurfaceFields(
            name=str(self.pair),
            mesh=self.mesh,
            displacement=displacement,
            weights=weights,
            obstacle=copy(self.pair.obstacle),
            slides_far=self.pair.sliding == "finite",
            entity_maps=self.entity_maps,
            _on_both_sides=lambda function: self.on_both_sides(operators, function),
            **functions,
        )


def slip_from(surfaces: Sequence[SurfaceFields], jump: JumpOperator) -> list[Array]:
    """Return each pair's slip vectors and paths (n, d + 1) [length], from another mesh. Collective.

    They are interpolated to the nodes of `jump` from the nearest facets, between those of their
    nodes that carry multipliers. Linear fields are exact, for instance at the midpoints of edges,
    where refined meshes have nodes. Values are zero farther away than the longest edge.
    """
    x = jump.system.V.tabulate_dof_coordinates()
    counts = [len(pair.nodes) for pair in jump.pairs]
    result = np.zeros((sum(counts), 1 + jump.system.V.mesh.geometry.dim))
    for rows, fields in zip(jump.by_pair, surfaces, strict=True):
        if fields.slip is None or fields.slip_path is None:
            continue
        comm, V = fields.mesh.comm, fields.pressure.function_space
        corners = V.tabulate_dof_coordinates()[V.dofmap.list]
        edges = np.linalg.norm(corners[:, :, None] - corners[:, None], axis=3)
        longest_edge = comm.allreduce(edges.max(initial=0.0), op=MPI.MAX)
        # each rank answers for the points of all ranks; the rank with the nearest facet is right
        points = x[rows.operators.nodes]
        asked = comm.allgather(points)
        answers = _on_nearest_facets(fields, np.concatenate(asked))
        ends = np.cumsum([len(points_of_rank) for points_of_rank in asked])
        of_ranks = np.array(comm.alltoall(np.split(answers, ends[:-1])))  # (ranks, points, d + 2)
        nearest_rank = of_ranks[:, :, 0].argmin(axis=0)  # by the distance, for each point
        nearest = of_ranks[nearest_rank, np.arange(len(points))]
        result[rows.nodes] = np.where(nearest[:, :1] <= longest_edge, nearest[:, 1:], 0.0)
    return np.split(result, np.cumsum(counts)[:-1])


def _on_nearest_facets(fields: SurfaceFields, points: Array) -> Array:
    """Return distance, slip and path (n, d + 2) where this rank's facets are nearest to points.

    The distance is infinite if the rank has no facet with multipliers. Not collective.
    """
    mesh, V = fields.mesh, fields.pressure.function_space
    assert fields.slip is not None and fields.slip_path is not None
    carries = zero_like(fields.pressure, "carries")
    carries.x.array[:] = fields.state.x.array != ContactState.OUTSIDE
    facets = np.flatnonzero(carries.x.array[V.dofmap.list].any(axis=1)).astype(np.int32)
    if len(points) == 0 or len(facets) == 0:
        return np.full((len(points), mesh.geometry.dim + 2), np.inf)
    boxes = dolfinx.geometry.bb_tree(mesh, mesh.topology.dim, entities=facets)
    midpoints = dolfinx.geometry.create_midpoint_tree(mesh, mesh.topology.dim, facets)
    cells: Indices = dolfinx.geometry.compute_closest_entity(boxes, midpoints, mesh, points)
    corners = V.tabulate_dof_coordinates()[V.dofmap.list[cells]]
    away = []  # from each point to the nearest point of its facet
    for facet, point in zip(corners, points, strict=True):
        away.append(dolfinx.geometry.compute_distance_gjk(facet, point[None]))
    nearest = points + away
    share = carries.eval(nearest, cells).reshape(len(points), -1)
    slip = fields.slip.eval(nearest, cells).reshape(len(points), -1)
    path = fields.slip_path.eval(nearest, cells).reshape(len(points), -1)
    # nodes without multipliers, where fields are zero, do not count in the interpolation
    slips = np.hstack([slip, path]) / np.where(share > 0.0, share, 1.0)
    return np.column_stack([np.linalg.norm(away, axis=1), slips])
