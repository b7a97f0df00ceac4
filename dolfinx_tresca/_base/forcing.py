"""Forcing terms: how accurately inner problems are solved (Eisenstat and Walker 1996).

Every other accuracy of an inner problem is a multiple of these, or has a comment at its definition
that says why it differs.
"""

from __future__ import annotations

#: Error of an inner problem, relative to the error, or the change, of the outer problem: of a
#: product relative to the step, of the last gradient relative to the requested error, of a model's
#: solution relative to the tolerance. With twice this value the scenes of benchmarks/ablation.py
#: take 3 % more products and 9 % fewer Krylov iterations; with half of it 4 % fewer products and
#: 1 % more Krylov iterations.
FORCING = 0.1

#: Relative error of quantities that only decide between two ways, or only scale other quantities.
#: Doubled or halved it changes the products of the ablation by one at most.
ROUGH = 1e-3

#: Largest accepted ratio of an error to the requested one: both are evaluated with different
#: rounding. With twice or half the distance from 1 no number of products changes.
SLACK = 1.01

#: Relative error, in the energy norm, that is requested where only rounding is allowed.
#: Doubled or halved it changes nothing: solvers stop at their own rounding first.
FULL_ACCURACY = 1e-13
