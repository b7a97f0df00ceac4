"""An observer that stops a solve after a time."""

from __future__ import annotations

import time

from dolfinx_tresca import Iteration


class TimeLimit:
    """Stops a solve at the end of an iteration, after some processor seconds."""

    def __init__(self, seconds: float) -> None:
        self._end = time.process_time() + seconds

    def __call__(self, iteration: Iteration) -> bool:
        """Return whether time is up."""
        return time.process_time() > self._end
