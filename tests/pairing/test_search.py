"""Search for balls along normals, compared with a search over all pairs."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

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
