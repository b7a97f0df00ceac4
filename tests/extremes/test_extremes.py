"""At each extreme the right answer or a clear error: never a wrong answer, a hang, or a warning."""

from __future__ import annotations

import pytest
from cases_of_algebra import CASES as OF_ALGEBRA
from cases_of_algebra import FLOATING
from cases_of_data import CASES as OF_DATA
from cases_of_shape import CASES as OF_SHAPE
from cases_of_shape import REPEATED, TOUCHING

CASES = [*OF_DATA, *OF_SHAPE, *OF_ALGEBRA]

#: Groups in which ranks may have nothing to say: of bodies, of nodes that touch, of constraints.
ON_RANKS = (FLOATING, REPEATED, TOUCHING)


@pytest.mark.parallel(case=[case for case in CASES if case.group in ON_RANKS])
@pytest.mark.parametrize("case", CASES, ids=str)
def test_extreme(comm, case):
    outcome = case.run(comm)
    assert outcome.status in outcome.wanted, outcome
    failed = [check for check in outcome.checks if not check.passed]
    assert not failed
