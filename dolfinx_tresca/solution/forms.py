"""The forms and conditions of the bodies, for derivatives and reactions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from dolfinx import fem

from dolfinx_tresca._base.compat import EntityMaps


@dataclass(frozen=True)
class Forms:
    """The forms and conditions of the bodies, as users gave them.

    Attributes:
        residual: function (z) -> residual R(u; z), a form of rank 0, for a Function z.
        tangent: dR/du, a bilinear form.
        bcs: Dirichlet conditions.
        entity_maps: entity maps, needed if the forms contain Functions on surfaces; None: there are
            no entity maps.
    """

    residual: Callable[[fem.Function], Any]
    tangent: Any
    bcs: Sequence[Any]
    entity_maps: EntityMaps | None

    def compiled(self, form: Any) -> fem.Form:
        """Return a compiled form. Collective."""
        maps = {} if self.entity_maps is None else {"entity_maps": self.entity_maps}
        return fem.form(form, **maps)
