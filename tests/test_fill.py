"""Fill lines against hatch lines that shapely clips to the exact inset."""

import models
import numpy as np
import oracle
import pytest

WIDTHS = (1.5, 2.0)
END_LIMIT = 0.05  # mm, for lines that do not graze and end away from corners
GRAZE = (
    0.01  # mm: a line that changes by more than END_LIMIT when it is lifted by this much grazes the contour
)
LONG = 2.0  # mm: shorter lines may lie in a corner's tip or graze the contour
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


def angle_of(layer, angles=(0.0, 90.0)):
    return angles[layer.index % len(angles)]


def exact_insets(name, layers):
    """Return {kind: insets by layer} of a body's part and scaffold."""
    parts = oracle.regions(models.triangles(name), [k.z for k in layers])
    above = oracle.unions_from_top(parts, range(len(parts)))
    scaffolds = [oracle.scaffold(above[k], parts[k], 5.0) for k in range(len(parts))]
    return {
        kind: [oracle.grow(s, -w / 2) for s in shapes]
        for kind, shapes, w in (("part", parts, WIDTHS[0]), ("scaffold", scaffolds, WIDTHS[1]))
    }


def along_row(j, ends, width, angle):
    """Put ends along their rows back into the plane: (n, 2, 2)."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    v = (np.asarray(j)[:, None] + 0.5) * width
    return np.stack([ends * c - v * s, ends * s + v * c], axis=2)


def partnered(j, ends, others_j, others, limit):
    """Whether each line has a partner in the other set: same row, both ends within a limit."""
    return np.array(
        [
            np.abs(others[others_j == row] - two).max(axis=1).min(initial=np.inf) <= limit
            for row, two in zip(j, ends, strict=True)
        ],
        bool,
    )


def judge(found, inset, width, angle):
    """Hold found (j, ends) against the exact hatch both ways; return how many were judged, and those without
    a partner. Short lines, lines that end near corners and lines that graze are not judged."""
    exact = oracle.hatch(inset, width, angle)
    lifted = [oracle.hatch(inset, width, angle, lift) for lift in (-GRAZE, GRAZE)]
    places = oracle.corners(oracle.polygons(inset))
    judged, missing = 0, []
    for (j, ends), other in ((found, exact), (exact, found)):
        steady = ends[:, 1] - ends[:, 0] >= LONG
        steady &= (
            oracle.away(along_row(j, ends, width, angle).reshape(-1, 2), places).reshape(-1, 2).all(axis=1)
        )
        if other is found:
            steady &= np.all([partnered(j, ends, *two, END_LIMIT) for two in lifted], axis=0)
        else:  # a found line that no neighbour row of the exact shape has is wrong; one that only some have grazes
            ghosts = [partnered(j, ends, *two, 2 * END_LIMIT) for two in (*lifted, exact)]
            steady &= np.all(ghosts, axis=0) | ~np.any(ghosts, axis=0)
        good = partnered(j, ends, *other, END_LIMIT)
        judged += int(steady.sum())
        missing += [(int(j[i]), ends[i].round(3).tolist()) for i in np.flatnonzero(steady & ~good)]
    return judged, missing


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", CASES)
def test_lines_are_those_of_the_hatch(name, kind):
    layers = models.sliced(name, widths=WIDTHS, **CASES[name])
    insets = exact_insets(name, layers)[kind]
    width = WIDTHS[KINDS.index(kind)]
    judged = 0
    for layer, inset in zip(layers, insets, strict=True):
        angle = angle_of(layer)
        j, ends, off = oracle.along(lines(getattr(layer, f"{kind}_fill")), width, angle)
        assert off.max(initial=0.0) < 1e-6, f"z {layer.z:g}: a line lies off (j + 1/2) width"
        count, missing = judge((j, ends), inset, width, angle)
        assert not missing, f"z {layer.z:g}: {missing[:4]}"
        judged += count
    if kind == "part" or any(not i.is_empty() for i in insets):
        assert judged > 40
    else:
        assert all(len(k.scaffold_fill) == 0 for k in layers)


def test_directions_alternate():
    layers = models.sliced("frame", widths=WIDTHS, **CASES["frame"])
    assert len(layers) >= 4
    for layer in layers:
        step = lines(layer.part_fill)[:, 1] - lines(layer.part_fill)[:, 0]
        assert len(step) >= 8
        assert np.abs(step[:, 1 if layer.index % 2 == 0 else 0]).max() < 1e-9


@pytest.mark.parametrize("angles", [(30.0,), (45.0, -45.0), (0.0, 60.0, 120.0)])
def test_any_angles(angles):
    """Each layer takes the next of the angles; rows stay at (j + 1/2) width along the line's normal."""
    layers = models.slice_body(models.body("plate"), fill_angles=angles, thickness=0.5, scaffolding=0)
    judged = 0
    for layer in layers:
        angle = angle_of(layer, angles)
        loops = oracle.slice_loops(models.triangles("plate"), [layer.z])[0]
        inset = oracle.grow(oracle.region(loops), -0.75)
        j, ends, off = oracle.along(lines(layer.part_fill), 1.5, angle)
        assert off.max() < 1e-6
        count, missing = judge((j, ends), inset, 1.5, angle)
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
