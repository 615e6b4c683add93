"""Damaged bodies: open layers are flagged, mended and never flooded."""

import models
import numpy as np
import pytest

CLOSED = 400.0  # mm2, every layer of the whole cube
THICKNESS = 0.5
CROSSED = ("gap_x_one", "gap_x_two", "cube_flip")  # the gap lies across the rows


def damaged(name):
    return models.sliced(name, thickness=THICKNESS)


def gap(name, z):
    """Length of wall (of 20 mm) that is missing or reversed at a height: one facet of two is a triangle."""
    facet = {"gap_x_one": (0, 10.0), "gap_y_one": (1, 10.0), "cube_flip": (0, 10.0)}
    if name == "gap_x_two":
        return 20.0
    axis, value = facet[name]
    corners = models.cube().triangles()[models.wall_facets(models.cube(), axis, value)[0]]
    other = corners[:, [1 - axis, 2]].astype(float)
    cuts = []
    for a, b in zip(other, np.roll(other, -1, axis=0), strict=True):
        if (a[1] <= z) != (b[1] <= z):
            cuts.append(a[0] + (z - a[1]) / (b[1] - a[1]) * (b[0] - a[0]))
    return abs(cuts[1] - cuts[0]) if len(cuts) == 2 else 0.0


@pytest.mark.parametrize("name", [*CROSSED, "gap_y_one"])
def test_every_open_layer_is_flagged(name):
    """A gap along the rows leaves every row balanced: the end points of the segments tell all the same."""
    layers = [k for k in damaged(name) if gap(name, k.z) > 0.5]
    assert len(layers) >= 8
    for layer in layers:
        assert "open" in str(layer.stats["flags"]).split(";"), f"z {layer.z:g}: {layer.stats['flags']!r}"
        assert layer.stats["part_area_exact"] is None


@pytest.mark.parametrize("name", CROSSED)
def test_open_rows_are_counted(name):
    for layer in damaged(name):
        rows = gap(name, layer.z) / 0.2
        if rows > 3:
            assert 0.9 * rows - 2 <= layer.stats["open_rows"] <= 1.1 * rows + 4, f"z {layer.z:g}"


@pytest.mark.parametrize("name", [*CROSSED, "gap_y_one"])
def test_layers_are_never_flooded(name):
    """Nothing lies farther out than the body; no layer is larger than it."""
    layers = damaged(name)
    assert len(layers) == 12
    points = 0
    for layer in layers:
        assert layer.stats["part_area"] <= 1.02 * CLOSED
        assert np.abs(layer.part.points).max(initial=0) <= 10.4
        assert np.abs(layer.scaffold.points).max(initial=0) <= 15.4
        points += len(layer.part.points)
    assert points >= 12 * 4


@pytest.mark.parametrize("name", ["gap_x_one", "gap_y_one", "cube_flip"])
def test_mended_area_is_close(name):
    """Where at most half a wall is gone, the neighbours give the area back."""
    layers = [k for k in damaged(name) if gap(name, k.z) <= 10.0]
    assert len(layers) >= 5
    for layer in layers:
        assert layer.stats["part_area"] == pytest.approx(CLOSED, rel=0.02), f"z {layer.z:g}"


def test_sound_bodies_are_not_flagged():
    for name in ("cube", "two_boxes", "box_cavity", "touching_boxes", "touching_unequal"):
        layers = models.sliced(name, thickness=0.5)
        assert len(layers) >= 3
        for layer in layers:
            assert layer.stats["open_rows"] == 0, name
            assert "open" not in str(layer.stats["flags"]).split(";"), name


@pytest.mark.parametrize("rule", ["nonzero", "evenodd"])
def test_no_exact_area_where_shells_are_inside_out_or_doubled(tmp_path, rule):
    """The shoelace sum counts an inverted shell as negative and a doubled one twice: it must be blank."""
    box = models.box((0, 0, 0), (10, 10, 3))
    cases = {
        "inverted": [box.triangles(), box.inverted().moved((20.0, 0, 0)).triangles()],
        "doubled": [box.triangles(), box.triangles()],
        "inner": [box.triangles(), models.box((3, 3, 0.6), (6, 6, 2.4)).triangles()],
    }
    for name, parts in cases.items():
        path = models.write_stl(tmp_path / f"{name}.stl", np.concatenate(parts))
        layers = models.slice_file(path, thickness=0.5, winding=rule)
        middle = [k for k in layers if 0.7 < k.z < 2.3]
        assert middle
        for layer in middle:
            assert layer.stats["part_area_exact"] is None, name
            assert "overlap" in layer.stats["flags"] and "area" not in layer.stats["flags"], name


def test_a_part_that_no_path_reaches_is_flagged(tmp_path):
    """A wall thinner than the path has no path: that is a flag and a warning."""
    path = models.write_stl(tmp_path / "wall.stl", models.box((0, 0, 0), (40, 0.7, 2)).triangles())
    slicing = models.prepare_file(path, thickness=0.5)
    layers = list(slicing.layers())
    assert all(k.stats["flags"] == "lost" for k in layers)
    assert all(k.stats["lost_area"] <= k.stats["part_area"] for k in layers)
    assert any("no path reaches" in w for w in slicing.warnings)


def test_no_part_at_all_is_a_warning(tmp_path):
    path = models.write_stl(tmp_path / "inverted.stl", models.box((0, 0, 0), (8, 8, 2)).inverted().triangles())
    slicing = models.prepare_file(path, thickness=0.5, winding="positive")
    assert sum(k.stats["part_area"] for k in slicing.layers()) == 0
    assert any("no layer holds any part" in w for w in slicing.warnings)
