"""Fill lines against hatch lines that shapely clips: to the layer's own paths, and to the exact inset."""

import models
import numpy as np
import oracle
import pytest

WIDTHS = (1.5, 2.0)
OWN_LIMIT = 1e-3  # mm, along the line, against the boundary path that it is clipped to
EXACT_LIMIT = 0.05 + 0.004  # mm, across the contour, against the exact one: decimation and 0.02 px
GRAZE = 1e-4  # mm: a line that has no partner when it is lifted by this much grazes the path
SHORT = 0.3  # mm: shorter lines may or may not be dropped as stumps
CORNER = 1.5  # mm: creases of acute insets are cut; the documentation states by how much

CASES = {
    "frame": {"thickness": 0.5},
    "plate": {"thickness": 0.5},
    "star": {"thickness": 0.5},
    "tilted_box": {"thickness": 1.0},
    "sphere": {"thickness": 1.0},
}
KINDS = ("part", "scaffold")


def lines(paths):
    assert not paths.closed
    assert (np.diff(paths.offsets) == 2).all()
    return paths.points.reshape(-1, 2, 2)


def angle_of(layer, kind="part", angles=(0.0, 90.0), ice=0, n=2):
    """The angles are taken one after the other: by ice layers, of which a slice has n, and by slices of scaffold."""
    number = n * layer.index + ice if kind == "part" else layer.index
    return angles[number % len(angles)]


def exact_insets(name, layers):
    """Return {kind: insets by layer} of a body's part and scaffold."""
    parts = oracle.regions(models.triangles(name), [k.z for k in layers])
    above = oracle.unions_from_top(parts, range(len(parts)))
    scaffolds = [oracle.scaffold(above[k], parts[k], 5.0) for k in range(len(parts))]
    return {
        kind: [oracle.grow(s, -w / 2) for s in shapes]
        for kind, shapes, w in (("part", parts, WIDTHS[0]), ("scaffold", scaffolds, WIDTHS[1]))
    }


def partnered(j, ends, others_j, others, limit):
    """Whether each line has a partner in the other set: same row, both ends within a limit."""
    return np.array(
        [
            np.abs(others[others_j == row] - two).max(axis=1).min(initial=np.inf) <= limit
            for row, two in zip(j, ends, strict=True)
        ],
        bool,
    )


def judge(found, shape, width, angle, limit=OWN_LIMIT):
    """Hold found (j, ends) against the hatch of a shape, both ways.

    Return how many were judged and those without a partner; lines that graze and stumps are not judged.
    """
    exact = oracle.hatch(shape, width, angle)
    lifted = [oracle.hatch(shape, width, angle, lift) for lift in (-GRAZE, GRAZE)]
    judged, missing = 0, []
    for (j, ends), other in ((found, exact), (exact, found)):
        states = np.array([partnered(j, ends, *two, 20 * limit) for two in (*lifted, exact)])
        steady = (states == states[0]).all(axis=0) & (ends[:, 1] - ends[:, 0] >= SHORT)
        good = partnered(j, ends, *other, limit)
        judged += int(steady.sum())
        missing += [(int(j[i]), ends[i].round(4).tolist()) for i in np.flatnonzero(steady & ~good)]
    return judged, missing


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", CASES)
def test_lines_fill_the_boundary_paths(name, kind):
    """Every line of the hatch of the layer's own boundary paths, and no other."""
    width = WIDTHS[KINDS.index(kind)]
    judged = 0
    for layer in models.sliced(name, widths=WIDTHS, **CASES[name]):
        angle = angle_of(layer, kind)
        boundary = oracle.region(list(getattr(layer, f"{kind}_boundary")))
        j, ends, off = oracle.along(lines(getattr(layer, f"{kind}_fill")), width, angle)
        assert off.max(initial=0.0) < 1e-6, f"z {layer.z:g}: a line lies off (j + 1/2) width"
        count, missing = judge((j, ends), boundary, width, angle)
        assert not missing, f"z {layer.z:g}: {missing[:4]}"
        judged += count
    assert judged > 40


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", CASES)
def test_lines_end_on_the_exact_inset(name, kind):
    """Ends lie on the inset of the exact polygons, and the lines together are as long as its hatch."""
    layers = models.sliced(name, widths=WIDTHS, **CASES[name])
    width = WIDTHS[KINDS.index(kind)]
    judged = 0
    for layer, inset in zip(layers, exact_insets(name, layers)[kind], strict=True):
        fill = getattr(layer, f"{kind}_fill")
        exact = oracle.polygons(inset)
        free = oracle.away(fill.points, oracle.corners(exact), CORNER)
        gap = oracle.distance(fill.points[free], exact)
        assert gap.max(initial=0.0) <= EXACT_LIMIT, f"z {layer.z:g}"
        total = np.ptp(oracle.hatch(inset, width, angle_of(layer, kind))[1], axis=1).sum()
        assert fill.lengths().sum() == pytest.approx(total, rel=0.01, abs=3.0), f"z {layer.z:g}"
        judged += len(gap)
    assert judged > 40


