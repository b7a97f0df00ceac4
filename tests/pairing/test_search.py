"""Search for balls along normals, compared with a search over all pairs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rotations import rotation

from dolfinx_tresca.pairing.search.balls import Balls

#: Relative rounding of the distance from a line: such balls may be found or not.
ROUNDING = 2e-9


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def check(centres, normals, radii, others, other_radii, limit=np.inf) -> int:
    """Compare the search with all pairs; return the number of pairs."""
    first, second = Balls(others, other_radii).on_normals(centres, normals, radii, limit)
    assert (np.diff(first) >= 0).all()
    found = np.zeros((len(centres), len(others)), dtype=bool)
    found[first, second] = True
    assert found.sum() == len(first)  # no pair occurs twice
    offset = others[None] - centres[:, None]
    along = np.einsum("nmi,ni->nm", offset, normals)
    across = np.linalg.norm(offset - along[..., None] * normals[:, None], axis=2)
    reach = radii[:, None] + other_radii
    assert not (found & (across > (1.0 + ROUNDING) * reach)).any()
    wanted = (across < (1.0 - ROUNDING) * reach) & (np.abs(along) <= limit)
    assert found[wanted].all()
    return int(wanted.sum())


@settings(max_examples=60)
@given(
    st.integers(0, 10**6),
    st.sampled_from([0.0, 1.0, 4.0]),
    st.sampled_from([0.1, 1.0, 30.0, np.inf]),
)
def test_random_balls(seed, decades, limit):
    """The radii differ by factors of up to 10^decades."""
    rng = np.random.default_rng(seed)
    n, m = rng.integers(1, 40, 2)
    check(
        rng.standard_normal((n, 3)),
        unit(rng.standard_normal((n, 3))),
        0.3 * 10.0 ** -rng.uniform(0.0, decades + 1e-9, n),
        rng.standard_normal((m, 3)) * rng.choice([0.1, 1.0, 10.0]),
        0.3 * 10.0 ** -rng.uniform(0.0, decades + 1e-9, m),
        limit,
    )


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("apart", [0.0, 1e-3, 50.0])
def test_flat_surfaces_that_face_each_other(turned, apart):
    """Along the axes the directions have zero components, rotated they have rounding errors."""
    R = rotation(4) if turned else np.eye(3)
    grids = []
    for n in (6, 9):
        x, y = np.meshgrid(*[(np.arange(n) + 0.5) / n] * 2)
        grids.append(np.stack([x.ravel(), y.ravel(), np.zeros(n * n)], axis=1))
    first, second = grids[0] @ R.T, (grids[1] + [0.0, 0.0, -apart]) @ R.T
    normals = np.broadcast_to(R @ [0.0, 0.0, -1.0], first.shape)
    radii = [np.full(len(x), 0.71 / np.sqrt(len(x))) for x in (first, second)]
    assert check(first, normals, radii[0], second, radii[1]) > 81
    if apart == 50.0:
        assert check(first, normals, radii[0], second, radii[1], limit=1.0) == 0
        assert len(Balls(second, radii[1]).on_normals(first, normals, radii[0], 1.0)[0]) == 0
