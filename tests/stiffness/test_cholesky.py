"""Which package factors K, and what is said where none can."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest

from dolfinx_tresca import StiffnessError
from dolfinx_tresca.stiffness.choice import cholesky
from scenes.scene import EPS


def chain(comm, springs: np.ndarray, count: int = 40) -> PETSc.Mat:
    """Points in a row, each joined to the next, the first `len(springs)` held by springs."""
    K = PETSc.Mat().createAIJ((count, count), nnz=3, comm=comm)
    first, last = K.getOwnershipRange()
    for row in range(first, last):
        held = springs[row] if row < len(springs) else 0.0
        K[row, row] = held + (row > 0) + (row < count - 1)
        for other in (row - 1, row + 1):
            if 0 <= other < count:
                K[row, other] = -1.0
    K.assemble()
    K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    return K


def package(solver) -> str:
    """What factored the matrix: "CHOLMOD" or "MUMPS"."""
    return str(solver).split(", ")[1]


#: Whether PETSc was built with CHOLMOD: Debian's is, the wheel's from PyPI is not.
HAS_CHOLMOD = PETSc.Sys.hasExternalPackage("cholmod") or PETSc.Sys.hasExternalPackage("suitesparse")


@pytest.fixture(params=[True, False], ids=["cholmod", "without cholmod"])
def available(request, monkeypatch) -> bool:
    """PETSc with CHOLMOD if it has it, and one that has a package's name there which it lacks."""
    if not request.param:
        monkeypatch.setattr("dolfinx_tresca.stiffness.choice.ON_ONE_RANK", "pastix")
    return request.param and HAS_CHOLMOD


@pytest.mark.parallel
def test_one_rank_takes_cholmod_where_petsc_has_it(comm, available):
    K = chain(comm, np.array([1.0]))
    u, f = K.createVecs()
    f.set(1.0)
    with cholesky(K, {}, None) as solver:
        assert package(solver) == ("CHOLMOD" if available and comm.size == 1 else "MUMPS")
        solver.solve(f, u)
    K.mult(u, f)
    # the condition number is below (2 * 40)^2
    assert np.abs(f.array - 1.0).max(initial=0.0) <= 80**2 * EPS


@pytest.mark.parallel
def test_negative_pivots_are_counted(comm, available):
    """Those of small matrices as well, for which CHOLMOD's own choice would take them as they are.

    Two springs push harder than the chain can hold; Sylvester's law counts.
    """
    K = chain(comm, np.array([1.0, -9.0, 1.0, -9.0]))
    with pytest.raises(StiffnessError, match=r"not positive definite: 2 of 40 pivots are negative"):
        cholesky(K, {}, None)


def test_a_point_without_stiffness_is_refused(comm, available):
    with pytest.raises(StiffnessError, match=r"could not factor K: INFOG\(1\) = -10"):
        cholesky(chain(comm, np.array([0.0]), count=1), {}, None)


def test_options_for_mumps_are_for_mumps(comm):
    K = chain(comm, np.array([1.0]))
    for options in ({"pc_factor_mat_solver_type": "mumps"}, {"mat_mumps_icntl_7": 0}):
        with cholesky(K, options, None) as solver:
            assert package(solver) == "MUMPS"
    database = PETSc.Options("mine_")
    database["mat_mumps_icntl_7"] = 0
    try:
        with cholesky(K, {}, "mine_") as solver:
            assert package(solver) == "MUMPS"
    finally:
        database.delValue("mat_mumps_icntl_7")


def test_cholmod_that_was_asked_for_is_not_replaced(comm):
    options = {"pc_factor_mat_solver_type": "cholmod"}
    if not HAS_CHOLMOD:
        with pytest.raises(StiffnessError, match="Could not locate solver type cholmod"):
            cholesky(chain(comm, np.array([1.0])), options, None)
        return
    with cholesky(chain(comm, np.array([1.0])), options, None) as solver:
        assert package(solver) == "CHOLMOD"
    with pytest.raises(StiffnessError, match=r"CHOLMOD detected .* not positive definite"):
        cholesky(chain(comm, np.array([-9.0])), options, None)
