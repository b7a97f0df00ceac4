"""Two blocks with random moduli, widths, meshes, motion and friction; in m and MPa."""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca import (
    ContactForce,
    ContactPair,
    Coulomb,
    Frictionless,
    MeanPressure,
    MeanSlip,
    NormalForce,
    TaggedMesh,
    Tresca,
)
from dolfinx_tresca.scene.friction import Friction
from dolfinx_tresca.scene.pair import Goal
from scenes.elasticity import by_body, elasticity, fixed, no_load
from scenes.patches import (
    BOTTOM,
    KINDS,
    LOWER,
    LOWER_BLOCK,
    TOP,
    UPPER,
    UPPER_BLOCK,
    patch,
)
from scenes.scene import Scene

#: Young's modulus of the lower block [MPa].
YOUNG = 1000.0


@dataclass(frozen=True)
class RandomBlocks:
    """Random parameters of the two blocks.

    Attributes:
        dim: dimension of space.
        upper: divisions of the upper block across and along the last axis.
        narrow: whether the upper block has half the width of the lower one along the first axis.
        young: Young's modulus of the upper block [MPa].
        poisson: Poisson's ratio of both blocks.
        motion: displacement of the upper end along the first axis, its downward displacement, and
            the difference of the downward displacements of both sides [m].
        friction: law of friction of the pair.
    """

    dim: int
    upper: tuple[int, int]
    narrow: bool
    young: float
    poisson: float
    motion: tuple[float, float, float]
    friction: Friction

    @classmethod
    def drawn(cls, seed: int, dim: int) -> RandomBlocks:
        """Return the blocks that belong to a seed."""
        rng = np.random.default_rng([seed, dim])
        laws: list[Friction] = [
            Frictionless(),
            Tresca(rng.uniform(0.3, 3.0)),
            Coulomb(rng.uniform(0.1, 0.5)),
        ]
        return cls(
            dim=dim,
            upper=(int(rng.integers(5, 10)), 6) if dim == 2 else (int(rng.integers(2, 5)), 2),
            narrow=bool(rng.random() < 0.3),
            young=YOUNG * 10.0 ** rng.uniform(-0.5, 0.3),
            poisson=rng.uniform(0.0, 0.45),
            motion=(
                rng.uniform(0.3e-3, 2e-3), rng.uniform(2e-3, 5e-3), rng.uniform(-8e-3, 8e-3),
            ),
            friction=laws[int(rng.integers(3))],
        )  # fmt: skip

    def coarse(self, comm: MPI.Comm) -> Scene:
        """Return the scene of degree 1 on its first mesh. Collective."""
        span = [(0.25, 0.75), *[(0.0, 1.0)] * (self.dim - 2)] if self.narrow else None
        lower = (8, 8) if self.dim == 2 else (3, 3)
        kind = KINDS[2 * self.dim - 4]
        plain = patch(comm, kind, upper=self.upper, lower=lower, distort=0.0, span=span)
        tags = {"upper": UPPER_BLOCK, "lower": LOWER_BLOCK}
        return self.on(TaggedMesh(plain.mesh, plain.cell_tags, plain.facet_tags, tags), degree=1)

    def on(self, blocks: TaggedMesh, degree: int) -> Scene:
        """Return the scene on any mesh of the blocks, such as a refined one. Collective."""
        V = fem.functionspace(blocks.mesh, ("Lagrange", degree, (self.dim,)))
        moved = fem.Function(V)
        moved.interpolate(self._moved)
        facets = blocks.facet_tags
        top = fem.locate_dofs_topological(V, self.dim - 1, facets.find(TOP))
        bcs = [fem.dirichletbc(moved, top), fixed(V, facets.find(BOTTOM))]
        young = by_body(blocks, {"upper": self.young, "lower": YOUNG})
        a = elasticity(V, young, self.poisson)
        pair = ContactPair(facets, UPPER, LOWER, self.friction)
        return Scene(V, a, no_load(V), bcs, [pair], facets, blocks.cell_tags, blocks.tags)

    def goals(self) -> dict[str, Goal]:
        """Return goals by name; the patches are at the side with the larger pressure."""
        *_, tilt = self.motion
        point = np.full(self.dim, 0.5)
        point[[0, -1]] = 0.5 - np.sign(tilt) * (0.15 if self.narrow else 0.3), 1.0
        along, radius = np.eye(self.dim)[0], 0.1 * self.dim
        goals: dict[str, Goal] = {
            "normal force": NormalForce(),
            "mean pressure": MeanPressure(point, radius),
        }
        if not isinstance(self.friction, Frictionless):
            goals["tangential force"] = ContactForce(along)
            goals["mean slip"] = MeanSlip(point, radius, along)
        return goals

    def _moved(self, x: np.ndarray) -> np.ndarray:
        """Return displacements (dim, n) of the upper end at points (3, n)."""
        drag, press, tilt = self.motion
        u = np.zeros((self.dim, x.shape[1]))
        u[0] = drag
        u[-1] = tilt * (x[0] - 0.5) - press
        return u
