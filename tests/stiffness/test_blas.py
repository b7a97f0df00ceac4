"""The warning about the slow BLAS, and the number of its threads."""

import logging

import numpy as np
import pytest

from dolfinx_tresca import ContactProblem
from dolfinx_tresca.stiffness import choice
from scenes.press_fit import press_fit
from scenes.two_bricks import two_bricks

REFERENCE = "/usr/lib/x86_64-linux-gnu/blas/libblas.so.3.12.1"
OPENBLAS = "/usr/lib/x86_64-linux-gnu/openblas-pthread/libblas.so.3"


def test_the_reference_blas_is_told_from_a_fast_one():
    assert choice.reference_blas({"/usr/lib/libc.so.6", REFERENCE}) == REFERENCE
    assert choice.reference_blas({REFERENCE, OPENBLAS}) is None
    assert choice.reference_blas({"/usr/lib/libc.so.6"}) is None
    of_numpy = "/site-packages/numpy.libs/libscipy_openblas64_.so"
    assert choice.reference_blas({REFERENCE, of_numpy}) == REFERENCE


@pytest.mark.parallel
@pytest.mark.parametrize(("library", "warnings"), [(REFERENCE, 1), (OPENBLAS, 0)])
def test_the_first_problem_warns_once(comm, caplog, monkeypatch, library, warnings):
    monkeypatch.setattr(choice, "loaded_libraries", lambda: {library})
    choice.warn_of_slow_blas.cache_clear()
    scene = two_bricks(comm, 3)
    with caplog.at_level(logging.WARNING, logger="dolfinx_tresca"):
        for _ in range(2):
            ContactProblem(scene.a, scene.L, [scene.pair], bcs=scene.bcs).destroy()
    choice.warn_of_slow_blas.cache_clear()
    found = [record for record in caplog.records if "reference BLAS" in record.getMessage()]
    assert len(found) == (warnings if comm.rank == 0 else 0)


@pytest.fixture
def two_threads(monkeypatch):
    """Let each OpenBLAS have two threads, as on a machine with two cores; return the counts."""
    for variable in choice.THREAD_VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    threads = choice.openblas_threads()
    before = [get() for get, _ in threads]
    for _, set_number in threads:
        set_number(2)
    yield lambda: [get() for get, _ in threads]
    for (_, set_number), number in zip(threads, before, strict=True):
        set_number(number)


def test_all_openblas_libraries_tell_their_threads(two_threads):
    """The names of the functions differ between the libraries of Debian and of wheels."""
    libraries = [path for path in choice.loaded_libraries() if "openblas" in path.split("/")[-1]]
    assert libraries, "numpy and PETSc of the supported environments have OpenBLAS"
    assert len(two_threads()) >= len(libraries)
    assert max(two_threads()) == 2  # the others are compiled for one thread


@pytest.mark.parallel
def test_iterations_have_one_thread_unless_the_user_sets_a_number(comm, two_threads, monkeypatch):
    outside, inside, forces = two_threads(), [], []

    def observe(_):
        inside.append(two_threads())

    with press_fit(comm, 6).problem() as problem:
        forces.append(problem.solve(observer=observe).normal_force)
        assert inside and np.all(np.asarray(inside) == 1)
        assert two_threads() == outside
        for variable in choice.THREAD_VARIABLES:
            inside.clear()
            with monkeypatch.context() as changed:
                changed.setenv(variable, "2")
                forces.append(problem.solve(observer=observe, rtol=1e-8).normal_force)
            assert inside and all(counts == outside for counts in inside)
        inside.clear()
        forces.append(problem.solve(observer=observe, rtol=1e-9).normal_force)
    assert inside and np.all(np.asarray(inside) == 1)
    assert np.allclose(forces[1:], forces[-1], rtol=1e-6)
