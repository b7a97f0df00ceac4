"""Patience: after how many steps, and with how little progress, an iteration is given up."""

from __future__ import annotations

#: An iteration makes progress if its residual is below this multiple of the least earlier residual.
#: If the distance of the number from 1 is doubled or halved, numbers of products of
#: benchmarks/ablation.py change by two at most.
PROGRESS = 0.9

#: Number of iterations without progress after which a contact problem ends, as do a search for a
#: fixed point and Newton's method with a model of A. If it is doubled, solves without a fixed point
#: take more products. Of the solves in tests/validation and tests/problem that converge, none needs
#: a value above 23.
PATIENCE = 25

#: Limit on the steps of an inner iteration. Most inner iterations end after a few steps. In
#: benchmarks/ablation.py, neither twice this limit nor a limit of 25 changes anything.
MOST_STEPS = 100
