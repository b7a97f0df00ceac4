"""Limits for the cost of a solve on a sequence of meshes."""

from __future__ import annotations

import math
import resource
import sys
import time
from dataclasses import dataclass, field

from mpi4py import MPI

from dolfinx_tresca._base.number import real
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.adapt.levels import Level
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.status import AdaptiveStatus


def _memory() -> float:
    """Return the peak memory of this process [GiB]. Not collective."""
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2.0**30


@dataclass(frozen=True)
class Limits:
    """Limits of all meshes together.

    Attributes:
        max_dofs: limit for the degrees of freedom that are not prescribed.
        max_levels: limit for the number of meshes.
        max_seconds: wall-clock limit [s], counted from the construction of this object.
        max_memory: limit for the memory of all ranks together [GiB].
    """

    max_dofs: float = math.inf
    max_levels: float = math.inf
    max_seconds: float = math.inf
    max_memory: float = math.inf
    _begin: float = field(default_factory=time.perf_counter)
    _memory: float = field(default_factory=_memory)

    def __post_init__(self) -> None:
        """Check every limit.

        Raises:
            InputError: a limit is of the wrong type or not positive.
        """
        for name in ("max_dofs", "max_levels", "max_seconds", "max_memory"):
            value: float = getattr(self, name)
            number = real(value)
            if number is None or not number > 0.0:
                raise InputError(f"{name} must be a positive number, found {shown(value)}.")
            if name == "max_levels" and not (number.is_integer() or math.isinf(number)):
                raise InputError(f"{name} must be a positive integer, found {shown(value)}.")
            object.__setattr__(self, name, number)

    def after(self, comm: MPI.Comm, level: Level, growth: float) -> AdaptiveStatus | None:
        """Return the first limit that the mesh after a level would exceed; None if it fits.

        Collective.

        Args:
            comm: communicator of the ranks.
            level: the level before the mesh.
            growth: `free_dofs` of the mesh, divided by `free_dofs` of the level.
        """
        seconds = growth * level.seconds
        return self.exceeded(comm, level.number + 1, growth * level.free_dofs, seconds, growth)

    def exceeded(
        self, comm: MPI.Comm, number: int, free_dofs: float, seconds: float, growth: float
    ) -> AdaptiveStatus | None:
        """Return the first limit that a solve on a mesh would exceed; None if it fits. Collective.

        Args:
            comm: communicator of the ranks.
            number: number of the mesh; the first is 0.
            free_dofs: number of unknowns of the mesh.
            seconds: expected time of the solve [s].
            growth: `free_dofs` divided by the number of unknowns of the last mesh; memory is
                assumed to grow by the same factor.
        """
        if number >= self.max_levels:
            return AdaptiveStatus.MAX_LEVELS
        if free_dofs > self.max_dofs:
            return AdaptiveStatus.MAX_DOFS
        passed = comm.allreduce(time.perf_counter() - self._begin, op=MPI.MAX)
        if passed + seconds > self.max_seconds:
            return AdaptiveStatus.MAX_SECONDS
        before, most = reduce_array(comm, [self._memory, _memory()])
        if before + growth * (most - before) > self.max_memory:
            return AdaptiveStatus.MAX_MEMORY
        return None