def headings(layers, n):
    """Return the direction of each ice layer from the bottom up, degrees, 0 to 180."""
    found = []
    for k in layers:
        for ice in range(n):
            step = np.diff(lines(k.ice_fill(ice)), axis=1)[:, 0]
            way = np.degrees(np.arctan2(step[:, 1], step[:, 0])) % 180
            assert np.ptp(way) < 1e-6
            found.append(round(float(way[0]), 6) % 180)
    return found


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_directions_turn_on_each_ice_layer(n):
    """H V H V over the ice layers, however many of them a slice has; so does the scaffold over the slices."""
    layers = models.slice_body(models.body("frame"), thickness=0.5, part_layers_per_slice=n)
    assert len(layers) >= 4
    assert headings(layers, n) == ([0, 90] * n * len(layers))[: n * len(layers)]
    for layer in layers:
        step = np.diff(lines(layer.scaffold_fill), axis=1)[:, 0]
        assert not len(step) or np.abs(step[:, 1 - layer.index % 2]).max() < 1e-9


def test_three_directions_over_two_ice_layers():
    layers = models.slice_body(models.body("plate"), fill_angles=(0, 60, 120), thickness=0.5, scaffolding=0)
    assert headings(layers, 2)[:6] == [0, 60, 120, 0, 60, 120]


@pytest.mark.parametrize("ice", [0, 1])
@pytest.mark.parametrize("angles", [(30.0,), (45.0, -45.0), (0.0, 60.0, 120.0)])
def test_any_angles(angles, ice):
    """Each ice layer takes the next of the angles; rows stay at (j + 1/2) width along the line's normal."""
    layers = models.slice_body(models.body("plate"), fill_angles=angles, thickness=0.5, scaffolding=0)
    judged = 0
    for layer in layers:
        angle = angle_of(layer, "part", angles, ice)
        j, ends, off = oracle.along(lines(layer.ice_fill(ice)), 1.5, angle)
        assert off.max() < 1e-6
        count, missing = judge((j, ends), oracle.region(list(layer.part_boundary)), 1.5, angle)
        assert not missing, f"layer {layer.index}, {angle:g} degrees: {missing[:4]}"
        judged += count
    assert judged > 40


def test_fill_inset_shortens_both_ends():
    plain = models.sliced("cube", thickness=0.5, scaffolding=0)
    short = models.sliced("cube", thickness=0.5, scaffolding=0, fill_inset=0.6)
    assert len(plain) == len(short) >= 4
    for a, b in zip(plain, short, strict=True):
        first, second = (oracle.along(lines(k.part_fill), 1.5, angle_of(k))[:2] for k in (a, b))
        assert len(first[0]) >= 12
        np.testing.assert_array_equal(first[0], second[0])
        np.testing.assert_allclose(second[1] - first[1], np.tile((0.6, -0.6), (len(first[0]), 1)), atol=1e-3)
        np.testing.assert_array_equal(a.part_boundary.points, b.part_boundary.points)


def test_no_stumps():
    """No line is shorter than the controller's point spacing, with and without an inset."""
    for inset in (0.0, 0.9):
        layers = models.sliced("star", thickness=0.5, fill_inset=inset)
        lengths = np.concatenate([k.part_fill.lengths() for k in layers])
        assert len(lengths) > 40
        assert lengths.min() >= 0.2 - 1e-9


def test_boundaries_only():
    layers = models.slice_body(models.body("frame"), option=1, thickness=0.5)
    assert len(layers) >= 4
    assert all(len(k.part_fill) == len(k.scaffold_fill) == 0 for k in layers)
    assert all(len(k.part_boundary) == 2 for k in layers)
