"""Assembly of linear forms, ghosts included."""

from __future__ import annotations

from typing import Any

import dolfinx.la
import ufl
from dolfinx import fem


def assembled(form: ufl.Form, space: Any) -> fem.Function:
    """Assemble a linear form into a Function whose ghost values are up to date. Collective.

    Args:
        form: the linear form.
        space: the space of the form's test function.
    """
    result = fem.Function(space)
    fem.assemble_vector(result.x.array, fem.form(form))
    result.x.scatter_reverse(dolfinx.la.InsertMode.add)
    result.x.scatter_forward()
    return result
