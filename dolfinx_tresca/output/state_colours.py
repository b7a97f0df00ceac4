"""Names and colours of the states of contact nodes, as a preset of ParaView."""

from __future__ import annotations

import json

from dolfinx_tresca.solution.fields import ContactState

#: State -> its name, and its colour as red, green and blue from 0 to 1: blue for stick, orange for
#: slip, light colours for open nodes.
NAMES_AND_COLOURS: dict[ContactState, tuple[str, tuple[float, float, float]]] = {
    ContactState.OUTSIDE: ("outside", (0.60, 0.60, 0.60)),
    ContactState.OPEN: ("open", (0.85, 0.85, 0.85)),
    ContactState.OPEN_STICK: ("open, sticks", (0.65, 0.81, 0.93)),
    ContactState.OPEN_SLIP: ("open, slips", (1.00, 0.80, 0.55)),
    ContactState.PRESSED: ("pressed", (0.55, 0.25, 0.60)),
    ContactState.STICK: ("sticks", (0.10, 0.35, 0.70)),
    ContactState.SLIP: ("slips", (0.85, 0.35, 0.00)),
    ContactState.BONDED: ("bonded", (0.20, 0.55, 0.25)),
}


def paraview_preset() -> str:
    """Return the look-up table, JSON that ParaView's colour map editor imports. Not collective."""
    annotations: list[str] = []
    colours: list[float] = []
    for state, (name, colour) in NAMES_AND_COLOURS.items():
        annotations += [str(int(state)), name]
        colours += colour
    preset = {"Name": "contact state", "Annotations": annotations, "IndexedColors": colours}
    return json.dumps([preset], indent=1)
