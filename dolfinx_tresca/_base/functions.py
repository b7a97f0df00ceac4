"""Functions that take no MPI communicators."""

from __future__ import annotations

from dolfinx import fem


def zero_like(
    function: fem.Function, name: str, kind: type[fem.Function] = fem.Function
) -> fem.Function:
    """Return a Function of zeros on the space of another one. Not collective.

    On several ranks a new Function takes two MPI communicators as long as it lives, and MPICH has
    2,048 of them. A copy shares those of its original.

    Args:
        function: the original.
        name: name of the result.
        kind: class of the result.
    """
    result = kind(function.function_space, function.copy().x, name=name)
    result.x.array[:] = 0.0
    return result
