"""Pieces that are sorted by the tiles of a window give what those of the whole grid give."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rasterslice.bins import count_pieces, place_pieces, sort_pieces
from rasterslice.device import Device
from rasterslice.distance import part_distance
from rasterslice.grid import TILE, Grid
from rasterslice.overlap import boundary_pieces, find_contacts
from rasterslice.scaffold import Union
from rasterslice.section import Sections
from rasterslice.tiles import new_images, quanta, reach_of, read_images
from rasterslice.window import Window, whole, window_around

GRID = Grid(0.0, 0.0, 1.0, 9, 7)
BAND = 5.0


def rings(layers: int, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Segments of squares a layer that cross each other, somewhere in the grid, and the layer of each."""
    found = []
    for layer in range(layers):
        for x, y, half in ((70.3 + layer, 50.2, 11.0), (76.1, 57.7, 9.5))[:number]:
            corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half + (x, y)
            found.append(np.hstack([corners, np.roll(corners, -1, axis=0)]))
    return np.concatenate(found).astype(np.float32), np.repeat(np.arange(layers, dtype=np.int32), 4 * number)


@pytest.mark.parametrize("mapping", ["cpu", "gpu"])
@pytest.mark.parametrize("layers", [1, 3])
@pytest.mark.parametrize("number", [1, 2])
def test_a_window_gives_what_the_grid_gives(mapping: str, layers: int, number: int) -> None:
    segments, layer = rings(layers, number)
    sections = Sections(None, None, 0, np.array([0, len(segments)]), segments, np.zeros(1, np.int64), np.zeros(1))
    window = window_around(GRID, sections.box(0, 1), reach_of(BAND))
    assert window.tiles < GRID.tiles / 2
    found = []
    for narrow in (False, True):
        device = Device(mapping=mapping)  # of which no memory holds what the other left
        where = (device.put("segments", segments), device.put("layers", layers - 1 - layer), (0, len(segments)))
        if narrow:
            counted = count_pieces(device, window, *where, layers - 1, layers)
            pieces, wind = place_pieces(device, counted), counted.wind
        else:
            pieces, wind = sort_pieces(device, GRID, *where, layers - 1, layers)
        suspects = find_contacts(device, pieces, layers)
        touching = device.get(suspects, layers, np.int32)
        near, tangled = boundary_pieces(device, pieces, wind, suspects, layers, "nonzero")
        images, counter = new_images(device, "sdf", layers, GRID, quanta(BAND))
        rest = (wind, layers, BAND, "nonzero", images, counter, suspects)
        where_part, flags = part_distance(device, GRID, near, pieces, *rest)
        union = Union(device, GRID, 6.0, True, quanta(BAND))
        above, read = union.descend(near, images, layers)
        read()
        parts = read_images(device, images, layers, GRID)
        found.append((touching, tangled, flags, where_part < 0, parts, read_images(device, above, layers, GRID)))
    assert found[0][0].all() == found[0][1].all() == (number == 2), "they cross"
    for a, b in zip(*found, strict=True):
        assert np.array_equal(a, b)


@given(st.integers(0, 20), st.sampled_from([0, 1, 255, 256, 600]), st.integers(0, 2**32 - 1), st.integers(1, 3))
def test_windows_hold_all_segments(few: int, many: int, seed: int, reach: int) -> None:
    host = np.random.default_rng(seed).uniform(2, 100, (few + many, 4)).astype(np.float32)
    offsets = np.array([0, few, few + many])
    sections = Sections(None, None, 5, offsets, host, np.zeros(2, np.int64), np.zeros(2))
    for start, end in ((5, 6), (6, 7), (5, 7)):
        part = host[offsets[start - 5] : offsets[end - 5]].reshape(-1, 2)
        box = sections.box(start, end)
        if not len(part):
            assert box is None
            continue
        assert box == (*part.min(0).tolist(), *part.max(0).tolist())
        (x, y), columns, rows = window_around(GRID, box, reach)
        low, high = part.min(0) // TILE, part.max(0) // TILE
        assert (x, y) == tuple(np.maximum(low - reach, 0))
        assert (x + columns, y + rows) == tuple(np.minimum(high + reach + 1, (GRID.tiles_x, GRID.tiles_y)))


def test_a_window_of_nothing_is_a_tile() -> None:
    assert window_around(GRID, None, 1) == Window((0, 0), 1, 1)
    assert whole(GRID) == Window((0, 0), 9, 7) and whole(GRID).tiles == 63
