"""Linear forms with their values on all ranks that need them."""

from __future__ import annotations

from typing import Any

import dolfinx.la
import ufl
from dolfinx import fem


def assembled(form: ufl.Form, space: Any) -> fem.Function:
    """Return the values of a linear form, with those of ghosts, as a Function. Collective.

    Args:
        form: linear.
        space: of its test function.
    """
    result = fem.Function(space)
    fem.assemble_vector(result.x.array, fem.form(form))
    result.x.scatter_reverse(dolfinx.la.InsertMode.add)
    result.x.scatter_forward()
    return result
