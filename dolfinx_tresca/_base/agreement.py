"""Comparison of the arguments of collective functions between the ranks, before a function runs."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, ParamSpec, TypeVar

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import real
from dolfinx_tresca._base.parallel import errors_on_all_ranks, mark_raised_on_all_ranks
from dolfinx_tresca.errors import InputError

_P = ParamSpec("_P")
_T = TypeVar("_T")

#: Communicators for the comparisons, one for each group of processes. The last one used is the last
#: entry: it serves calls whose arguments are wrong and have no communicator.
_comms: list[MPI.Comm] = []


def collective(
    find_comm: Callable[[Mapping[str, Any]], MPI.Comm | None],
    *,
    ignored: Sequence[str] = (),
    extra_values: Callable[[Any], Mapping[str, Any]] | None = None,
) -> Callable[[Callable[_P, _T]], Callable[_P, _T]]:
    """Decorate a collective function so that the ranks compare its arguments before its body runs.

    If they differ, all ranks raise the same InputError instead of waiting for each other. Data
    that differ by design, such as the values of a Function, are not compared. Each rank sends a
    digest of 16 bytes. If the arguments of a rank are wrong and have no communicator, the rank
    compares them with the processes of its last collective call.

    Args:
        find_comm: function from a mapping name -> argument to the communicator, such as `comm_of`
            returns, or to None if no argument has one; the body must then raise an error.
        ignored: names of arguments that may differ between the ranks.
        extra_values: function from `self` to a mapping name -> further value that is compared.
    """

    def decorate(function: Callable[_P, _T]) -> Callable[_P, _T]:
        signature = inspect.signature(function)

        @functools.wraps(function)
        def call(*args: _P.args, **kwargs: _P.kwargs) -> _T:
            comm = find_comm(dict(zip(signature.parameters, args, strict=False)) | kwargs)
            if comm is None and _comms:
                comm = _comms[-1]

            def values() -> dict[str, Any]:
                """Return name -> value; raise a TypeError for missing and for unknown arguments."""
                bound = signature.bind(*args, **kwargs)
                bound.apply_defaults()
                given = bound.arguments
                extra = {} if extra_values is None else extra_values(given.get("self"))
                compared = [name for name in given if name not in ("self", *ignored)]
                return {**extra, **{name: given[name] for name in compared}}

            if comm is not None and comm.size > 1:
                check_agreement(comm, function.__qualname__, values)
            return function(*args, **kwargs)

        return call

    return decorate


def comm_of(*names: str) -> Callable[[Mapping[str, Any]], MPI.Comm | None]:
    """Return a function that finds the communicator among the named arguments, for `collective`."""
    return lambda given: _mesh_comm([given.get(name) for name in names])


#: Function, for `collective`, that finds the communicator of the object whose method is decorated.
comm_of_self = comm_of("self")


def _mesh_comm(value: Any) -> MPI.Comm | None:
    """Return the communicator that a value is or has, or its mesh has; None without one.

    Lists have that of their first element with a communicator, and forms that of their arguments.
    """
    if isinstance(value, list | tuple):
        return next((comm for comm in map(_mesh_comm, value) if comm is not None), None)
    if isinstance(value, ufl.Form):
        return _mesh_comm([argument.ufl_function_space() for argument in value.arguments()])
    if isinstance(value, fem.Function | fem.DirichletBC):
        value = value.function_space
    elif isinstance(value, fem.Form):
        value = value._cpp_object
    of_mesh = getattr(getattr(value, "mesh", None), "comm", None)
    for comm in (value, getattr(value, "comm", None), of_mesh):
        if isinstance(comm, MPI.Comm) and comm != MPI.COMM_NULL:
            return comm
    return None


def call_on_all_ranks(comm: MPI.Comm, name: str, function: Callable[[], _T]) -> _T:
    """Call a function of the user; an exception on one rank is raised on all ranks. Collective.

    The function may make collective calls of this package. After an exception on one rank, the
    others receive it in their next collective call of this package, but not in other libraries.
    """
    results: list[_T] = []

    def no_values() -> dict[str, Any]:  # calls the function where exceptions reach all ranks
        results.append(function())
        return {}

    check_agreement(comm, f"the end of {name}", no_values)
    return results[0]


def check_agreement(comm: MPI.Comm, where: str, values: Callable[[], Mapping[str, Any]]) -> None:
    """Raise an InputError on all ranks unless all make the same call with equal values. Collective.

    Args:
        comm: the communicator.
        where: the name of the call, for the comparison and for messages.
        values: function that returns name -> value; its exception on one rank is raised on all.
    """
    # the duplicate for the same processes, if there is one, serves again and becomes the last entry
    same = (MPI.IDENT, MPI.CONGRUENT)
    numbers = [k for k, own in enumerate(_comms) if MPI.Comm.Compare(own, comm) in same]
    _comms.append(_comms.pop(numbers[0]) if numbers else comm.Dup())
    comm = _comms[-1]
    with errors_on_all_ranks(comm):
        texts: dict[str, str] = {}
        for name, value in values().items():
            texts.update(_described(name, value))
    digest = hashlib.blake2b(repr((where, texts)).encode(), digest_size=16).digest()
    if len(set(comm.allgather(digest))) > 1:
        raise mark_raised_on_all_ranks(_difference(comm.allgather((where, texts))))


def _difference(rank_texts: Sequence[tuple[str, Mapping[str, str]]]) -> InputError:
    """Return the error for the first rank that differs from rank 0, with the difference in words.

    `rank_texts` has for each rank the name of its call, and name -> text of the values.
    """
    expected_place, expected = rank_texts[0]
    rank, (where, texts) = next(
        item for item in enumerate(rank_texts) if item[1] != (expected_place, expected)
    )
    if where != expected_place:
        return InputError(
            f"the ranks are in different calls: {expected_place} on rank 0, {where} on rank "
            f"{rank}. All ranks must make the same collective calls in the same order."
        )
    name = next(name for name in {**expected, **texts} if expected.get(name) != texts.get(name))
    values = [texts_of_rank.get(name, "nothing") for texts_of_rank in (expected, texts)]
    return InputError(
        f"{name} differs between ranks in {where}: {values[0]} on rank 0, {values[1]} on rank "
        f"{rank}. Give the same on all ranks."
    )


def _described(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Yield name and text of a value, and of its parts, but not of distributed data.

    A list of numbers is a single value. Objects with `values_to_agree` say what is compared.
    """
    if hasattr(value, "values_to_agree"):
        items = {f"{name}.{key}": item for key, item in value.values_to_agree().items()}
    elif dataclasses.is_dataclass(value) and type(value).__module__.startswith("dolfinx_tresca."):
        names = [field.name for field in dataclasses.fields(value) if field.init]
        items = {f"{name}.{key}": getattr(value, key) for key in names}
    elif isinstance(value, Mapping):
        items = {f"{name}[{key!r}]": item for key, item in value.items()}
    elif isinstance(value, list | tuple) and not all(real(item) is not None for item in value):
        items = {f"{name}[{index}]": item for index, item in enumerate(value)}
    else:
        yield name, _text(value)
        return
    yield name, f"{type(value).__name__} of {len(items)}"
    for key, item in items.items():
        yield from _described(key, item)


