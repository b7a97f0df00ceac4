"""The rows of `print(solution)`: errors, nodes, pressures, forces and energies."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.lines import UNBROKEN
from dolfinx_tresca.output.table import Row, abridged
from dolfinx_tresca.solution.evaluation import Evaluation
from dolfinx_tresca.solution.resultants import Resultant
from dolfinx_tresca.units import Quantity, Units, with_unit


def significant(value: float, error: float) -> str:
    """Return the text of a number, with as many digits as its relative error justifies: 1 to 8."""
    return f"{value:.{_digits(error)}g}"


def vector(values: Array, error: float) -> str:
    """Return the text of a vector, with digits for an error relative to its largest component."""
    digits = _digits(error)
    size = float(np.abs(values).max())
    places = digits - 1 - int(np.floor(np.log10(size))) if size > 0.0 else 0
    # + 0.0: components that are rounded to zero have no sign
    return (
        "("
        + f",{UNBROKEN}".join(f"{round(float(one), places) + 0.0:.{digits}g}" for one in values)
        + ")"
    )


def _digits(error: float) -> int:
    return int(np.clip(np.ceil(-np.log10(max(error, 1e-9))), 1, 8))


def _may_be_zero(found: Evaluation) -> bool:
    """Return whether no node is pressed or bonded and the error is as large as the solution."""
    return found.counts.contact + found.counts.bonded == 0 and found.energy_error_bound >= 1.0


def error_rows(found: Evaluation) -> list[Row]:
    """Return the errors of the iteration and of the mesh."""
    kind = "at most" if found.bound_is_rigorous else "about"
    bound = f"{kind} {found.energy_error_bound:.1e} of the solution's norm"
    if found.energy_error_bound == 0.0:
        bound = "zero to rounding"
    elif _may_be_zero(found):
        return [("energy error", "as large as the solution, which may be zero")]
    elif np.isinf(found.energy_error_bound):
        bound = "not bounded, since constraints are dependent: more than nodes have free directions"
    rows = [("energy error", bound)]
    if found.bound_error > 0.0:
        rows.append(("slip bounds", f"changing by about {found.bound_error:.1e} of the largest"))
    if found.discretisation_error is not None:
        rows.append(("mesh error", f"about {found.discretisation_error:.1e} of it"))
    return rows


def contact_rows(found: Evaluation, units: Units | None) -> list[Row]:
    """Return the rows of the contact, with the digits that the error of nodal values justifies."""
    counts, dim = found.counts, found.u.function_space.mesh.geometry.dim
    dim = 3 if found.axisymmetric else dim  # forces on whole rings
    scale = 0.0 if _may_be_zero(found) else 1.0  # relative errors leave rounding all its digits
    has_friction = any(surface.traction is not None for surface in found.surfaces)
    open_nodes = counts.nodes - counts.contact - counts.bonded
    open_stick = counts.stick - counts.contact_stick

    def nodes(number: int, stick: int, idle: int = 0) -> str:
        shows_states = has_friction and number > idle
        return f"{number}" + (
            f": {stick} stick, {number - stick - idle} slip" if shows_states else ""
        )

    def number(value: float, quantity: Quantity, error: float = found.local_error) -> str:
        return with_unit(significant(value, error), units, quantity, dim)

    def force(one: Resultant) -> str:
        return with_unit(vector(scale * one.force, found.local_error), units, "force", dim)

    forces = [force(one) for one in found.pair_resultants]
    normal = f"{number(scale * found.normal_force, 'force')} normal"
    if len(forces) == 1:
        force_rows = [("force", f"{normal}, {forces[0]} on the secondary side")]
    else:
        force_rows = [("force", f"{normal}; on the secondary side of each pair:")]
        of_pairs = [
            ("", f"{surface.name}: {text.replace(' ', UNBROKEN)}")
            for surface, text in zip(found.surfaces, forces, strict=True)
        ]
        force_rows.extend(abridged(of_pairs, "pairs"))
    if len(found.between_bodies) > 1:
        names, between = found.body_names, []
        for (i, j), one in found.between_bodies.items():
            between.append(("", f"{names[i]} by {names[j]}: {force(one).replace(' ', UNBROKEN)}"))
        force_rows.append(("on bodies", f"{len(between)} pairs of bodies push each other:"))
        force_rows.extend(abridged(between, "pairs of bodies"))
    history = any(surface.slip_increment is not surface.slip for surface in found.surfaces)
    slip = number(found.greatest_slip, "length")
    if history:
        slip += f" in this step, {number(found.greatest_total_slip, 'length')} along its path"
    work = [number(one, "energy") for one in (found.dissipation, found.total_dissipation)]
    primal, dual = found.primal_energy, found.dual_energy
    # both energies get enough digits to be distinguished
    apart = 0.1 * abs(primal - dual) / (max(abs(primal), abs(dual)) or 1.0)
    rows = [
        ("contact nodes", f"{counts.nodes}"),
        ("  pressed", nodes(counts.contact, counts.contact_stick)),
        ("  open", nodes(open_nodes, open_stick, counts.idle)),
        *([("  bonded", f"{counts.bonded}")] if counts.bonded else []),
        *(
            [
                (
                    "  undecided",
                    f"{counts.undecided} of these: at the limit of their state, within the error",
                )
            ]
            if counts.undecided
            else []
        ),
        ("peak pressure", number(scale * found.peak_pressure, "stress")),
        *([("greatest slip", slip)] if has_friction else []),
        *([("dissipation", f"{work[0]} in this step, {work[1]} so far")] if history else []),
        *force_rows,
        (
            "energy",
            f"{number(primal, 'energy', apart)} primal, {number(dual, 'energy', apart)} dual",
        ),
    ]
    return rows
