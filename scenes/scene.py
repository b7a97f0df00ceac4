"""A scene: forms, Dirichlet conditions and tags, as users of FEniCSx have them, and the pairs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from dolfinx_tresca import ContactPair, ContactProblem, TaggedMesh
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.pairing.pair_surfaces import pair_surfaces
from dolfinx_tresca.stiffness.system import LinearSystem
from scenes.elasticity import fixed

#: Machine epsilon: tolerances for rounding are multiples of it.
EPS = float(np.finfo(float).eps)

#: Points (n, 3) -> points (n, 3).
Map = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Scene:
    """The parts of a contact problem.

    Attributes:
        V: the space of the displacement.
        a: bilinear form.
        L: linear form.
        bcs: Dirichlet conditions.
        pairs: surfaces that may touch.
        facet_tags: tags of the facets of the mesh.
        cell_tags: tags of the cells, if there are any.
        tags: name -> tag, if the scene was read from a file.
        data: values by name that may be changed in place (loads, motions, materials), or that a
            solution is compared with (exact fields, theory).
        geometry: Gmsh's geometry, on which refinement places new nodes; None: there is none.
    """

    V: Any
    a: Any
    L: Any
    bcs: list[Any]
    pairs: list[ContactPair]
    facet_tags: Any
    cell_tags: Any = None
    tags: dict[str, int] = field(default_factory=dict)
    data: SimpleNamespace = field(default_factory=SimpleNamespace)
    geometry: Any = None

    @property
    def mesh(self) -> Any:
        """The mesh of all bodies."""
        return self.V.mesh

    @property
    def unknowns(self) -> int:
        """The number of displacement unknowns on all ranks."""
        dofmap = self.V.dofmap
        return int(dofmap.index_map.size_global * dofmap.index_map_bs)

    @property
    def tagged_mesh(self) -> TaggedMesh:
        """The mesh with its tags and their names, as it was read."""
        return TaggedMesh(self.mesh, self.cell_tags, self.facet_tags, self.tags, self.geometry)

    @property
    def pair(self) -> ContactPair:
        """The only pair."""
        (pair,) = self.pairs
        return pair

    def facets(self, name: str) -> np.ndarray:
        """Return the facets of a named surface on this rank."""
        found: np.ndarray = self.facet_tags.find(self.tags[name])
        return found

    def fixed(self, name: str, value: Any = None, component: int | None = None) -> Any:
        """Return the condition that u, or a component, is `value` (default 0) on a surface."""
        return fixed(self.V, self.facets(name), value, component)

    def problem(self, **changes: Any) -> ContactProblem:
        """Return the problem; `changes` replace or add arguments of ContactProblem. Collective."""
        given = {"a": self.a, "L": self.L, "pairs": self.pairs, "bcs": self.bcs, **changes}
        return ContactProblem(**given)

    def operators(self, pair: ContactPair | None = None) -> PairOperators:
        """Return N, T and the gap of the only pair, or of another one. Collective."""
        with LinearSystem(self.a, self.L, self.bcs) as system:
            return pair_surfaces(self.V, system.prescribed, pair or self.pair)

    def but(self, **changes: Any) -> Scene:
        """Return the scene with attributes of its pairs changed."""
        return replace(self, pairs=[replace(pair, **changes) for pair in self.pairs])

    def moved(self, to: Map, turn: np.ndarray | None = None) -> Scene:
        """Map the points of the mesh, turn `data.load` by a rotation (3, 3); return the scene."""
        x = self.mesh.geometry.x
        x[:] = to(x.copy())
        if turn is not None:
            self.data.load.value[:] = turn @ self.data.load.value
        return self
