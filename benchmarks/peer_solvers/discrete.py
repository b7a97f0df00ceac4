"""The discrete problem that all peers solve, from the package's own assembly and pairing.

Multipliers are stresses times sqrt(area of the node), and the rows of B are scaled accordingly; see
`JumpOperator`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.dual.slip_bounds import SlipBounds
from dolfinx_tresca.pairing.operators import PairOperators, assemble_B
from dolfinx_tresca.pairing.pair_surfaces import pair_surfaces
from dolfinx_tresca.solvers.convergence import NaturalResidual
from dolfinx_tresca.solvers.paper import largest_eigenvalue
from dolfinx_tresca.solvers.problem import Point
from dolfinx_tresca.stiffness.system import LinearSystem
from scenes.assembled import dual_program

#: Limit for all kinds of iterations, which the limit of seconds ends before.
MANY = 1_000_000


@dataclass(frozen=True)
class Answer:
    """The answer of a peer.

    Attributes:
        multipliers: (size,) lambda, or (steps, size) after each of several load steps; or, if there
            are `points`, (k, 3) tractions of the upper body on the lower body.
        work: numbers of products, factorisations or iterations, by name.
        note: message of the peer about the end of its iteration.
        stresses: whether the multipliers are stresses, without the factor sqrt(area).
        points: (k, 3) positions of the nodes with tractions.
    """

    multipliers: np.ndarray
    work: dict[str, int] = field(default_factory=dict)
    note: str = ""
    stresses: bool = False
    points: np.ndarray | None = None


@dataclass(frozen=True)
class Primal:
    """min 1/2 u'K u - f'u + sum of g |T u - s| subject to N u <= d, for free degrees of freedom.

    Attributes:
        K: (n, n) sparse stiffness matrix.
        f: (n,) load.
        N: (m, n) sparse, T: (2 m, n) sparse: the jumps, with rows multiplied by sqrt(area).
        gap: (m,) d minus the contribution of prescribed values to N u, times sqrt(area).
        slip: (2 m,) s minus the contribution of prescribed values to T u, times sqrt(area).
        node: (2 m,) the node of each row of T.
        bound: (m,) g times sqrt(area).
        size: (m,) sqrt(area).
    """

    K: Any
    f: np.ndarray
    N: Any
    T: Any
    gap: np.ndarray
    slip: np.ndarray
    node: np.ndarray
    bound: np.ndarray
    size: np.ndarray


def scipy_matrix(A: Any) -> Any:
    """Return a PETSc matrix as a sparse matrix of scipy."""
    pointers, columns, values = A.getValuesCSR()
    return csr_array((values, columns, pointers), shape=A.getSize())


def apply_load_steps(scene: Any) -> Iterator[int]:
    """Apply the pushes of a scene in turn and yield their numbers; without any: its load, once."""
    for step, push in enumerate(getattr(scene.data, "pushes", (None,))):
        if push is not None:
            scene.data.push.value = -push
        yield step


def load_steps(scene: Any) -> list[Primal]:
    """Assemble K, N and T once, as matrices of scipy, and f, d and s for each load step.

    There s is without the slip of earlier steps.
    """
    with LinearSystem(scene.a, scene.L, scene.bcs) as system:
        system.assemble_stiffness()
        pair = pair_surfaces(scene.V, system.prescribed, scene.pair)
        jump = assemble_B(scene.V, [pair])
        B, K = scipy_matrix(jump), scipy_matrix(system.K)
        jump.destroy()
        free, prescribed = np.flatnonzero(~system.prescribed), np.flatnonzero(system.prescribed)
        m = len(pair.normal_node)
        K, N, T = K[free][:, free], B[:m][:, free], B[m:][:, free]
        size = np.sqrt(pair.weights)
        bound = SlipBounds(scene.V).nodal_bounds(scene.pair.friction, pair.nodes).constant * size
        steps = []
        for _ in apply_load_steps(scene):
            system.assemble_load()
            jump_of_values = B[:, prescribed] @ system.prescribed_values()
            steps.append(
                Primal(
                    K=K,
                    f=system.f.x.array[free].copy(),
                    N=N,
                    T=T,
                    gap=(pair.gap * size)[pair.normal_node] - jump_of_values[:m],
                    slip=-jump_of_values[m:],
                    node=pair.tangent_node,
                    bound=bound,
                    size=size,
                )
            )
        return steps


def primal_problem(scene: Any) -> Primal:
    """Assemble K, f, N and T of a scene with one load as matrices of scipy."""
    (data,) = load_steps(scene)
    return data


def residual_norm(dual: DualProgram) -> tuple[float, Callable[[np.ndarray, np.ndarray], float]]:
    """Return rho, and the relative natural residual as a function of lambda and its gradient."""
    rho = 1.0 / largest_eigenvalue(dual)
    residual = NaturalResidual(dual, rho)
    return rho, lambda x, r: residual.relative(residual.norm_at(Point(x, np.empty(0), r)))


def judge(scene: Any, answer: Answer, exact: np.ndarray) -> dict[str, float]:
    """Return the size of a problem, and relative errors of an answer. K is factored anew for this.

    Args:
        scene: the scene.
        answer: what a peer returned.
        exact: result of `package.exact_stresses`, (size,) or (steps, size).

    Returns:
        The number n of unknowns that are not prescribed, the number m of contact nodes, the natural
        residual, and the errors of the stresses in L2 of the contact surface and of the
        normal force. After several load steps: the largest of these errors, and no residual.
    """
    with dual_program(scene) as dual:
        pair, scale = dual.jump.pairs[0], dual.jump.stress_scale
        x = answer.multipliers
        if answer.points is not None:
            x = along_directions(scene, pair, answer)
        if answer.points is not None or answer.stresses:
            x = x / scale
        exact = exact / scale  # the Euclidean norm of multipliers is the L2 norm of stresses
        normal = slice(len(pair.normal_node))
        force, missing = (np.abs((y / scale)[..., normal].sum(axis=-1)) for y in (exact, x - exact))
        sizes = np.linalg.norm(x - exact, axis=-1) / np.linalg.norm(exact, axis=-1)
        found = {
            "n": int((~dual.jump.system.prescribed).sum()),
            "m": len(pair.nodes),
            "stress_error": float(np.max(sizes)),
            "normal_error": float(np.max(missing / force)),
        }
        if x.ndim == 1:
            _, residual = residual_norm(dual)
            found["residual"] = residual(x, dual.compliance.apply(x) - dual.b)
        return found


def along_directions(scene: Any, pair: PairOperators, answer: Answer) -> np.ndarray:
    """Return the normal and tangential components of an answer's tractions at our nodes."""
    distance, at = cKDTree(answer.points).query(scene.V.tabulate_dof_coordinates()[pair.nodes])
    if distance.max() > 1e-8:
        raise RuntimeError("the peer has no multipliers at some of our contact nodes")
    traction = answer.multipliers[at]
    return np.concatenate(
        [
            np.einsum("ni,ni->n", traction, pair.normals)[pair.normal_node],
            np.einsum("ni,ni->n", traction[pair.tangent_node], pair.tangents),
        ]
    )
