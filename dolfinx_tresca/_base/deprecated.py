"""Old names of public functions, which still work for one minor version."""

from __future__ import annotations

import functools
import logging
import warnings
from collections.abc import Callable
from typing import ParamSpec, TypeVar

_P = ParamSpec("_P")
_T = TypeVar("_T")

_logger = logging.getLogger("dolfinx_tresca")


def deprecated(replacement: str) -> Callable[[Callable[_P, _T]], Callable[_P, _T]]:
    """Decorate a function that users should not call any more: each call warns. Not collective.

    Each call issues a `DeprecationWarning` and also logs a warning, since DOLFINx 0.9 redirects
    Python's warnings to a logger that prints nothing.

    Args:
        replacement: name of the function to be called instead.
    """

    def decorate(function: Callable[_P, _T]) -> Callable[_P, _T]:
        text = f"{function.__qualname__} is deprecated: use {replacement}"

        @functools.wraps(function)
        def call(*args: _P.args, **kwargs: _P.kwargs) -> _T:
            warnings.warn(text, DeprecationWarning, stacklevel=2)
            _logger.warning(text)
            return function(*args, **kwargs)

        return call

    return decorate
