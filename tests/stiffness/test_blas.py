"""The warning about the slow BLAS."""

import logging

import pytest

from dolfinx_tresca import ContactProblem
from dolfinx_tresca.stiffness import blas
from scenes.two_bricks import two_bricks

REFERENCE = "/usr/lib/x86_64-linux-gnu/blas/libblas.so.3.12.1"
OPENBLAS = "/usr/lib/x86_64-linux-gnu/openblas-pthread/libblas.so.3"


def test_the_reference_blas_is_told_from_a_fast_one():
    assert blas.reference_blas({"/usr/lib/libc.so.6", REFERENCE}) == REFERENCE
    assert blas.reference_blas({REFERENCE, OPENBLAS}) is None
    assert blas.reference_blas({"/usr/lib/libc.so.6"}) is None
    of_numpy = "/site-packages/numpy.libs/libscipy_openblas64_.so"
    assert blas.reference_blas({REFERENCE, of_numpy}) == REFERENCE


@pytest.mark.parallel
@pytest.mark.parametrize(("library", "warnings"), [(REFERENCE, 1), (OPENBLAS, 0)])
def test_the_first_problem_warns_once(comm, caplog, monkeypatch, library, warnings):
    monkeypatch.setattr(blas, "loaded_libraries", lambda: {library})
    blas.warn_of_slow_blas.cache_clear()
    scene = two_bricks(comm, 3)
    with caplog.at_level(logging.WARNING, logger="dolfinx_tresca"):
        for _ in range(2):
            ContactProblem(scene.a, scene.L, [scene.pair], bcs=scene.bcs).destroy()
    blas.warn_of_slow_blas.cache_clear()
    found = [record for record in caplog.records if "reference BLAS" in record.getMessage()]
    assert len(found) == (warnings if comm.rank == 0 else 0)
