"""How sharp a guaranteed bound of the mesh's error could be in 2D, and its cost.

    tools/fenicsx python3 benchmarks/equilibrated.py --json benchmarks/data/equilibrated.json

By Prager and Synge the distance of the stress of u_h from any symmetric stress in equilibrium with
the loads bounds the error. One global mixed solve finds the stress in equilibrium that is nearest
in the space of Arnold, Falk and Winther (2007: rows in BDM, symmetry only in the mean of each
cell). No reconstruction patch by patch with the same elements can give a smaller bound. The skew
part of this stress is shown beside the bound: for a guaranteed bound the norm of the skew part,
times a constant of Korn's inequality, would have to be added.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Iterator
from typing import Any

from petsc4py import PETSc

import numpy as np
from harness import Benchmark, Column, Comm, Row, Table

import basix.ufl
import ufl
from dolfinx import fem
from dolfinx.fem import petsc
from dolfinx.mesh import locate_entities_boundary

from dolfinx_tresca.dual.bounds.estimate import DiscretisationError, total
from scenes.clamped_square import clamped_square
from scenes.elasticity import lame_constants, strain
from scenes.manufactured import norm


def compliance(stress: Any, poisson: float) -> Any:
    """Return the strain of a stress, in plane strain and for Young's modulus 1."""
    mu, lame = lame_constants(1.0, poisson)
    return (stress - lame / (2 * mu + 2 * lame) * ufl.tr(stress) * ufl.Identity(2)) / (2 * mu)


def of_rows(*rows: Any) -> Any:
    """Return the 2 x 2 tensor with the given rows."""
    return ufl.as_matrix([[row[0], row[1]] for row in rows])


def nearest_stress(u: fem.Function, poisson: float) -> tuple[Any, int]:
    """Return the stress of the mixed method for the boundary values of u, and its unknowns.

    Of all stresses of the space in equilibrium, this stress is the nearest to the stress of u. The
    second result is the number of unknowns of the mixed method.
    """
    mesh, degree = u.function_space.mesh, u.function_space.element.basix_element.degree
    cell = mesh.basix_cell()
    row = basix.ufl.element("BDM", cell, degree)
    shift = basix.ufl.element("DG", cell, degree - 1, shape=(2,))
    turn = basix.ufl.element("DG", cell, degree - 1)
    W = fem.functionspace(mesh, basix.ufl.mixed_element([row, row, shift, turn]))
    s1, s2, w, r = ufl.TrialFunctions(W)
    t1, t2, v, q = ufl.TestFunctions(W)
    sigma, tau = of_rows(s1, s2), of_rows(t1, t2)
    a = ufl.inner(compliance(sigma, poisson), tau) + ufl.inner(w, ufl.div(tau))
    a += ufl.inner(v, ufl.div(sigma)) + r * (tau[0, 1] - tau[1, 0])
    a += q * (sigma[0, 1] - sigma[1, 0])
    L = ufl.inner(u, ufl.dot(tau, ufl.FacetNormal(mesh))) * ufl.ds
    sides = locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[0] * (1.0 - x[0]), 0.0))
    bcs = []
    for i in (0, 1):
        space, _ = W.sub(i).collapse()
        dofs = fem.locate_dofs_topological((W.sub(i), space), 1, sides)
        bcs.append(fem.dirichletbc(fem.Function(space), dofs, W.sub(i)))
    A = petsc.assemble_matrix(fem.form(a * ufl.dx), bcs)
    A.assemble()
    solver = PETSc.KSP().create(mesh.comm)
    solver.setOperators(A)
    solver.setType("preonly")
    solver.getPC().setType("lu")
    solver.getPC().setFactorSolverType("mumps")
    found, right = fem.Function(W), A.createVecRight()
    right.array = fem.assemble_vector(fem.form(L)).array
    right.array[np.concatenate([bc.dof_indices()[0] for bc in bcs])] = 0.0
    solver.solve(right, found.x.petsc_vec)
    parts = ufl.split(found)
    for owned in (A, solver, right):
        owned.destroy()
    return of_rows(parts[0], parts[1]), len(found.x.array)


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield the meshes."""
    for degree, n in itertools.product((1, 2), arguments.sizes):
        yield {"degree": degree, "n": n, "poisson": arguments.poisson}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield the row of a mesh. Runs on one rank."""
    poisson = case["poisson"]
    exact = clamped_square(comm, "quadrilateral", 48, 2, poisson, grading=4.0)[2]
    start = time.perf_counter()
    a, u, energy = clamped_square(comm, "triangle", case["n"], case["degree"], poisson)
    solved = time.perf_counter()
    estimate = total(DiscretisationError(a, u.function_space).of(u))
    estimated = time.perf_counter()
    stress, unknowns = nearest_stress(u, poisson)
    mu, lame = lame_constants(1.0, poisson)
    own = 2 * mu * strain(u) + lame * ufl.div(u) * ufl.Identity(2)
    apart = ufl.sym(stress) - own
    bound = norm(comm, ufl.inner(compliance(apart, poisson), apart) * ufl.dx)
    skew = norm(comm, ufl.inner(ufl.skew(stress), ufl.skew(stress)) / (2 * mu) * ufl.dx)
    error = (energy**2 - exact**2) ** 0.5
    yield {
        "unknowns": len(u.x.array),
        "mixed_unknowns": unknowns,
        "error": error / exact,
        "estimate": estimate / error,
        "bound": bound / error,
        "skew": skew / error,
        "solve_seconds": solved - start,
        "estimate_seconds": estimated - solved,
        "bound_seconds": time.perf_counter() - estimated,
    }


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--sizes", type=int, nargs="+", default=[8, 16, 32, 64])
    parser.add_argument("--poisson", type=float, default=0.3)


COLUMNS = [
    Column("degree", "{degree}"),
    Column("unknowns", "{unknowns}"),
    Column("error", "{error:.2%}", width=7),
    Column("estimate over error", "{estimate:.2f}"),
    Column("bound over error", "{bound:.2f}"),
    Column("its asymmetry over error", "{skew:.2f}"),
    Column("unknowns of the mixed solve", "{mixed_unknowns}"),
    Column("seconds: solve", "{solve_seconds:.2f}"),
    Column("estimate", "{estimate_seconds:.2f}"),
    Column("bound", "{bound_seconds:.2f}"),
]
BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("degree", "n", "poisson"),
    cases=cases,
    measure=measure,
    options=options,
    shown=COLUMNS,
    small={"n": 4},
    tables=[Table("equilibrated", COLUMNS)],
)

if __name__ == "__main__":
    BENCHMARK.main()
