"""The package itself: its default method with both solvers for K, and the paper's algorithms."""

from __future__ import annotations

from typing import Any

from dolfinx_tresca import ContactProblem
from peer_solvers.discrete import MANY, Answer


def solve(scene: Any, rtol: float, method: str, stiffness: str) -> Answer:
    """Solve by a method of the package, from forms to fields."""
    with ContactProblem(
        scene.a, scene.L, [scene.pair], bcs=scene.bcs, stiffness=stiffness
    ) as problem:
        solution = problem.solve(method=method, rtol=rtol, max_iterations=MANY)
    work = {"iterations": solution.iterations, "products": solution.products}
    if solution.krylov_iterations:
        work["Krylov"] = solution.krylov_iterations
    else:
        work["factorisations"] = 1
    return Answer(solution.multipliers, work, solution.status.name, stresses=True)
