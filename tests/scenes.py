"""Variations of the two bricks for the tests; lengths in m, stresses in MPa."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from mpi4py import MPI

import numpy as np
from demo_two_bricks import ENDS as ENDS
from demo_two_bricks import SLIP_BOUND, YOUNG, Scene, two_bricks

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactProblem, ContactSolution, TaggedMesh, Tresca
from dolfinx_tresca.dual.compliance import ContactCompliance
from dolfinx_tresca.dual.initial_guess import InitialGuess
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.dual.slip_bounds import SlipBounds
from dolfinx_tresca.pairing.choice import pair_surfaces
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.stiffness.cholesky import cholesky
from dolfinx_tresca.stiffness.multigrid import multigrid
from dolfinx_tresca.stiffness.system import LinearSystem

EPS = float(np.finfo(float).eps)


def bricks_problem(
    comm: MPI.Comm, N: int = 4, *, options: dict[str, Any] | None = None, **scene: Any
) -> ContactProblem:
    """Return the problem of the two bricks; `options` go to ContactProblem."""
    s = two_bricks(comm, N, **scene)
    return ContactProblem(s.a, s.L, [s.pair], bcs=s.bcs, **(options or {}))


def strain(u: Any) -> Any:
    return ufl.sym(ufl.grad(u))


def elastic_form(V: Any, young: Any = YOUNG, poisson: float = 0.3) -> Any:
    """One isotropic material everywhere."""
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    mu = young / (2 * (1 + poisson))
    lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    return (2 * mu * ufl.inner(strain(u), strain(v)) + lame * ufl.div(u) * ufl.div(v)) * ufl.dx


def clamp(scene: Scene, name: str, value: Any = None, component: int | None = None) -> Any:
    """Return the condition u = value (default zero), or one component of it, on a named face."""
    facets = scene.bricks.facet_tags.find(scene.bricks.tags[name])
    if component is None:
        value = np.zeros(3) if value is None else np.asarray(value, dtype=float)
        return fem.dirichletbc(value, fem.locate_dofs_topological(scene.V, 2, facets), scene.V)
    sub = scene.V.sub(component)
    return fem.dirichletbc(
        dolfinx.default_scalar_type(0.0 if value is None else value),
        fem.locate_dofs_topological(sub, 2, facets),
        sub,
    )


def with_bcs(scene: Scene, bcs: list[Any]) -> Scene:
    return dataclasses.replace(scene, bcs=bcs)


def floating(comm: MPI.Comm, body: str, N: int = 3) -> Scene:
    """The scene with one brick that nothing holds."""
    scene = two_bricks(comm, N)
    held = "lower_fixed" if body == "upper" else "upper_fixed"
    return with_bcs(scene, [clamp(scene, held)])


def moved(
    comm: MPI.Comm,
    map_points: Callable[[np.ndarray], np.ndarray],
    N: int = 4,
    *,
    turn: np.ndarray | None = None,
    **scene: Any,
) -> Scene:
    """The scene on the mesh with its points (n, 3) mapped, and loads turned by a rotation."""
    s = two_bricks(comm, N, **scene)
    x = s.bricks.mesh.geometry.x
    x[:] = map_points(x.copy())
    if turn is not None:
        s.load.value[:] = turn @ s.load.value
    return s


def reassembled(scene: Scene, **changes: Any) -> ContactProblem:
    """Return the problem of a scene; `changes` replace arguments of ContactProblem."""
    arguments: dict[str, Any] = {
        "a": scene.a,
        "L": scene.L,
        "pairs": [scene.pair],
        "bcs": scene.bcs,
        **changes,
    }
    return ContactProblem(**arguments)


def nodal(function: fem.Function) -> np.ndarray:
    """Values at owned nodes, (n,) or (n, 3)."""
    dofmap = function.function_space.dofmap
    bs = dofmap.index_map_bs
    values = function.x.array[: dofmap.index_map.size_local * bs]
    return values if bs == 1 else values.reshape(-1, bs)


def node_function(mesh: Any, values: Callable[[np.ndarray], np.ndarray]) -> fem.Function:
    """A scalar function of degree 1, `values` of points (3, n)."""
    function = fem.Function(fem.functionspace(mesh, ("Lagrange", 1)))
    function.interpolate(values)
    return function


def surface_nodes_of(solution: ContactSolution) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Points and nodal fields at owned surface nodes that carry multipliers."""
    surface = solution.surface
    points = surface.pressure.function_space.tabulate_dof_coordinates()
    state = nodal(surface.state)
    carries = state >= 0
    fields = {f.name: nodal(f)[carries] for f in surface.functions}
    return points[: len(state)][carries], fields


def logged(caplog: Any) -> str:
    """Return what was logged, without its breaks between lines."""
    return " ".join(" ".join(record.getMessage() for record in caplog.records).split())


def global_vector(comm: MPI.Comm, keys: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Gather values from all ranks, sorted by rounded keys, such as points."""
    keys = np.concatenate(comm.allgather(np.asarray(keys)), axis=0)
    values = np.concatenate(comm.allgather(np.asarray(values)), axis=0)
    return values[np.lexsort(np.round(keys, 9).T)]


def pair_of(
    bricks: TaggedMesh, secondary: str, primary: str, bound: Any = SLIP_BOUND
) -> ContactPair:
    """Return the pair of two named faces."""
    return ContactPair(
        bricks.facet_tags, bricks.tags[secondary], bricks.tags[primary], Tresca(bound)
    )


def paired(scene: Scene, pair: ContactPair | None = None) -> PairOperators:
    """Return the operators of a scene's pair, or of another one on it."""
    with LinearSystem(scene.a, scene.L, scene.bcs) as system:
        return pair_surfaces(scene.V, system.prescribed, scene.pair if pair is None else pair)


@contextmanager
def dual_program(scene: Scene, stiffness: str = "cholesky") -> Iterator[DualProgram]:
    """Put A, b and Lambda together by hand, and free all of it afterwards."""
    with LinearSystem(scene.a, scene.L, scene.bcs) as system:
        system.assemble_stiffness()
        system.assemble_load()
        if stiffness == "cholesky":
            solver = cholesky(system.K, {}, None)
        else:
            solver = multigrid(system.K, scene.V, system.prescribed, {"ksp_rtol": 1e-12}, None)
        operators = pair_surfaces(scene.V, system.prescribed, scene.pair)
        bounds = [SlipBounds(scene.V).at(scene.pair.friction, operators.nodes)]
        with (
            JumpOperator(system, [operators]) as jump,
            InitialGuess(jump) as guess,
            ContactCompliance(jump, solver, None) as compliance,
        ):
            yield DualProgram.of(compliance, guess, bounds)


def points_of(scene: Scene, operators: PairOperators) -> np.ndarray:
    """Where the contact nodes of this rank are, (n, 3)."""
    return scene.V.tabulate_dof_coordinates()[operators.nodes]


def rotation(seed: int) -> np.ndarray:
    """A random rotation (3, 3)."""
    Q, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    return Q * np.sign(np.linalg.det(Q))


def boundary_facets(mesh: Any, where: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Facets on the boundary with all corners where `where`, of points (3, n), says so."""
    mesh.topology.create_connectivity(2, 3)
    return dolfinx.mesh.locate_entities_boundary(mesh, 2, where)
