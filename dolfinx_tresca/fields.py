"""Multipliers and jumps as DOLFINx Functions on the secondary surface."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
from dolfinx import fem

from dolfinx_tresca._base import compat
from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca.pair import ContactPair
from dolfinx_tresca.pairing.operators import PairOperators


class ContactState(IntEnum):
    """State of a node of the secondary surface, as in the field `state`.

    Tresca friction acts on open nodes as well; whether it holds them is in
    `SurfaceFields.sticking`.
    """

    OUTSIDE = -1  #: carries no multiplier: prescribed, or beyond the primary side
    OPEN = 0  #: no pressure
    STICK = 1  #: pressed, and the tangential traction is below the slip bound; or bonded
    SLIP = 2  #: pressed, and the tangential traction has reached the slip bound


@dataclass(frozen=True)
class SurfaceFields:
    """The solution on the secondary surface of one pair.

    The Functions are of degree 1 on `mesh`, the facets of the secondary side, also where the
    displacement is of degree 2. Nodes without a multiplier (state OUTSIDE) have zero in all other
    fields. The arrays have a row per contact node that this rank owns.

    Attributes:
        mesh: the mesh of the surface.
        pressure: contact pressure [stress], positive in compression.
        traction: tangential traction lambda_tau [stress], a vector; the primary body feels it, the
            secondary body its opposite. None without friction.
        slip: tangential jump T u [length], a vector; secondary minus primary. None without
            friction.
        gap: distance d - N u [length], positive: open.
        state: values of `ContactState`.
        points: (n, 3) contact nodes [length].
        weights: (n,) their areas [length^2, in 2D length].
        touching: (n,) pressed nodes.
        sticking: (n,) nodes with a tangential traction below the slip bound, pressed or not.
    """

    mesh: Any
    pressure: fem.Function
    traction: fem.Function | None
    slip: fem.Function | None
    gap: fem.Function
    state: fem.Function
    points: Array
    weights: Array
    touching: Mask
    sticking: Mask

    @property
    def functions(self) -> tuple[fem.Function, ...]:
        """All fields, for writing."""
        fields = (self.pressure, self.traction, self.slip, self.gap, self.state)
        return tuple(field for field in fields if field is not None)


@dataclass(frozen=True)
class Surface:
    """The mesh of a pair's secondary side, and the way from nodes of V to it; built once."""

    mesh: Any
    scalar: Any
    vector: Any
    parent: npt.NDArray[np.int32]
    work: Any

    @classmethod
    def of(cls, V: Any, pair: ContactPair) -> Surface:
        """Return the secondary surface of a pair. Collective."""
        dim = V.mesh.geometry.dim
        facets = np.sort(pair.facet_tags.find(pair.secondary))
        mesh, parent_nodes = compat.create_submesh(V.mesh, pair.facet_tags.dim, facets)
        scalar = fem.functionspace(mesh, ("Lagrange", 1))
        vector = fem.functionspace(mesh, ("Lagrange", 1, (dim,)))
        # node of V <- geometry node of the mesh <- geometry node of the surface <- its node
        block = np.zeros(len(V.mesh.geometry.x), dtype=np.int32)
        corners = dolfinx.cpp.mesh.cell_num_vertices(V.mesh.topology.cell_type)
        block[compat.geometry_dofmap(V.mesh)[:, :corners]] = V.dofmap.list[:, :corners]
        count = scalar.dofmap.index_map.size_local + scalar.dofmap.index_map.num_ghosts
        parent = np.zeros(count, dtype=np.int32)
        corners = scalar.dofmap.list.shape[1]
        parent[scalar.dofmap.list] = block[parent_nodes[compat.geometry_dofmap(mesh)[:, :corners]]]
        return cls(mesh, scalar, vector, parent, fem.Function(V))

    def function(
        self, name: str, nodes: npt.NDArray[np.int32], values: Array, outside: float = 0.0
    ) -> fem.Function:
        """Return a Function with values (n,) or (n, d) at nodes, else `outside`. Collective."""
        dim = self.mesh.geometry.dim
        whole = self.work.x.array.reshape(-1, dim)
        whole[:] = outside
        whole[nodes] = values if values.ndim == 2 else values[:, None]
        self.work.x.scatter_forward()
        function = fem.Function(self.vector if values.ndim == 2 else self.scalar, name=name)
        columns = dim if values.ndim == 2 else 1
        function.x.array[:] = whole[self.parent, :columns].ravel()
        return function

    def fields(
        self,
        operators: PairOperators,
        pressure: Array,
        traction: Array,
        normal_jump: Array,
        tangential_jump: Array,
        touching: Mask,
        sticking: Mask,
    ) -> SurfaceFields:
        """Return the fields of a solution. Collective.

        Args:
            operators: the pair's.
            pressure: (n_normal,) [stress].
            traction: (n_tangential,) [stress].
            normal_jump: (n_normal,) N u [length].
            tangential_jump: (n_tangential,) T u [length].
            touching: (n_normal,) pressed nodes.
            sticking: (n,) nodes with a traction below the bound.
        """
        nodes, count = operators.nodes, len(operators.nodes)

        def at_nodes(values: Array) -> Array:
            result = np.zeros(count)
            result[operators.normal_node] = values
            return result

        def vectors(values: Array) -> Array:
            result = np.zeros((count, self.mesh.geometry.dim))
            np.add.at(result, operators.tangent_node, values[:, None] * operators.tangents)
            return result

        rubs = self.mesh.comm.allreduce(len(operators.tangent_node) > 0, op=MPI.LOR)
        pressed = at_nodes(touching.astype(float)) > 0.0
        state = np.where(sticking, ContactState.STICK, ContactState.SLIP)
        state = np.where(pressed, state, ContactState.OPEN).astype(float)
        return SurfaceFields(
            mesh=self.mesh,
            pressure=self.function("pressure", nodes, at_nodes(pressure)),
            traction=self.function("traction", nodes, vectors(traction)) if rubs else None,
            slip=self.function("slip", nodes, vectors(tangential_jump)) if rubs else None,
            gap=self.function("gap", nodes, operators.gap - at_nodes(normal_jump)),
            state=self.function("state", nodes, state, outside=ContactState.OUTSIDE),
            points=self.work.function_space.tabulate_dof_coordinates()[nodes],
            weights=operators.weights,
            touching=pressed,
            sticking=sticking,
        )
