"""Pictures of results, with pyvista and matplotlib, also where there is no display."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Real
from pathlib import Path
from typing import Any

from dolfinx import fem

from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.display import virtual_display
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.fields import SurfaceFields
from dolfinx_tresca.grid import ROOT, Grid, gather_grid
from dolfinx_tresca.pictures.bodies import draw_bodies
from dolfinx_tresca.pictures.contact import Contact, gather_contact
from dolfinx_tresca.pictures.curve import Curve, chart
from dolfinx_tresca.pictures.surface import draw_surface

SUFFIXES = (".png", ".jpg", ".tif")
SIZE = (1600, 700)  #: pixels of the picture with one pair
SPLIT = 0.42  #: of the width for the bodies


def plot(
    path: str | Path,
    u: fem.Function,
    surfaces: Sequence[SurfaceFields],
    *,
    scale: float | None = None,
) -> None:
    """Save a picture: the deformed bodies, and beside them each contact surface.

    Bodies: displacement u, magnified, with its length as colour and the undeformed edges as lines.
    Surfaces of 3D, seen along their mean normal, closed ones from the front: pressure as colour,
    slip of the secondary side against the primary as arrows, nodes that stick as black discs
    (pressed) and rings (open), open parts in grey. Curves of 2D: pressure, and traction and slip
    along the curve, over its arc length. On the bodies the curve is red and begins at the dot, or
    at its number; a closed one runs counterclockwise. Without friction there are no arrows, marks,
    tractions and slips.

    Needs pyvista on the first rank, for 2D matplotlib as well, and no display.

    Collective.

    Args:
        path: `.png`, `.jpg` or `.tif`; that of the first rank counts.
        u: displacement [length].
        surfaces: the fields of each pair.
        scale: magnification of u, 0 or more; None chooses one that shows the deformation.

    Raises:
        InputError: unknown suffix, scale not a number of 0 or more, or the file cannot be written.
        ContactError: there is no pyvista or matplotlib, or VTK would need a display.
    """
    comm = u.function_space.mesh.comm
    path = Path(comm.bcast(str(path), root=ROOT))
    if path.suffix not in SUFFIXES:
        raise InputError(f"plot writes {', '.join(SUFFIXES)}, found '{path}'.")
    if scale is not None and not (isinstance(scale, Real) and 0.0 <= scale < math.inf):
        raise InputError(f"scale must be a number of 0 or more, found {scale!r}.")
    volume = gather_grid([u])
    numbers = [f" {i + 1}" if len(surfaces) > 1 else "" for i in range(len(surfaces))]
    contacts = list(map(gather_contact, surfaces, numbers))
    with errors_on_all_ranks(comm):
        if volume is not None:
            picture = _draw(volume, [contact for contact in contacts if contact is not None], scale)
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                picture.save(path)
            except OSError as error:
                raise InputError(
                    f"cannot write '{path}': {error}. Choose another folder or name."
                ) from error


def _draw(volume: Grid, contacts: list[Contact], scale: float | None) -> Any:
    """Return the picture, a `PIL.Image`. Not collective."""
    height = SIZE[1] if len(contacts) < 2 else 520 * len(contacts)
    if volume.dim == 3 or not contacts:
        return _render(volume, contacts, [], scale, (SIZE[0], height))
    import PIL.Image

    curves = [Curve.of(contact) for contact in contacts]
    left = round(SPLIT * SIZE[0])
    picture = PIL.Image.new("RGB", (SIZE[0], height), "white")
    picture.paste(_render(volume, [], curves, scale, (left, height)), (0, 0))
    part = height // len(curves)
    for i, curve in enumerate(curves):
        picture.paste(chart(curve, (SIZE[0] - left, part)), (left, i * part))
    return picture


def _render(
    volume: Grid,
    contacts: list[Contact],
    curves: list[Curve],
    scale: float | None,
    size: tuple[int, int],
) -> Any:
    """Return what pyvista draws: the bodies, and beside them the surfaces of 3D."""
    volume.to_pyvista()  # says it if there is no pyvista
    import PIL.Image
    import pyvista

    count = len(contacts)
    with virtual_display():
        plotter = pyvista.Plotter(
            off_screen=True,
            shape=f"1|{count}" if count else (1, 1),
            splitting_position=SPLIT if count else None,
            border=False,
            window_size=list(size),
        )
        try:
            plotter.set_background("white", all_renderers=True)
            draw_bodies(plotter, volume, curves, scale)
            for i, contact in enumerate(contacts):
                plotter.subplot(i + 1)
                draw_surface(plotter, contact)
            plotter.enable_anti_aliasing("msaa", multi_samples=8)
            return PIL.Image.fromarray(plotter.screenshot(return_img=True))
        finally:
            plotter.close()
