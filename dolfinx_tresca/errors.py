"""Exceptions. Each says what is wrong, what was found, what is wanted, and what to do."""

from typing import Any

#: Characters that a message shows of a value, at most.
_SHOWN = 100


class ContactError(Exception):
    """Base class of all errors that this package raises on purpose."""


class InputError(ContactError, ValueError):
    """An argument is wrong: its type, shape, range, or the space or mesh it belongs to."""


class MeshError(ContactError):
    """A mesh file cannot be read, or lacks what the scene needs."""


class PairingError(ContactError):
    """Two surfaces cannot be paired."""


class StiffnessError(ContactError):
    """The stiffness matrix is not symmetric, is indefinite, or a solve with it failed."""


class ConvergenceError(ContactError):
    """The iteration ended without the accuracy that was asked for."""


def shown(value: Any) -> str:
    """Return what a message shows of a value that was found: its type where `repr` is long.

    Of what lives on a function space that is the element, which `repr` has far behind.
    """
    on_space = hasattr(value, "ufl_function_space") and hasattr(value, "ufl_shape")
    if on_space and not isinstance(value, type):
        element = value.ufl_function_space().ufl_element()
        degree = f" of degree {element.degree}" if hasattr(element, "degree") else ""
        name = f" '{value.name}'" if hasattr(value, "name") else ""
        return (
            f"the {type(value).__name__}{name} of shape {value.ufl_shape} on elements of family "
            f"{element.family_name}{degree}"
        )
    text = " ".join(repr(value).split())
    if len(text) <= _SHOWN:
        return text
    return f"an object of type {type(value).__name__}: {text[:_SHOWN]}..."
