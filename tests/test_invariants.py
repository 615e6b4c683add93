"""What must not change the result, and what every result must hold."""

import models
import numpy as np
import oracle
import pytest

from rasterslice import contour
from rasterslice.device import Device

QUANTUM = 1 / 128  # px
PATHS = ("part", "scaffold", "part_boundary", "scaffold_boundary", "part_fill", "scaffold_fill")
BOUNDARIES = ("part_boundary", "scaffold_boundary")
REGIONS = ("part", "scaffold")
CASES = ("two_boxes", "ball_on_stem")
SETTINGS = {"thickness": 0.7}


def assert_same(found, wanted):
    """Hold two runs byte for byte."""
    assert len(found) == len(wanted) > 3
    points = 0
    for a, b in zip(found, wanted, strict=True):
        assert (a.index, a.z, a.stats) == (b.index, b.z, b.stats)
        for name in PATHS:
            p, q = getattr(a, name), getattr(b, name)
            assert p.points.tobytes() == q.points.tobytes(), f"layer {a.index}: {name}"
            assert p.offsets.tobytes() == q.offsets.tobytes(), f"layer {a.index}: {name}"
            points += len(p.points)
    assert points > 1000


def assert_shifted(found, wanted, shift, tolerance, names=PATHS):
    """Hold the paths of two runs against each other, one being shifted in x and y."""
    assert len(found) == len(wanted) > 3
    points = 0
    for a, b in zip(found, wanted, strict=True):
        for name in names:
            p, q = getattr(a, name), getattr(b, name)
            np.testing.assert_array_equal(p.offsets, q.offsets, err_msg=f"layer {a.index}: {name}")
            np.testing.assert_allclose(
                p.points - shift, q.points, rtol=0, atol=tolerance, err_msg=f"layer {a.index}: {name}"
            )
            points += len(p.points)
    assert points > 1000


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("batch", [1, 2, 7])
def test_same_bytes_for_any_batch(name, batch):
    found = models.slice_body(models.body(name), {"batch": batch}, **SETTINGS)
    assert_same(found, models.sliced(name, **SETTINGS))


@pytest.mark.parametrize("name", [*CASES, "pillars", "star", "nested_shells", "fin", "sphere"])
def test_same_bytes_for_one_contour_and_for_sixteen_side_by_side(name, monkeypatch):
    used, run = set(), Device.run

    def noted(device, kernel, *rest, **more):
        used.add(kernel)
        run(device, kernel, *rest, **more)

    monkeypatch.setattr(Device, "run", noted)
    found = []
    for kernel, lanes in (("follow_contours", 10**6), ("follow_lanes", 0)):
        monkeypatch.setattr(contour, "LANES", lanes)
        used.clear()
        found.append(models.slice_body(models.body(name), thickness=0.35, pitch=0.1))
        assert used & {"follow_contours", "follow_lanes"} == {kernel}
    assert_same(*found)


def test_same_bytes_twice():
    found = models.slice_body(models.body("two_boxes"), **SETTINGS)
    assert_same(found, models.sliced("two_boxes", **SETTINGS))


@pytest.mark.parametrize("name", CASES)
def test_both_mappings(name):
    """Kernels mapped as for a GPU give equal loops, and points within two quanta."""
    gpu = models.slice_body(models.body(name), {"mapping": "gpu"}, **SETTINGS)
    assert_shifted(gpu, models.sliced(name, **SETTINGS), 0.0, 2 * QUANTUM * 0.2)


def test_processors_with_other_instructions(monkeypatch):
    """What kernels do where instructions of x86 are not known gives the same."""
    from rasterslice import opening

    known = opening.compose()
    assert "__AVX512F__" in known and "__SSE2__" in known
    plain = known.replace("__AVX512F__", "NO_SUCH_INSTRUCTIONS").replace("__SSE2__", "NO_SUCH_INSTRUCTIONS")
    monkeypatch.setattr(opening, "compose", lambda: plain)
    for name in CASES:
        assert_same(models.slice_body(models.body(name), **SETTINGS), models.sliced(name, **SETTINGS))


# ---------------------------------------------------------------- shifts
@pytest.fixture(scope="module")
def at_home():
    """Bodies with vertices on multiples of 2^-7 mm at the origin, pitch 0.25."""
    return {n: models.slice_body(rough(n), pitch=0.25, **SETTINGS) for n in CASES}


def rough(name):
    return models.body(name).rounded(2.0**-7)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("pixels", [(7, -13), (-160, 33)])
def test_shift_by_whole_pixels(name, pixels, at_home):
    """Only fill lines may change: they belong to the frame and not to the body."""
    shift = np.array(pixels) * 0.25
    moved = models.slice_body(rough(name).moved((*shift, 0)), pitch=0.25, **SETTINGS)
    assert_shifted(moved, at_home[name], shift, 1e-9, REGIONS + BOUNDARIES)
    for a, b in zip(moved, at_home[name], strict=True):
        assert a.stats["flags"] == b.stats["flags"]
        for key in ("part_area", "scaffold_area", "part_points", "scaffold_points", "open_rows"):
            assert a.stats[key] == pytest.approx(b.stats[key], rel=1e-12), key


@pytest.mark.parametrize("name", CASES)
def test_shift_by_whole_pixels_and_whole_lines(name, at_home):
    """A shift by multiples of the path width as well moves the fill lines too."""
    shift = np.array((7.5, -4.5))
    moved = models.slice_body(rough(name).moved((*shift, 0)), pitch=0.25, **SETTINGS)
    assert_shifted(moved, at_home[name], shift, 1e-9)


