"""Checks of coefficients of friction that depend on the pressure or on the slip."""

from __future__ import annotations

from collections.abc import Sequence

from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.dual.slip_bounds import SlipBounds
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.solution.scene_checks import hint_at_weakening
from dolfinx_tresca.solvers.friction_cones import CurveAtNodes, FrictionCones
from dolfinx_tresca.solvers.problem import DualSolution


def depends_on_pressure(pair: ContactPair) -> bool:
    """Return whether the slip bound of a pair depends on the pressure."""
    coefficient = pair.friction.terms.coefficient
    return not (isinstance(coefficient, int | float) and coefficient == 0.0)


def check_curves(
    dual: DualProgram, solution: DualSolution, slip_bounds: SlipBounds
) -> list[CurveAtNodes]:
    """Check the friction curves F(pressure, slip) at the pressures and slips of a solution.

    A hint is logged if F decreases so fast with the slip that there may be several solutions.
    Collective.

    Args:
        dual: the dual problem.
        solution: solution of the dual problem.
        slip_bounds: object that evaluates the laws of friction at nodes.

    Returns:
        each curve with the pressures (n,) [stress] and slips (n,) [length] of its nodes.

    Raises:
        InputError: F is negative, NaN or infinite at a node under pressure.
    """
    x = solution.multipliers
    cones = dual.admissible.at_point(x, solution.gradient)
    if not isinstance(cones, FrictionCones) or cones.curves is None:
        return []
    arguments = cones.curve_arguments(x)
    for curve in arguments:
        slip_bounds.check_curve(*curve)
    hint_at_weakening(dual.jump.comm, cones, x, dual.known_products().largest_ritz_value)
    return arguments


def check_curves_of_floating_bodies(pairs: Sequence[ContactPair]) -> None:
    """Check for floating bodies that no coefficient of friction depends on the slip.

    Such problems are refused since the solver may not converge: for a block held by viscous
    friction alone, the solver found no multipliers within minutes. Not collective.

    Raises:
        InputError: a coefficient depends on the slip.
    """
    for pair in pairs:
        curve = pair.friction.terms.curve
        if curve is not None and curve.depends_on_slip:
            raise InputError(
                f"contact pair {pair}: the coefficient of friction depends on the slip, and "
                "contact or soft springs hold a body, whose slip is not known in the "
                "iteration. Hold it by Dirichlet conditions, such as a prescribed motion."
            )
