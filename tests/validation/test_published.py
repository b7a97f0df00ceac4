"""Published figures of other programs and of theory: cases of `docs/validation.md`."""

from __future__ import annotations

import importlib
from pathlib import Path

from mpi4py import MPI

import pytest

#: Scripts of the cases in `docs/validation.md`.
CASES = Path(__file__).parents[2] / "benchmarks" / "published_cases"


@pytest.mark.parametrize(
    ("name", "size", "close"),
    [
        ("moose_cylinder", 0.012, 0.006),
        ("kratos_cylinder", 0.1, 0.02),
        ("bulk_tension", 48, 0.03),
        ("triangle", 2, 1e-6),
        ("getfem_disc", 1.0, 0.01),
        ("beam_gap", 16, 0.02),
        ("pushed_block", 32, 0.04),
        ("plate", 32, 0.001),
        ("tilted_punch", 0.032, 0.03),
        pytest.param("twisting", 24, 0.05, marks=pytest.mark.long),
    ],
)
def test_values_of_others(monkeypatch, name, size, close):
    """Cases of `docs/validation.md` on coarse meshes, whose error is most of what is allowed."""
    monkeypatch.syspath_prepend(str(CASES))
    case = importlib.import_module(name).CASE
    found = case.solve(MPI.COMM_SELF, size).values
    for quantity, known in case.published.items():
        assert (1 - close) * known.low <= found[quantity] <= (1 + close) * known.high, quantity
