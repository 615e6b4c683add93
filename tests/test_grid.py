"""Pixel and slice positions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rasterslice.errors import UsageError
from rasterslice.grid import TILE, cover, slice_heights

mm = st.floats(-1000, 1000)
size = st.floats(0, 300)
pitches = st.sampled_from([0.05, 0.1, 0.2, 0.25, 0.3, 1.0])


@given(mm, mm, size, size, pitches, st.floats(0, 20))
def test_the_grid_holds_the_box_and_an_empty_border(
    x: float, y: float, w: float, h: float, pitch: float, margin: float
) -> None:
    grid = cover((x, y), (x + w, y + h), pitch, margin)
    low, high = grid.to_pixels([(x - margin, y - margin), (x + w + margin, y + h + margin)])
    assert (low >= 2 - 1e-6).all()
    assert (high <= (grid.width - 3 + 1e-6, grid.height - 3 + 1e-6)).all()
    assert (high > (grid.width - TILE - 5, grid.height - TILE - 5)).all()
    assert grid.x0 / pitch == pytest.approx(round(grid.x0 / pitch), abs=1e-6)
    assert grid.tiles * TILE**2 == grid.width * grid.height


@given(mm, mm)
def test_pixels_and_mm_are_inverse(x: float, y: float) -> None:
    grid = cover((-5, 3), (90, 55), 0.2, 5)
    assert grid.to_mm(grid.to_pixels((x, y))) == pytest.approx((x, y), abs=1e-9)


def test_y_points_up_and_pixels_are_points() -> None:
    grid = cover((0, 0), (10, 10), 0.25, 0)
    assert grid.to_mm((0, 0)).tolist() == [grid.x0, grid.y0] == [-0.5, -0.5]
    assert grid.to_mm((2, 6)).tolist() == [0, 1]


def test_shift_by_whole_pixels_shifts_the_grid_and_nothing_else() -> None:
    a, b = cover((0.1, 0.2), (9.9, 7.1), 0.25, 1), cover((100.1, -49.8), (109.9, -42.9), 0.25, 1)
    assert (b.x0 - a.x0, b.y0 - a.y0) == (100, -50)
    assert (a.tiles_x, a.tiles_y) == (b.tiles_x, b.tiles_y)


@given(mm, st.floats(0.5, 300), st.floats(0.05, 2), st.floats(0, 1))
def test_heights_are_all_that_lie_below_the_top(zmin: float, height: float, t: float, position: float) -> None:
    zmax = zmin + height
    if not zmin + position * t < zmax:
        return
    z = slice_heights(zmin, zmax, t, position)
    assert (z < zmax).all()
    assert z[-1] + t >= zmax - 1e-9
    assert z == pytest.approx(zmin + (np.arange(len(z)) + position) * t)


def test_mid_slices_of_a_whole_number_of_slices() -> None:
    assert slice_heights(0, 2, 0.5, 0.5).tolist() == [0.25, 0.75, 1.25, 1.75]
    assert slice_heights(0, 2, 0.5, 0.0).tolist() == [0, 0.5, 1, 1.5]
    assert len(slice_heights(0, 306.0043, 0.4, 0.5)) == math.ceil(306.0043 / 0.4 - 0.5)


def test_a_slice_thicker_than_the_part_is_refused_with_the_remedy() -> None:
    with pytest.raises(UsageError, match=r"thickness 5 mm leaves no slice in a part 2 mm high; use less than 4 mm"):
        slice_heights(0, 2, 5, 0.5)
