"""Tolerances: how accurately inner problems are solved, and when an iteration is given up.

Other accuracies of inner problems are multiples of the constants in this file, or have a comment at
their definition that says why they differ.
"""

from __future__ import annotations

#: Largest accepted error of an inner problem, relative to that of the outer one: of a product with
#: A relative to the step, of the last gradient to the requested error, of a model's solution to the
#: tolerance. With twice this value, the scenes of benchmarks/ablation.py take 1 % more
#: products; with half of it, 10 % more Krylov iterations.
FORCING = 0.1

#: Relative error that is requested of quantities that only decide between alternatives, or scale
#: other ones. Doubling or halving it changes numbers of products by two at most.
ROUGH = 1e-3

#: Largest accepted ratio of an error to the requested error. It is above 1: an error is computed
#: at the end of an iteration and again afterwards, and the two results differ by rounding. If the
#: distance of the number from 1 is doubled or halved, no number of products changes.
SLACK = 1.01

#: A force of K against a motion that should cost nothing counts as rounding of the assembly up to
#: this multiple of K's largest diagonal entry, for a displacement of length 1. Assembly leaves
#: 1e-15 to 1e-13; softer springs exert less than 1e-10 of the forces that strains cause.
ASSEMBLY_ROUNDING = 1e-12

#: Relative error, in the energy norm, that is requested where only rounding errors are allowed.
#: Doubling or halving it changes nothing: solvers stop at their own rounding first.
FULL_ACCURACY = 1e-13

#: An iteration makes progress if its residual is below this multiple of the least earlier one. If
#: the distance of the number from 1 is doubled or halved, products change by two at most.
PROGRESS = 0.9

#: Number of iterations without progress after which a contact problem counts as stalled, and after
#: which a search for a fixed point, or Newton's method with a model of A, ends. If it is doubled,
#: solves without a fixed point take more products, and warnings come later. Of the solves in
#: tests/validation and tests/problem that converge, none needs a value above 23.
PATIENCE = 25

#: Number of steps without much progress after which another way is tried, which costs more than a
#: step: the rest of A is computed (`solvers/iteration.py`), Newton's method with a model of A takes
#: a whole step even if the residual grows (watchdog technique, Chamberlain et al. 1982), or a
#: product with A replaces products with the near field.
SHORT_PATIENCE = 8

#: Limit on the steps of an inner iteration. Most inner iterations end after a few steps.
MOST_STEPS = 100
