"""Shared parts of benchmarks: cases in processes of their own, stored rows, and tables."""

from harness.benchmark import Benchmark, add_ranks
from harness.process import Comm, restart_clock
from harness.record import Record, Row
from harness.table import DASH, Column, Table, krylov_iterations

__all__ = [
    "DASH",
    "Benchmark",
    "Column",
    "Comm",
    "Record",
    "Row",
    "Table",
    "add_ranks",
    "krylov_iterations",
    "restart_clock",
]
