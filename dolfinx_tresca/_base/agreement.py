"""Arguments of collective calls: the ranks compare them before anything else communicates."""

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
from dolfinx.mesh import MeshTags

from dolfinx_tresca._base.number import real
from dolfinx_tresca._base.parallel import on_all_ranks, raised_on_all_ranks, sendable
from dolfinx_tresca.errors import InputError

_P = ParamSpec("_P")
_T = TypeVar("_T")

#: Size of an array up to which its values are compared: points and directions are, not fields.
MOST_VALUES = 16

#: Name of an argument or of a part of it -> text that is equal on all ranks.
Texts = dict[str, str]


def collective(
    comm: Callable[[Mapping[str, Any]], MPI.Comm | None],
    *,
    but: Sequence[str] = (),
    also: Callable[[Any], Mapping[str, Any]] | None = None,
) -> Callable[[Callable[_P, _T]], Callable[_P, _T]]:
    """Return a decorator: the ranks compare the arguments of a call before its body runs.

    The body may then check values without communication: it finds the same on all ranks. What is
    each rank's own, such as the values of a Function, is not compared. The comparison is one
    reduction of five integers; there is none on one rank.

    Args:
        comm: returns the communicator, given the arguments by name; None where no argument has
            one, which the body must then refuse.
        but: names of arguments that may differ between the ranks.
        also: returns further values that must agree, given the first argument (`self`).
    """

    def decorate(function: Callable[_P, _T]) -> Callable[_P, _T]:
        signature = inspect.signature(function)

        @functools.wraps(function)
        def call(*args: _P.args, **kwargs: _P.kwargs) -> _T:
            ranks = comm(dict(zip(signature.parameters, args, strict=False)) | kwargs)
            if ranks is not None and ranks.size > 1:

                def values() -> dict[str, Any]:
                    try:
                        bound = signature.bind(*args, **kwargs)
                    except TypeError as error:
                        raise TypeError(f"{function.__qualname__}() {error}") from None
                    bound.apply_defaults()
                    present = {} if also is None else also(bound.arguments.get("self"))
                    given = bound.arguments.items()
                    return {
                        **present,
                        **{name: one for name, one in given if name not in ("self", *but)},
                    }

                agree(ranks, function.__qualname__, values)
            return function(*args, **kwargs)

        return call

    return decorate


def comm_of_self(given: Mapping[str, Any]) -> MPI.Comm:
    """Return the communicator of the object that has the method, for `collective`."""
    comm: MPI.Comm = given["self"].comm
    return comm


def comm_of(*names: str) -> Callable[[Mapping[str, Any]], MPI.Comm | None]:
    """Return a function for `collective`: the mesh's communicator, from arguments of these names.

    The first argument that has a mesh counts, so that another one may be wrong.
    """

    def find(given: Mapping[str, Any]) -> MPI.Comm | None:
        return _mesh_comm([given.get(name) for name in names])

    return find


def _mesh_comm(value: Any) -> MPI.Comm | None:
    """Return the communicator of the mesh that a value lives on; None without a mesh."""
    if isinstance(value, list | tuple):
        return next((comm for comm in map(_mesh_comm, value) if comm is not None), None)
    if isinstance(value, ufl.Form):
        return _mesh_comm([one.ufl_function_space() for one in value.arguments()])
    if isinstance(value, fem.Function | fem.DirichletBC):
        value = value.function_space
    elif isinstance(value, fem.Form):
        value = value._cpp_object
    comm = getattr(getattr(value, "mesh", None), "comm", None)
    return comm if isinstance(comm, MPI.Comm) else None


def call_on_all_ranks(comm: MPI.Comm, what: str, function: Callable[[], _T]) -> _T:
    """Return what a function of the user returns, or raise on all ranks what it raised on one.

    The function may make collective calls of this package. A rank that left it with an exception
    answers the others in the first of these calls that they come to, which raises there. No such
    answer reaches ranks that wait in a collective call of another library.

    Collective.

    Args:
        comm: the communicator of those calls.
        what: name of the function, for messages.
        function: the function.

    Raises:
        BaseException: see `errors_on_all_ranks`.
    """
    error: BaseException | None = None
    try:
        result = function()
    except (Exception, KeyboardInterrupt, SystemExit) as caught:
        if raised_on_all_ranks(caught):
            raise
        error = caught
    if comm.size > 1:
        agree(comm, f"the end of {what}", dict, error)
    if error is not None:
        raise error
    return result


def agree(
    comm: MPI.Comm,
    where: str,
    values: Callable[[], Mapping[str, Any]],
    error: BaseException | None = None,
) -> None:
    """Check that the ranks are in the same call and give it equal values. Collective.

    Args:
        comm: the ranks.
        where: the name of the call.
        values: returns name -> value of what must agree.
        error: what this rank raises, and with it all others.

    Raises:
        BaseException: the error of the lowest rank that has one.
        InputError: the ranks are in different calls, or a value differs; named with both values.
    """
    texts: Texts = {}
    if error is None:
        try:
            texts = _Description().of(values())
        except Exception as caught:
            error = caught
    digest = hashlib.blake2b(repr((where, texts)).encode(), digest_size=16).digest()
    words = np.frombuffer(digest, dtype=np.int64) >> 1  # their negatives are integers, too
    failed = 0 if error is None else comm.size - comm.rank
    largest = np.concatenate([words, -words, [failed]])
    comm.Allreduce(MPI.IN_PLACE, largest, op=MPI.MAX)
    if largest[4] > 0:
        root = comm.size - int(largest[4])
        other = comm.bcast(sendable(error) if comm.rank == root else None, root=root)
        raise on_all_ranks(error if error is not None else other)
    if (largest[:2] != -largest[2:4]).any():
        raise on_all_ranks(_difference(comm.allgather((where, texts))))


