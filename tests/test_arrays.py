"""Layers as shapely geometry and as stacks."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from fakes import pack, ring, washer

import rasterslice
from rasterslice.errors import UsageError
from rasterslice.grid import cover
from rasterslice.paths import Paths

GRID = cover((-12, -12), (12, 12), 0.2, 1.0)


def test_polygons_have_their_holes_and_islands() -> None:
    paths = pack([ring(8), ring(5, clockwise=True), ring(3), ring(1) + (20, 0)], True)
    shape = rasterslice.to_polygons(paths)
    assert shape.is_valid
    assert shape.area == pytest.approx(paths.areas().sum())
    assert sorted(len(part.interiors) for part in shape.geoms) == [0, 0, 1]
    assert rasterslice.to_polygons(Paths.empty(True)).is_empty
    stunted = pack([np.empty((0, 2)), ring(1)[:2], ring(1)], True)
    assert rasterslice.to_polygons(stunted).area == pytest.approx(3.13, abs=0.01)
    with pytest.raises(ValueError, match="use to_lines"):
        rasterslice.to_polygons(Paths.empty(False))


def test_lines_are_as_long_as_the_paths() -> None:
    item = washer(0, 0.2)
    for paths in (item.part_boundary, item.part_fill):
        assert rasterslice.to_lines(paths).length == pytest.approx(paths.lengths().sum())


def test_a_stack_has_the_areas_of_the_layers() -> None:
    items = [washer(k, 0.4 * k) for k in range(3)]
    stack = rasterslice.to_stack(items, GRID)
    assert stack.shape == (3, GRID.height, GRID.width)
    assert stack.sum(axis=(1, 2), dtype=np.float64) * 0.04 == pytest.approx([i.stats["part_area"] for i in items])
    assert rasterslice.to_stack([], GRID, "scaffold").shape == (0, GRID.height, GRID.width)
    with pytest.raises(UsageError, match="layer 0 holds no regions"):
        rasterslice.to_stack([washer(0, 0.2, regions=False)], GRID)
    with pytest.raises(UsageError, match="material must be part or scaffold, got 'ice'"):
        rasterslice.to_stack(items, GRID, "ice")
    with pytest.raises(UsageError, match=r"layer 0: its part reaches beyond the grid, \(.*\) mm; use the grid"):
        rasterslice.to_stack(items, cover((-4, -4), (4, 4), 0.2, 0.0))


def test_without_shapely_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "shapely", None)
    with pytest.raises(UsageError, match=r"pip install 'rasterslice\[shapely\]'"):
        rasterslice.to_lines(pack([ring(1)], True))
