"""What counts as rounding is a multiple of the rounding of the coordinates, wherever bodies are."""

from __future__ import annotations

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactProblem, ContactStatus, Coulomb
from dolfinx_tresca.pairing.coupling import dual_coefficients
from scenes.elasticity import elasticity, fixed
from scenes.patches import BOTTOM, KINDS, LOWER, TOP, UPPER, dim_of, patch
from scenes.scene import EPS

#: Scale of the scene, and distance from the origin: coordinates as of a map, in a micrometre, in
#: numbers of 1e6.
PLACES = [(1.0, 1e3), (1.0, 1e6), (1e-6, 0.0), (1e-6, 1.0), (1e6, 0.0)]

#: Rounding of the rows of N, of which each is the sum of some hundred integrals over overlaps.
SUMMED = 100.0


def rows_of(comm, kind, degree, part, scale=1.0, far=0.0):
    """Return N (nodes, nodes of V, dim) and weights of two blocks, one on a part of the other."""
    dim = dim_of(kind)
    distort = 0.0 if part or kind == "hexahedron" else 0.3  # else integrands are no polynomials
    scene = patch(
        comm, kind, degree, scale=scale, shift=[0.7 * far, 0.9 * far, -far * (dim == 3)],
        span=[(0.25, 0.75)] * (dim - 1) if part else None, distort=distort,
        upper=(2, 1) if part else (3, 1), lower=(4, 1), pairing="mortar",
    )  # fmt: skip
    found = scene.operators()
    return found.N.toarray().reshape(len(found.weights), -1, dim), found.weights


@pytest.mark.parametrize("part", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_rows_have_the_same_entries_wherever_the_bodies_are(comm, kind, part):
    """Bodies 1e6 times their size away lose six digits; they get neither more columns nor fewer."""
    for degree in (1, 2):
        here, weights = rows_of(comm, kind, degree, part)
        for scale, far in PLACES:
            there, other = rows_of(comm, kind, degree, part, scale, far)
            rounding = SUMMED * EPS * max(far / scale, 10.0)
            area = scale ** (dim_of(kind) - 1)
            assert np.array_equal(there.any(axis=2), here.any(axis=2))
            assert np.abs(there - here).max() <= rounding
            assert np.abs(other / area - weights).max() <= rounding


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("scale", "far"), PLACES[1::2])
def test_bodies_that_contact_holds_are_found_wherever_they_are(comm, kind, scale, far):
    """Such bodies carry their load, and forces balance up to the rounding of the coordinates."""
    dim = dim_of(kind)
    young = {1e-6: 2e11, 1.0: 1e3, 1e6: 1e-6}[scale]
    scene = patch(comm, kind, scale=scale, shift=[0.7 * far, 0.9 * far, -far * (dim == 3)])
    V, tags = scene.V, scene.facet_tags
    load = fem.Constant(scene.mesh, 1e-3 * young * np.append(np.zeros(dim - 1), -1.0))
    ds = ufl.Measure("ds", scene.mesh, subdomain_data=tags)
    L = ufl.inner(load, ufl.TestFunction(V)) * ds(TOP)
    pair = ContactPair(tags, UPPER, LOWER, Coulomb(0.3))
    a = elasticity(V, fem.Constant(scene.mesh, young))
    with ContactProblem(a, L, [pair], bcs=[fixed(V, tags.find(BOTTOM))]) as problem:
        assert "2, 1 of them held by contact alone" in str(problem)
        solution = problem.solve()
    assert solution.status is ContactStatus.CONVERGED
    force = 1e-3 * young * scale ** (dim - 1)
    assert solution.normal_force == pytest.approx(force, rel=SUMMED * EPS * max(far / scale, 10.0))


@pytest.mark.parametrize("width", [1e-3, 1e-6, 1e-9, 1e-12])
def test_dual_functions_on_a_strip_of_a_facet(width):
    """The mass matrix of a strip is nearly singular; the basis is biorthogonal all the same."""
    place, weight = np.polynomial.legendre.leggauss(4)
    along, across = np.meshgrid(0.5 + 0.5 * place, width * (0.5 + 0.5 * place))
    shares = 0.25 * np.outer(weight, weight).ravel()
    hats = np.array([1.0 - along - across, along, across]).reshape(3, -1)
    masses = (hats * shares) @ hats.T
    dual = dual_coefficients(masses[None], np.eye(3)[None])[0]
    of_dual = (dual @ masses).sum(axis=1)
    assert of_dual == pytest.approx(masses.sum(axis=1), rel=1e-9)
    assert dual @ masses == pytest.approx(np.diag(of_dual), abs=1e-9)