FAR = 99999.0  # 1e5 mm, and a multiple of 0.25, 0.2 and 1.5


@pytest.mark.parametrize("name", CASES)
def test_far_from_the_origin(name, at_home):
    """Vertices at 1e5 mm in the file, on all three axes (float32 holds multiples of 2^-7 there)."""
    far = models.slice_body(rough(name).moved((FAR, -FAR, FAR)), pitch=0.25, **SETTINGS)
    assert [k.z for k in far] == pytest.approx([k.z for k in at_home[name]], abs=1e-9)
    assert_shifted(far, at_home[name], np.array((FAR, -FAR)), 1e-9)


def test_sent_far_by_translation():
    """The parameter file puts it there; pitch 0.2, which float64 does not hold exactly: within two quanta."""
    here = models.slice_body(rough("ball_on_stem"), translation=(1, 0, 0, 0), **SETTINGS)
    far = models.slice_body(rough("ball_on_stem"), translation=(1, FAR, FAR, FAR), **SETTINGS)
    assert [k.z - FAR for k in far] == pytest.approx([k.z for k in here], abs=1e-9)
    assert_shifted(far, here, FAR, 2 * QUANTUM * 0.2, REGIONS + BOUNDARIES)


def test_mirror():
    """A mirrored body has mirrored areas: no axis or sense is preferred."""
    one, other = models.sliced("ball_on_stem", **SETTINGS), models.sliced("ball_mirrored", **SETTINGS)
    assert len(one) == len(other) > 10
    for a, b in zip(one, other, strict=True):
        for key in ("part_area", "scaffold_area"):
            assert a.stats[key] == pytest.approx(b.stats[key], rel=1e-4, abs=1e-3), f"z {a.z:g}: {key}"


# ---------------------------------------------------------------- every contour
SHAPES = {
    "ball_on_stem": SETTINGS,
    "two_boxes": SETTINGS,
    "torus": {"thickness": 0.5},
    "star": {"thickness": 0.5},
    "pillars": {"thickness": 0.5},
    "box_cavity": {"thickness": 0.5},
    "fin": {"thickness": 0.5},
    "stepped_pyramid": {"thickness": 0.5},
}


@pytest.mark.parametrize("name", SHAPES)
def test_regions_are_closed_simple_disjoint_and_oriented(name):
    loops = 0
    for layer in models.sliced(name, **SHAPES[name]):
        for which in REGIONS:
            paths = getattr(layer, which)
            assert paths.closed
            contours = list(paths)
            loops += len(contours)
            where = f"z {layer.z:g}: {which}"
            assert all(oracle.is_simple(p) for p in contours), where
            assert not contours or oracle.disjoint(contours), where
            assert not oracle.wrongly_oriented(contours), where
    assert loops >= len(models.sliced(name, **SHAPES[name]))


@pytest.mark.parametrize("name", SHAPES)
def test_boundaries_are_closed_simple_oriented_and_spaced(name):
    loops = 0
    for layer in models.sliced(name, **SHAPES[name]):
        for which in BOUNDARIES:
            paths = getattr(layer, which)
            assert paths.closed
            contours = list(paths)
            loops += len(contours)
            where = f"z {layer.z:g}: {which}"
            assert all(oracle.is_simple(p) for p in contours), where
            assert not oracle.wrongly_oriented(contours), where
            assert oracle.spacing(contours) >= 0.2 - 1e-9, where
    assert loops > 3


def test_point_spacing_is_obeyed():
    layers = models.slice_body(models.body("ball_on_stem"), min_point_spacing=0.8, **SETTINGS)
    contours = [p for k in layers for which in BOUNDARIES for p in getattr(k, which)]
    assert len(contours) > 10
    assert all(oracle.is_simple(p) for p in contours)
    assert oracle.spacing(contours) >= 0.8 - 1e-9


def test_totals_of_a_layer_are_those_of_its_paths():
    judged = 0
    for layer in models.sliced("ball_on_stem", **SETTINGS):
        for which in BOUNDARIES:
            length = getattr(layer, which).lengths().sum()
            assert layer.stats[f"{which}_mm"] == pytest.approx(length, abs=1e-3)
            judged += length > 0
        for which in ("part", "scaffold"):
            fill = getattr(layer, f"{which}_fill").lengths().sum()
            assert layer.stats[f"{which}_fill_mm"] == pytest.approx(fill, abs=1e-3)
    assert judged > 10


def test_batches_that_mix_tangled_and_clean_layers(tmp_path):
    """A layer must not change because another layer of its batch is open or overlaps."""
    ball = models.sphere(9.0)
    keep = np.random.default_rng(3).random(len(ball.triangles())) > 0.02
    ring = models.sphere(4.0).moved((6.0, 0.0, 4.0))
    triangles = np.concatenate([ball.triangles()[keep], ring.triangles()])
    path = models.write_stl(tmp_path / "mixed.stl", triangles)
    one, seven, all_of_them = (models.slice_file(path, {"batch": n}, thickness=0.5) for n in (1, 7, 24))
    flags = [str(k.stats["flags"]) for k in one]
    assert any("overlap" in f for f in flags) and any("open" in f for f in flags)
    for other in (seven, all_of_them):
        assert [k.stats for k in other] == [k.stats for k in one]
        for a, b in zip(one, other, strict=True):
            for name in ("part", "scaffold", "part_boundary", "scaffold_boundary", "part_fill", "scaffold_fill"):
                np.testing.assert_array_equal(getattr(a, name).points, getattr(b, name).points)
