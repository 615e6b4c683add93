"""Packed polylines against closed forms and shapely."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import shapely
from fakes import pack, polygon_area, ring
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rasterslice.paths import COLUMNS, DEPOSITION, REGIONS, Layer, Paths, summed_lengths

coordinates = st.floats(-1e5, 1e5, width=32)
loops = st.lists(st.integers(3, 9).flatmap(lambda n: arrays(np.float64, (n, 2), elements=coordinates)), max_size=6)


def test_regular_polygons_have_their_area_and_length() -> None:
    paths = pack([ring(8, 12), ring(3, 7, clockwise=True)], True)
    assert paths.areas() == pytest.approx([polygon_area(12, 8), -polygon_area(7, 3)], rel=1e-13)
    sides = [12 * 2 * 8 * math.sin(math.pi / 12), 7 * 2 * 3 * math.sin(math.pi / 7)]
    assert paths.lengths() == pytest.approx(sides, rel=1e-13)


def test_open_paths_have_no_closing_chord() -> None:
    assert pack([[(0, 0), (3, 4)], [(1, 1), (1, 1)]], False).lengths().tolist() == [5.0, 0.0]
    assert pack([[(0, 0), (3, 4)]], True).lengths().tolist() == [10.0]
    with pytest.raises(ValueError, match="no area"):
        pack([[(0, 0), (3, 4)]], False).areas()


def test_no_paths_at_all() -> None:
    empty = Paths.empty(True)
    assert len(empty) == 0
    assert list(empty) == []
    assert empty.lengths().tolist() == empty.areas().tolist() == []


@pytest.mark.parametrize("where", range(4))
def test_a_path_of_no_points_has_neither_length_nor_area(where: int) -> None:
    loops: list[Any] = [ring(8, 12), ring(3, 7, clockwise=True), ring(1, 5)]
    want = pack(loops, True)
    loops.insert(where, np.empty((0, 2)))
    found = pack(loops, True)
    assert found.areas().tolist() == np.insert(want.areas(), where, 0).tolist()
    assert found.lengths().tolist() == np.insert(want.lengths(), where, 0).tolist()
    assert pack([np.empty((0, 2))], True).areas().tolist() == [0.0]


def test_lengths_of_runs_of_steps() -> None:
    steps = np.array([3 + 4j, 5, 12j, 8 - 6j])
    assert summed_lengths(steps.copy(), np.array([0, 0, 2, 2, 4, 4])).tolist() == [0, 10, 0, 22, 0]
    assert summed_lengths(steps[:0], np.array([0, 0])).tolist() == [0]
    assert summed_lengths(steps[:0], np.array([0])).tolist() == []


def test_indices_count_from_both_ends() -> None:
    paths = pack([[(0, 0), (1, 0)], [(5, 5), (6, 6), (7, 7)]], False)
    assert paths[-1].tolist() == [[5, 5], [6, 6], [7, 7]]
    assert [len(p) for p in paths] == [2, 3]
    for i in (2, -3):
        with pytest.raises(IndexError):
            paths[i]


def test_area_far_from_the_origin_keeps_its_digits() -> None:
    assert pack([ring(2, 24) + 1e6], True).areas() == pytest.approx([polygon_area(24, 2)], rel=1e-8)


@given(loops)
def test_lengths_and_areas_agree_with_shapely(points: list[np.ndarray]) -> None:
    paths = pack(points, True)
    for i, loop in enumerate(points):
        closed = shapely.LinearRing(loop)
        size = float(np.abs(loop).max()) + 1
        assert paths.lengths()[i] == pytest.approx(closed.length, rel=1e-9, abs=size * 1e-8)
        (x, y), (u, v) = loop.T, np.roll(loop, -1, axis=0).T
        area = 0.5 * float(np.sum(x * v - y * u))
        assert paths.areas()[i] == pytest.approx(area, rel=1e-6, abs=size**2 * 1e-9)


def test_names_of_sets_and_columns_fit_the_layer() -> None:
    assert set(REGIONS + DEPOSITION) <= set(Layer.__dataclass_fields__)
    assert COLUMNS[:2] == ("layer", "z")
    assert COLUMNS[-1] == "flags"
