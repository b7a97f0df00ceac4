"""At each extreme the right answer or a clear error: never a wrong answer, a hang, or a warning."""

from __future__ import annotations

import pytest

from scenes.extremes.cases_of_algebra import CASES as OF_ALGEBRA
from scenes.extremes.cases_of_algebra import FLOATING
from scenes.extremes.cases_of_data import CASES as OF_DATA
from scenes.extremes.cases_of_shape import CASES as OF_SHAPE
from scenes.extremes.cases_of_shape import REPEATED, TOUCHING

CASES = [*OF_DATA, *OF_SHAPE, *OF_ALGEBRA]

#: What takes as many messages as all others, and what differs from another case by a factor of the
#: load only, or by what is asked for.
ON_ONE_RANK = ("millionth", "load 1e", "same facets, sticking", "same facets, default")

#: Where a rank may have no part of a body, of what touches, or of a constraint.
ON_RANKS = [
    case
    for case in CASES
    if case.group in (FLOATING, REPEATED, TOUCHING)
    and not any(part in case.name for part in ON_ONE_RANK)
]


@pytest.mark.parallel(case=ON_RANKS)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_extreme(comm, case):
    outcome = case.run(comm)
    assert outcome.status in outcome.wanted, outcome
    failed = [check for check in outcome.checks if not check.passed]
    assert not failed
