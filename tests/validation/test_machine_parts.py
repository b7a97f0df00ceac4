"""Machine parts of `scenes/right_values.py` on coarse meshes, against statics and formulae."""

from __future__ import annotations

import pytest

from scenes.machine_parts import cord
from scenes.right_values import PARTS, line_contact_force

#: Name of a scene -> how far its value may be off. The dovetail has a test of its own.
WITHIN = {
    "belt": 5e-3,
    "beam on a former": 1e-3,
    "taper": 1e-6,
    "cube on a table": 2e-3,
    "triple junction": 2e-3,
}


@pytest.mark.parallel
@pytest.mark.parametrize(
    ("name", "case"), [(name, case) for name in WITHIN for case in list(PARTS[name])[::2]]
)
def test_statics_of_a_machine_part(comm, name, case):
    """Forces are right, and the greatest load before a body slides off or tips over."""

    def solve(problem):
        solution = problem.solve()
        solution.raise_if_failed()
        problem.accept()
        return solution

    part = PARTS[name][case]
    assert part.follow(comm, solve) == pytest.approx(part.right, rel=WITHIN[name])


@pytest.mark.parallel
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_rubber_cord_has_the_force_of_a_line_contact(comm, friction):
    """Incompressible, with a pressure; its approach is 5 % of its diameter."""
    process = cord(comm, 0.5, friction)
    with process.problem as problem:
        for part in (0.025, 0.05):
            process.move(part)
            solution = problem.solve()
            solution.raise_if_failed()
            problem.accept()
    force = 2.0 * abs(solution.pair_resultants[0].force[1])
    assert force == pytest.approx(line_contact_force(0.5), rel=0.03)
