"""check: chains of pieces, crossings, retraced contours; slopes and alignment that once misled it."""

import models
import numpy as np
import oracle
import plants
import pytest
from shapely import affinity

from rasterslice.check.loops import crossings, segments_of
from rasterslice.check.outlines import Outlines, string
from rasterslice.check.run import check
from rasterslice.grid import Grid

T = 0.4


def pieces(*loops):
    return np.concatenate([np.hstack([p, np.roll(p, -1, axis=0)]) for p in map(np.asarray, loops)]).astype(np.float32)


SQUARE = np.array([(0, 0), (4, 0), (4, 4), (0, 4)], float)


@pytest.mark.parametrize("gap", [0.0, 0.01])
def test_chains_of_touching_and_loose_pieces(gap):
    """Two squares that share a corner come back whole, in any order, even when one end falls short of it."""
    p = pieces(SQUARE, SQUARE + 4)
    p[2, 2:] -= gap
    for seed in range(5):
        order = np.random.default_rng(seed).permutation(len(p))
        strung = string(p[order], np.zeros(8, np.int64))
        found = [q[:, :2] for q in np.split(strung.pieces, strung.starts[1:-1])]
        area = sum(0.5 * float(np.sum(q[:, 0] * np.roll(q[:, 1], -1) - q[:, 1] * np.roll(q[:, 0], -1))) for q in found)
        assert sum(len(q) for q in found) == 8 and area == pytest.approx(32, abs=0.1)
        assert strung.area.sum() == pytest.approx(area, abs=0.1)
        islands, holes = strung.counts(1)
        assert islands[0] in (1, 2) and holes[0] == 0


def test_loops_do_not_depend_on_the_order_of_pieces():
    p = np.concatenate([pieces(SQUARE + 9, SQUARE, SQUARE[::-1] / 2 + 1), pieces(SQUARE, SQUARE + (7, 0))])
    layer = np.repeat([0, 3], [12, 8])
    due = string(p, layer)
    assert due.layer.tolist() == [0, 0, 0, 3, 3]
    assert due.pieces[due.starts[:-1], :2].tolist() == [[0, 0], [1, 1], [9, 9], [0, 0], [7, 0]]
    for seed in range(5):
        rng = np.random.default_rng(seed)
        order = np.concatenate([rng.permutation(12), 12 + rng.permutation(8)])
        found = string(p[order], layer)
        assert np.array_equal(found.pieces, due.pieces) and found.starts.tolist() == due.starts.tolist()


def test_loops_of_several_layers():
    """Layers that hold the same loops, one that holds nothing, and a hole."""
    p = pieces(SQUARE, SQUARE + 9, SQUARE, SQUARE[::-1] / 2 + 1)
    layer = np.repeat([0, 0, 2, 2], 4)
    strung = string(p, layer)
    assert [k.tolist() for k in strung.counts(4)] == [[2, 0, 1, 0], [0, 0, 1, 0]]
    held = Outlines(Grid(0.0, 0.0, 0.5, 100, 100))
    held.keep(np.array([0.2, 0.6, 1.0, 1.4]), strung)
    assert [len(held[z]) for z in (0.2, 0.6, 1.0, 1.4)] == [2, 0, 2, 0] and 0.3 not in held
    assert sorted(held[1.0][0].tolist()) == sorted((SQUARE / 2).tolist())


@pytest.mark.parametrize(
    ("loops", "crossed"),
    [
        ([SQUARE], 0),
        ([SQUARE[[0, 2, 1, 3]]], 1),  # a bow tie
        ([np.array([(0, 0), (4, 0), (2, 0), (6, 0), (6, 4), (0, 4)], float)], 1),  # runs back over itself
        ([SQUARE, SQUARE + (4, 0)], 0),  # two islands that share a wall
        ([SQUARE, SQUARE + 4], 0),  # and a corner
        ([SQUARE, SQUARE + 2], 1),
        ([np.array([(0, 0), (4, 0), (4, 0.0005), (4, 4), (4, 0.0002), (0, 4)], float)], 1),
    ],
)
def test_crossings(loops, crossed):
    where, places = crossings(*segments_of([[SQUARE + 100], loops]))
    assert bool(len(where)) == bool(crossed) and set(where.tolist()) <= {1}
    assert np.all(places < 100)


def made(body, folder, thickness=T):
    mesh = models.write_stl(folder / "m.stl", body.triangles())
    heights = np.arange(thickness / 2, float(body.vertices[:, 2].max()), thickness)
    regions = oracle.regions(body.triangles(), heights)
    slices = [plants.Slice(float(z), plants.clean(oracle.to_shapely(r))) for z, r in zip(heights, regions, strict=True)]
    return models.write_params(folder, mesh, scaffolding=0, thickness=thickness), slices


@pytest.mark.parametrize("kind", ["G-code PrusaSlicer", "CLI binary"])
def test_a_layer_printed_twice_on_a_gentle_slope(kind, tmp_path):
    """A contour that moves 1 mm a layer moves a little within the slack of heights: that is no narrow gap."""
    params, slices = made(models.cone(18.0, 7.2, 96), tmp_path)
    suffix, write = {**plants.AREA_WRITERS, **plants.BEAD_WRITERS}[kind]
    for k in (4, 9):
        layers, wrong = plants.layer_duplicated(None, slices, k)
        r = check(params, write(layers, tmp_path / f"a{suffix}", T))
        assert r["failed"] == wrong, r["worst"][:2]


@pytest.mark.parametrize("dialect", plants.DIALECTS)
def test_beads_of_few_points_are_aligned(dialect, tmp_path):
    """Boxes have corners only, where a distance says little about where they lie."""
    params, slices = made(plants.overhanging(), tmp_path)
    moved = [plants.Slice(k.z, plants.clean(affinity.translate(k.region, 31.7, -12.3))) for k in slices]
    r = check(params, plants.gcode(dialect)(moved, tmp_path / "a.gcode", T))
    assert r["verdict"] == "pass" and not r["failed"], r["worst"][:2]
    assert [r["alignment"]["dx"], r["alignment"]["dy"]] == pytest.approx([-31.7, 12.3], abs=0.005)
