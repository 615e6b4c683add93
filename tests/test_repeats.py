"""Tiles that repeat the layer above: found by their slots, and never taken for one that changed."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rasterslice.tiles import find_repeats, own_keys


@st.composite
def maps(draw: st.DrawFn) -> np.ndarray:
    """Maps of which most tiles keep their slot from image to image."""
    images, rows, columns = draw(st.integers(1, 5)), draw(st.integers(1, 5)), draw(st.integers(1, 6))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    where = rng.integers(-2, 50, (images, rows, columns)).astype(np.int32)
    for i in range(1, images):
        same = rng.random((rows, columns)) < draw(st.sampled_from([0.5, 0.9, 1.0]))
        where[i][same] = where[i - 1][same]
    return where


@given(maps(), st.integers(1, 2))
def test_find_repeats(where: np.ndarray, reach: int) -> None:
    images, rows, columns = where.shape
    source = find_repeats(where, reach)
    for i in range(images):
        for y in range(rows):
            for x in range(columns):
                near = np.s_[max(0, y - reach) : y + reach + 1, max(0, x - reach) : x + reach + 1]
                new = i == 0 or (where[i][near] != where[i - 1][near]).any()
                own = (i * rows + y) * columns + x
                assert source[i, y, x] == (own if new else source[i - 1, y, x])
    stored = {int(k) for k in np.flatnonzero(where.ravel() >= 0)}
    assert set(own_keys(where, source).tolist()) == stored & set(source.ravel().tolist())


def test_no_images() -> None:
    nothing = np.empty((0, 3, 4), np.int32)
    assert find_repeats(nothing).shape == (0, 3, 4)
    assert own_keys(nothing, find_repeats(nothing)).tolist() == []
