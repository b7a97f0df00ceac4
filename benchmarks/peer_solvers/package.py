"""The package itself: its default method with both solvers for K, and the paper's algorithms."""

from __future__ import annotations

from typing import Any

import numpy as np

from peer_solvers.discrete import MANY, Answer, apply_load_steps

#: Relative natural residual of the solution that counts as the exact discrete solution.
REFERENCE = 1e-9


def solve(scene: Any, rtol: float, method: str, stiffness: str) -> Answer:
    """Solve by a method of the package, from forms to fields, each load step from the last."""
    with scene.problem(stiffness=stiffness) as problem:
        steps = []
        for step in apply_load_steps(scene):
            if step > 0:
                problem.accept(unconverged=True)  # the note says so
            steps.append(problem.solve(method=method, rtol=rtol, max_iterations=MANY))
    work = {name: sum(getattr(one, name) for one in steps) for name in ("iterations", "products")}
    krylov = sum(one.krylov_iterations for one in steps)
    work |= {"Krylov": krylov} if krylov else {"factorisations": 1}
    return Answer(
        np.squeeze([one.multipliers for one in steps]),
        work,
        ", ".join(dict.fromkeys(one.status.name for one in steps)),
        stresses=True,
    )


def exact_stresses(scene: Any) -> np.ndarray:
    """Return the stresses of a solution that is accurate enough to measure errors by."""
    return solve(scene, REFERENCE, "projected_newton", "cholesky").multipliers
