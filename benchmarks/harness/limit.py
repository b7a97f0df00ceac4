"""An observer that stops a solve in time."""

from __future__ import annotations

import time

from dolfinx_tresca import Iteration


class TimeLimit:
    """Stops a solve after some seconds of the processor, between two of its iterations."""

    def __init__(self, seconds: float) -> None:
        self._end = time.process_time() + seconds

    def __call__(self, iteration: Iteration) -> bool:
        """Say whether time is up."""
        return time.process_time() > self._end
