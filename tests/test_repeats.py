"""What is told of all layers of a batch at once: tiles that repeat the layer above, exact areas."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rasterslice.contour import Seeds, trace
from rasterslice.device import Device
from rasterslice.isoline import areas
from rasterslice.repeats import find_repeats
from rasterslice.section import Sections
from rasterslice.selftest import PITCH, SIZE, measured
from rasterslice.tiles import OUTSIDE


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
    new, source = repeats = find_repeats(where, reach)
    for i in range(images):
        for y in range(rows):
            for x in range(columns):
                near = np.s_[max(0, y - reach) : y + reach + 1, max(0, x - reach) : x + reach + 1]
                assert new[i, y, x] == (i == 0 or (where[i][near] != where[i - 1][near]).any())
                own = (i * rows + y) * columns + x
                assert source[i, y, x] == (own if new[i, y, x] else source[i - 1, y, x])
    stored = {int(k) for k in np.flatnonzero(where.ravel() >= 0)}
    assert set(repeats.own(where).tolist()) == stored & set(source.ravel().tolist())


def test_no_images() -> None:
    nothing = np.empty((0, 3, 4), np.int32)
    assert find_repeats(nothing).source.shape == (0, 3, 4)
    assert find_repeats(nothing).own(nothing).tolist() == []


@given(st.lists(st.integers(0, 9000), min_size=1, max_size=12), st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_exact_areas_are_those_of_each_slice(counts: list[int], seed: int) -> None:
    """However many segments are summed at once, and in whatever company."""
    rng = np.random.default_rng(seed)
    offsets = np.concatenate([[0], np.cumsum(counts)])
    host = rng.uniform(0, 500, (offsets[-1], 4)).astype(np.float32)
    none = np.zeros(len(counts))
    sections = Sections(None, None, 3, offsets, host, none.astype(np.int64), none)
    found = sections.exact_areas(3, 3 + len(counts))
    for i, (a, b) in enumerate(itertools.pairwise(offsets.tolist())):
        x0, y0, x1, y1 = (host[a:b].astype(np.float64) - host[a, [0, 1, 0, 1]]).T if b > a else np.zeros((4, 0))
        assert found[i] == pytest.approx(0.5 * math.fsum(x0 * y1 - x1 * y0), rel=1e-10, abs=1e-6)
        assert sections.exact_areas(3 + i, 4 + i)[0] == found[i]


@pytest.mark.parametrize("mapping", ["cpu", "gpu"])
@pytest.mark.parametrize("first", [0, 1])
def test_areas_of_tiles_that_are_shared_count_wherever_they_are(mapping: str, first: int) -> None:
    """The slice of a box has the area of its closed form, also where an image repeats the one before it."""
    device = Device(mapping=mapping)
    grid, images, where = measured(device, [0.25, 0.5, 0.75])
    shared = np.stack([where[0], where[0], np.full_like(where[0], OUTSIDE)])
    images.map = device.put("shared map", shared)
    area = areas(device, grid, images, shared[first:], first)()
    assert area == pytest.approx([float(np.prod(SIZE[:2])) / PITCH**2] * (2 - first) + [0.0], rel=1e-3)
    assert first or area[0] == area[1]


@pytest.mark.parametrize(("tolerance", "waits"), [(0.1, 2), (0.0, 1)])
def test_other_work_begins_while_contours_are_followed(tolerance: float, waits: int) -> None:
    """One step before the loops are waited for, and one before where they cross, if that is looked for."""
    device = Device()
    grid, images, where = measured(device, [0.5])
    seeds = Seeds(device, grid, images, 1, 1, (0, 0))
    seeds.find(where, 0)
    steps = iter(range(9))
    _, read = trace(device, grid, seeds, tolerance, 0.0, (tolerance > 0, False), seeds.count(), steps)
    assert len(read().ends[0]) == 1
    assert next(steps) == waits
