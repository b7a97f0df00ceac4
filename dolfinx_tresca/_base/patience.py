"""Patience: after how many steps, and with how little progress, an iteration is given up."""

from __future__ import annotations

#: Ratio of a residual to the least earlier residual, below which an iteration makes progress. With
#: twice or half the distance from 1 no number of products of benchmarks/ablation.py changes.
PROGRESS = 0.9

#: Number of consecutive steps without progress after which an inner iteration, which needs no
#: products, ends. If it is doubled, failing inner iterations take twice as long, and no number of
#: products changes. With 2 a strip of 150 nodes that is pulled to and fro ends with STAGNATED.
IDLE_STEPS = 8

#: Number of iterations without progress after which a contact problem counts as stalled, and after
#: which a search for a fixed point ends. If it is doubled, solves without a fixed point take more
#: products, and warnings come later. Of the solves in tests/validation and tests/nonlinear that
#: converge none needs more than 23.
PATIENCE = 25

#: Limit on the steps of inner iterations, most of which end after a few.
#: In benchmarks/ablation.py neither twice this limit nor a limit of 25 changes anything.
MOST_STEPS = 100
