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

#: Approximate growth of the number of cells from mesh to mesh: so large that all meshes before the
#: last one cost about as much as the last, and so small that errors of cells are as `cut` expects.
#: (On the two bricks and a ball, a solution after each single cut took 0.95 to 1.3 times as long as
#: this growth, with twice as many solutions; with degree 1 half of the time goes into cuts. For the
#: same error a growth of 3 took 1.3 to 1.7 times, and a growth of 2 took 1.1 to 1.2 times, as many
#: unknowns as solutions after each cut: at singular edges errors fall less than expected.)
GROWTH = 2.0

#: Part of the wanted growth that is enough, except for the last mesh, since cuts take time as well.
ENOUGH = 0.85

#: Least factor by which `fraction` is multiplied if fewer cells are enough.
LEAST_PART = 0.3

#: A mesh that was made because its forecast was within the limits may be larger than forecast. It
#: is used if it exceeds no limit by more than this factor.
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
        """Return the mesh after a level, and the limit that prevents more growth. Collective.

        Cells with large errors are cut, and then cells whose errors are expected to be large after
        the previous cut, until the mesh has grown. If a limit prevents every cut, the mesh of the
        level is returned.

        Args:
            level: the last mesh and its solution.
            cell_errors: errors of the cells of this mesh.
            growth: factor by which the number of cells still has to grow in total. It is split into
                equal factors, of which the returned mesh takes one.
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
                # fewer cells are enough for the accuracy
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
    """Split a total growth into several equal refinements, and return the growth of one of them.

    The result is close to `GROWTH`: equal refinements avoid a small refinement at the end.
    """
    if math.isinf(growth):
        return GROWTH
    return math.pow(growth, 1.0 / max(1, round(math.log(growth) / math.log(GROWTH))))
