"""The part's own contour keeps the corners of the source segments to 0.1 px."""

import models
import numpy as np
import oracle
import pytest
import shapely
from scipy.spatial import cKDTree

LIMIT = 0.1 * 0.2  # mm


def corner_errors(layers, triangles):
    """Return the distance of every corner of the exact sections from the nearest contour vertex.

    Where two shells cross, the union has a crease but no source segment has a corner: left out.
    """
    errors = []
    for layer, loops in zip(layers, oracle.slice_loops(triangles, [k.z for k in layers]), strict=True):
        places = oracle.corners(oracle.polygons(oracle.region(loops)))
        of_segments = cKDTree(np.concatenate(loops)).query(places)[0] < 1e-6
        errors.append(cKDTree(layer.part.points).query(places[of_segments])[0])
    return np.concatenate(errors)


@pytest.mark.parametrize("angle", [30, 60, 90, 120, 150])
def test_wedges(angle):
    """Apex angles from sharp to flat, turned so that no edge lies along the grid."""
    errors = []
    for turn in (0.0, 13.0, 45.0, 101.7, 233.3):
        body = models.wedge(angle, turn).moved((0.037 * turn, 0.11, 0))
        layers = models.slice_body(body, thickness=0.5, scaffolding=0)
        errors.append(corner_errors(layers, body.triangles()))
    errors = np.concatenate(errors)
    assert len(errors) >= 30
    assert errors.max() <= LIMIT


BODIES = (
    "star",
    "frame",
    "tilted_box",
    "two_boxes",
    "stepped_pyramid",
    "plate",
    "long_bar",
    "touching_unequal",
)


@pytest.mark.parametrize("name", BODIES)
def test_bodies(name):
    """Acute and reflex corners, on and off the grid."""
    layers = models.sliced(name, thickness=1.0 if name == "tilted_box" else 0.5)
    errors = corner_errors(layers, models.triangles(name))
    assert len(errors) >= 12
    assert errors.max() <= LIMIT


def test_contour_adds_no_corners():
    """A smooth contour stays smooth: putting corners back must not dent a circle."""
    layers = [k for k in models.sliced("sphere", thickness=1.0) if abs(k.z - 15.0) < 12.0]
    assert len(layers) >= 20
    for layer in layers:
        assert len(oracle.corners(list(layer.part))) == 0, f"z {layer.z:g}"


def ribbon(rng, width):
    """Return a zigzag band of one width, corners sharp on both sides."""
    steps = rng.uniform(0.4, 1.5, 30)
    line = np.column_stack([np.cumsum(steps * 0.5), steps * np.where(np.arange(30) % 2, 1, -1)])
    band = shapely.LineString(line).buffer(width / 2, cap_style="flat", join_style="mitre", mitre_limit=20)
    polygons = [shapely.geometry.polygon.orient(p) for p in getattr(band, "geoms", [band])]
    return [np.asarray(ring.coords)[:-1] for p in polygons for ring in (p.exterior, *p.interiors)]


@pytest.mark.parametrize("width", [0.05, 0.1, 0.15, 0.2, 0.3])
def test_corners_of_thin_tongues_do_not_cross(width):
    """In a tongue thinner than a pixel, corners of both sides may lie beyond each other, or empty a loop."""
    rng, loops = np.random.default_rng(7), 0
    for _ in range(12):
        body = models.prism(ribbon(rng, width), 0.0, 1.0)
        for layer in models.slice_body(body, thickness=0.5, scaffolding=0, tolerance=1.0):
            loops += len(layer.part)
            assert all(len(loop) >= 3 and shapely.LinearRing(loop).is_simple for loop in layer.part)
    assert loops >= 24
