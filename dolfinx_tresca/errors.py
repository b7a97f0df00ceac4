"""Exceptions. Each message says what is wrong, what was found, what is expected and what to do."""

from typing import Any

#: Greatest number of characters of a value in an error message.
_MAX_CHARACTERS = 100


class ContactError(Exception):
    """Base class of all errors that this package raises on purpose."""


class InputError(ContactError, ValueError):
    """An argument has a wrong type, shape or range, or belongs to another space or mesh."""


class _WithMotion(ContactError):
    """Base class of errors about a motion of bodies, which they keep as an attribute."""

    def __init__(self, message: str, motion: Any) -> None:
        super().__init__(message)
        self.motion = motion


class MechanismError(_WithMotion, InputError):
    """Contact forces cannot balance the loads on bodies, or do not resist a motion of the bodies.

    The bodies move as a mechanism.

    Attributes:
        motion: the motion of the bodies, a Function of the displacement's space named "motion"
            with the greatest nodal length 1, or zero if only tools move; one of several free ones.
    """


class MeshError(ContactError):
    """A mesh file cannot be read, or lacks entities or tags that the problem needs."""


class PairingError(ContactError):
    """Two surfaces cannot be paired."""


class StiffnessError(ContactError):
    """The stiffness matrix is not symmetric, is indefinite, or a solve with it failed.

    Attributes:
        evidence: evidence that K is indefinite, as text for messages; empty for other causes.
    """

    evidence = ""


class ConvergenceError(ContactError):
    """The iteration ended before the requested accuracy was reached."""


class OutsideTheoryError(_WithMotion, ConvergenceError):
    """The equations are solved, but bodies turn or slide too far for linear theory.

    Attributes:
        motion: the displacement of the bodies in the solution [length].
    """


def shown(value: Any) -> str:
    """Return the text for a value in an error message: its `repr`, cut off if it is long.

    Functions and other objects on a function space are described by their element.
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
    if len(text) <= _MAX_CHARACTERS:
        return text
    return f"an object of type {type(value).__name__}: {text[:_MAX_CHARACTERS]}..."


def shown_place(point: Any) -> str:
    """Return the text for a point in an error message: its coordinates with six digits."""
    return str(tuple(float(f"{coordinate:.6g}") for coordinate in point))
