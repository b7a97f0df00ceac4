"""The mesh to solve on next."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dolfinx import fem

from dolfinx_tresca.adapt.forecast import Forecast
from dolfinx_tresca.adapt.levels import Level
from dolfinx_tresca.adapt.limits import Limits
from dolfinx_tresca.adapt.refinement import Marked, cell_count, cut, owned_values
from dolfinx_tresca.adapt.snapping import Snap
from dolfinx_tresca.scene.mesh import TaggedMesh
from dolfinx_tresca.status import AdaptiveStatus

#: Cells of a mesh over those of the one before, about: so many that all meshes before the last one
#: cost about as much as that, and so few that errors of cells are what they are expected to be.
#: (On the two bricks and a ball one cut at a time took 0.95 to 1.3 times as long, for twice as many
#: solutions; with degree 1 half of the seconds are cuts. With 3 there were 1.3 to 1.7 times as many
#: unknowns for the same error, with 2 1.1 to 1.2 times: at singular edges errors fall less than is
#: expected.)
GROWTH = 2.0

#: Growth over the step that will do before the last one: cuts cost, too.
ENOUGH = 0.85

#: Part of `fraction` that is refined at least.
LEAST_PART = 0.3

#: How much larger a mesh may be than its limit, since what a forecast let be made should be used.
OVERSHOOT = 1.1


@dataclass(frozen=True)
class Refinement:
    """The rule by which meshes are refined.

    Attributes:
        degree: degree of the displacement.
        fraction: see `refine`.
        snap: see `refine`.
        forecast: forecast of the refined mesh.
        limits: limits of the cost of a mesh.
    """

    degree: int
    fraction: float
    snap: Snap | None
    forecast: Forecast
    limits: Limits

    def next(
        self, level: Level, cell_errors: fem.Function, growth: float
    ) -> tuple[TaggedMesh, AdaptiveStatus | None]:
        """Return the mesh after a level, and which limit is in the way of more. Collective.

        Cells are cut once where the error is, and again where it is expected to be then, until the
        mesh has grown. It is the same mesh if a limit is in the way of any cut.

        Args:
            level: solved on.
            cell_errors: errors of its cells.
            growth: of the cells, by all meshes that follow: their steps are alike.
        """
        step = step_of(growth)
        enough = step if step == growth else ENOUGH * step
        mesh, grown = level.tagged_mesh, 1.0
        comm, errors = mesh.mesh.comm, owned_values(mesh.mesh, cell_errors)
        while True:
            fraction = self.fraction
            marked = Marked.of(mesh, errors, fraction)
            by = self.forecast.growth(marked.part)
            if step == growth and fraction < 1.0 and step / grown < by:
                # what comes closer to the accuracy will do
                fraction *= max((step / grown - 1.0) / (by - 1.0), LEAST_PART)
                marked = Marked.of(mesh, errors, fraction)
            status = self.limits.after(comm, level, grown * self.forecast.growth(marked.part))
            if status is not None:
                break
            finer, errors = cut(mesh, errors, marked, self.degree, self.snap)
            by = cell_count(finer) / cell_count(mesh)
            self.forecast.learn(marked.part, by)
            status = self.limits.after(comm, level, grown * by / OVERSHOOT)
            if status is not None:
                break
            mesh, grown = finer, grown * by
            if grown >= enough:
                break
        return mesh, status


def step_of(growth: float) -> float:
    """Return the growth from mesh to mesh: near `GROWTH`, with no small step at the end."""
    if math.isinf(growth):
        return GROWTH
    return math.pow(growth, 1.0 / max(1, round(math.log(growth) / math.log(GROWTH))))