def _text(value: Any) -> str:
    """Return the text by which ranks compare a value; values of Functions are not part of it."""
    number = real(value)
    if isinstance(value, bool | np.bool_ | str | bytes) or value is None:
        return repr(value)
    if number is not None:
        return f"{number:g}" if float(f"{number:g}") == number else repr(number)
    if isinstance(value, fem.Constant):
        return f"Constant {value.value.tolist()}"
    if isinstance(value, fem.Function):
        return f"Function on {value.function_space.ufl_element()}"
    if isinstance(value, fem.DirichletBC):
        fixed = getattr(value.g, "value", None)
        return f"DirichletBC{'' if fixed is None else f' to {np.asarray(fixed).tolist()}'}"
    if isinstance(value, ufl.Form):
        constants = [np.asarray(getattr(c, "value", None)).tolist() for c in value.constants()]
        try:
            signature = value.signature()[:8]
        except Exception:  # DOLFINx reports an invalid form when it compiles the form
            signature = "none"
        return f"a form with the signature {signature} and constants {constants}"
    if isinstance(value, np.ndarray | list | tuple):
        # points and directions are compared; larger arrays, such as fields, are not
        return str(np.asarray(value).tolist()) if np.size(value) <= 16 else "an array"
    return f"an object of type {type(value).__name__}"