def _difference(found: Sequence[tuple[str, Texts]]) -> InputError:
    """Return an error that names the first difference between the ranks. Not collective."""
    first_place, first = found[0]
    for rank, (where, texts) in enumerate(found):
        if where != first_place:
            return InputError(
                f"the ranks are in different calls: {first_place} on rank 0, {where} on rank "
                f"{rank}. All ranks must make the same collective calls in the same order."
            )
        for name in (*first, *(name for name in texts if name not in first)):
            values = [one.get(name, "nothing") for one in (first, texts)]
            if values[0] != values[1]:
                return InputError(
                    f"{name} differs between ranks in {where}: {values[0]} on rank 0, {values[1]} "
                    f"on rank {rank}. Give the same on all ranks."
                )
    raise AssertionError("digests differ, and texts do not")


class _Description:
    """Texts of values that are equal on all ranks where the values agree.

    Function spaces and meshes have numbers, in the order in which they are met: equal numbers on
    all ranks mean that the same values share a space.
    """

    def __init__(self) -> None:
        self._spaces: list[Any] = []
        self._topologies: list[Any] = []

    def of(self, values: Mapping[str, Any]) -> Texts:
        """Return name -> text of all values and their parts."""
        return {
            name: text for first, value in values.items() for name, text in self._of(first, value)
        }

    def _of(self, name: str, value: Any) -> Iterator[tuple[str, str]]:
        parts = self._parts(value)
        if parts is None:
            yield name, self._text(value)
            return
        yield name, f"{type(value).__name__} of {len(parts)}"
        for part, inside in parts.items():
            yield from self._of(part.replace("{}", name), inside)

    def _parts(self, value: Any) -> dict[str, Any] | None:
        """Return name -> part, with {} for the name of the whole; None for what has no parts."""
        if hasattr(value, "values_to_agree"):
            return {f"{{}}.{name}": one for name, one in value.values_to_agree().items()}
        ours = type(value).__module__.startswith("dolfinx_tresca.")
        if ours and dataclasses.is_dataclass(value):
            names = [field.name for field in dataclasses.fields(value) if field.init]
            return {f"{{}}.{name}": getattr(value, name) for name in names}
        if isinstance(value, Mapping):
            return {f"{{}}[{key!r}]": one for key, one in value.items()}
        if isinstance(value, list | tuple) and not all(real(one) is not None for one in value):
            return {f"{{}}[{i}]": one for i, one in enumerate(value)}
        return None

    def _text(self, value: Any) -> str:
        number = real(value)
        if isinstance(value, bool | np.bool_ | str | bytes) or value is None:
            return repr(value)
        if number is not None:
            return f"{number:g}" if float(f"{number:g}") == number else repr(number)
        if isinstance(value, fem.Constant):
            return f"Constant {value.value.tolist()}"
        if isinstance(value, fem.Function):
            return f"Function on {self._space(value.function_space)}"
        if isinstance(value, fem.FunctionSpace):
            return self._space(value)
        if isinstance(value, fem.DirichletBC):
            fixed = getattr(value.g, "value", None)
            return f"DirichletBC{'' if fixed is None else f' to {np.asarray(fixed).tolist()}'}"
        if isinstance(value, MeshTags):
            return f"MeshTags of dimension {value.dim}"
        if isinstance(value, ufl.Form):
            return self._form(value)
        if isinstance(value, np.ndarray | list | tuple):
            array = np.asarray(value)
            numeric = array.dtype.kind in "iuf"
            small = array.size <= MOST_VALUES
            return (
                f"{(array.astype(float) if numeric else array).tolist()}" if small else "an array"
            )
        if callable(value) and not isinstance(value, type | ufl.core.expr.Expr):
            return "a function"
        if hasattr(value, "topology") and hasattr(value, "geometry"):
            return f"mesh {self._mesh(value)}"
        return f"an object of type {type(value).__name__}"

    def _form(self, form: ufl.Form) -> str:
        """Return the spaces of a form, the values of its constants and its signature."""
        spaces = [self._space(one.ufl_function_space()) for one in form.arguments()]
        constants = [np.asarray(getattr(one, "value", None)).tolist() for one in form.constants()]
        try:
            signature = form.signature()[:8]
        except Exception:  # a form that cannot be compiled; where it is, DOLFINx says why
            signature = "none"
        with_constants = f", constants {constants}" if constants else ""
        return f"a form on {' and '.join(spaces)}{with_constants}, signature {signature}"

    def _space(self, V: Any) -> str:
        if V not in self._spaces:
            self._spaces.append(V)
        mesh = self._mesh(V.mesh) if hasattr(V, "mesh") else "none"
        return f"space {self._spaces.index(V)} ({V.ufl_element()}) on mesh {mesh}"

    def _mesh(self, mesh: Any) -> int:
        for number, topology in enumerate(self._topologies):
            if topology is mesh.topology:
                return number
        self._topologies.append(mesh.topology)
        return len(self._topologies) - 1
