"""check: whether supports of other programs hold every overhang, and what their beads leave bare."""

import re
import shutil
import subprocess
import types

import models
import numpy as np
import oracle
import plants
import pytest
from shapely.geometry import MultiPolygon, Point

from rasterslice.check import support
from rasterslice.check.align import Alignment
from rasterslice.check.form import SUPPORT, TheirLayer, pack_beads
from rasterslice.check.picture import Canvas, distance
from rasterslice.check.posts import Posts
from rasterslice.check.run import check
from rasterslice.check.support import Holding
from rasterslice.cli import main
from rasterslice.grid import Grid

T = 0.4
WRITERS = {**plants.AREA_WRITERS, **plants.BEAD_WRITERS}


@pytest.fixture(scope="module")
def tops(tmp_path_factory):
    """Give a parameter file of two table tops, and its true slices with supports."""
    folder = tmp_path_factory.mktemp("tops")
    body = plants.overhanging()
    mesh = models.write_stl(folder / "tops.stl", body.triangles())
    heights = np.arange(T / 2, 10.3, T)
    regions = oracle.regions(body.triangles(), heights)
    slices = [plants.Slice(float(z), plants.clean(oracle.to_shapely(r))) for z, r in zip(heights, regions, strict=True)]
    return models.write_params(folder, mesh, scaffolding=0, thickness=T), plants.supported(slices), folder


def overhangs(slices):
    return [k for k in range(4, len(slices)) if plants.support_missing(np.random.default_rng(0), slices, k)]


@pytest.mark.parametrize("kind", plants.CARRIES_SUPPORT)
def test_whole_supports_pass_and_broken_ones_fail(kind, tops, tmp_path):
    params, slices, _ = tops
    suffix, write = WRITERS[kind]
    r = check(params, write(slices, tmp_path / f"whole{suffix}", T))
    assert r["verdict"] == "pass" and not r["failed"]
    assert any("overhangs less steep than 40 degrees" in note for note in r["notes"])
    rng = np.random.default_rng(4)
    for k in overhangs(slices):
        broken, wrong = plants.support_missing(rng, slices, k)
        assert plants.unheld(broken, k, 1.5, 0.1)
        r = check(params, write(broken, tmp_path / f"broken{suffix}", T))
        assert r["failed"] == wrong, r["worst"][:2]
        worst = r["worst"][0]
        assert worst["reasons"].startswith("overhang without support at")
        assert 0.6 < worst["unheld_piece"] <= worst["unheld"] <= worst["overhang"]
        place = Point(worst["unheld_x"], worst["unheld_y"])
        assert slices[k].region.buffer(0.2).contains(place)
        assert not slices[k - 1].region.contains(place)


def test_limits_of_supports(tops, tmp_path):
    """Without any support overhangs are checked only when asked for; gap, reach and angle are what the user says."""
    params, slices, _ = tops
    bare = plants.cli_ascii([plants.Slice(k.z, k.region) for k in slices], tmp_path / "bare.cli", T)
    assert check(params, bare)["verdict"] == "pass"
    assert check(params, bare, holding=Holding())["failed"] == overhangs(slices)
    assert check(params, bare, holding=Holding(reach=0.0, gap=100.0))["failed"] == overhangs(slices)
    low = [plants.Slice(k.z, k.region, support=k.support if k.z < 2 else MultiPolygon()) for k in slices]
    path = plants.cli_ascii(low, tmp_path / "low.cli", T)
    assert check(params, path)["failed"] == overhangs(slices)
    assert check(params, path, holding=Holding(gap=6.0))["failed"] == overhangs(slices)[1:]
    near = plants.cli_ascii(slices, tmp_path / "near.cli", T)
    away = plants.cli_ascii(plants.supported(slices, 2.0), tmp_path / "away.cli", T)
    assert check(params, away, holding=Holding(reach=0.5))["failed"] == overhangs(slices)
    assert check(params, away, holding=Holding(reach=2.0))["verdict"] == "pass"
    assert check(params, away, holding=Holding(reach=0.5, angle=12.0))["verdict"] == "pass"
    assert main(["check", str(params), "--against", str(near), "--support", "2,3,40", "--json"]) == 0
    for wrong in ("2,3", "-1,3,40", "2,3,90", "a,b,c"):
        assert main(["check", str(params), "--against", str(near), "--support", wrong]) == 2


def test_a_missing_scaffold_is_asked_for(tmp_path):
    mesh = models.write_stl(tmp_path / "tops.stl", plants.overhanging().triangles())
    params = models.write_params(tmp_path, mesh, scaffolding=1, thickness=T)
    slices = [plants.Slice(T / 2, plants.clean(MultiPolygon([Point(0, 0).buffer(2, quad_segs=1)])))]
    r = check(params, plants.cli_ascii(slices, tmp_path / "a.cli", T))
    assert any("the file has no supports" in note for note in r["notes"])


BODIES = {
    "tops": plants.overhanging,
    "ball": models.ball_on_stem,
    "tilted": lambda: models.box((-6, -6, 0), (6, 6, 24)).turned(58, 12, 0),
}


@pytest.mark.parametrize("program", ["slic3r", "prusa-slicer"])
@pytest.mark.parametrize("name", BODIES)
def test_supports_of_real_slicers(program, name, tmp_path):
    """No false alarm; with the support beads taken out, the overhangs are found."""
    if not shutil.which(program):
        pytest.skip(f"no {program}")
    mesh = models.write_stl(tmp_path / "m.stl", BODIES[name]().grounded().triangles())
    params, out = models.write_params(tmp_path, mesh, scaffolding=1, thickness=T), tmp_path / "out.gcode"
    flags = ["--layer-height", str(T), "--first-layer-height", str(T), "--nozzle-diameter", "0.6", "--support-material"]
    for what in ("", "external-perimeter-", "first-layer-"):
        flags += [f"--{what}extrusion-width", "0.8"]
    if program == "slic3r":
        flags += ["--gcode-comments"]
    else:
        flags += ["-g", "--elefant-foot-compensation", "0", "--skirts", "0", "--dont-support-bridges=0"]
    subprocess.run([program, *flags, "-o", str(out), str(mesh)], check=True, capture_output=True, timeout=120)
    r = check(params, out)
    assert r["verdict"] == "pass" and not r["failed"], r["worst"][:2]
    assert len(r["cannot_tell"]) <= 0.15 * r["layers"]
    text, support = out.read_text().splitlines(), False
    for i, line in enumerate(text):
        if line.startswith(";TYPE:"):
            support = "Support" in line
        if (support or "; support material" in line) and re.match(r"G1 .*[XY]", line):
            text[i] = re.sub(r" E[-0-9.]+", "", line)
    out.write_text("\n".join(text) + "\n")
    r = check(params, out, holding=Holding())
    assert r["verdict"] == "fail"
    assert all("overhang" in w["reasons"] for w in r["worst"] if w["verdict"] == "fail")


def test_what_beads_leave_bare(tops, tmp_path):
    """Area that no bead reaches, overlap and XOR of beads, against polygons."""
    params, slices, _ = tops
    rows = check(params, plants.gcode("PrusaSlicer")(slices, tmp_path / "a.gcode", T), out=tmp_path / "out")
    assert rows["verdict"] == "pass"
    lines = (tmp_path / "out" / "check.csv").read_text().splitlines()
    names = lines[0].split(",")
    for k in (0, 11, 24):
        row = dict(zip(names, lines[1 + k].split(","), strict=False))
        walls, fill = plants.beads_of(slices[k], 0.8)
        beads = MultiPolygon()
        for line in [*walls, *fill]:
            beads = beads.union(plants.shapely.LineString(line).buffer(0.4))
        bare = slices[k].region.difference(beads)
        assert float(row["bare"]) == pytest.approx(bare.area, abs=0.05 * bare.area + 0.01 * slices[k].region.length)
        largest = max((p.area for p in getattr(bare, "geoms", [bare])), default=0.0)
        assert float(row["bare_piece"]) <= 1.1 * largest + 0.2
        assert float(row["iou"]) == pytest.approx(1.0, abs=0.005)
        assert float(row["area_theirs"]) == pytest.approx(slices[k].region.area, rel=0.005)


@pytest.mark.parametrize("seed", range(3))
def test_distances_of_few_pixels_are_those_of_the_whole_picture(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    mask = np.zeros((60, 80), np.uint8)
    mask[rng.integers(0, 60, 9), rng.integers(0, 80, 9)] = 1
    places = np.column_stack([rng.integers(0, 60, 200), rng.integers(0, 80, 200)])
    due = np.hypot(*np.moveaxis(places[:, None] - np.argwhere(mask), 2, 0)).min(axis=1)
    for many in (1 << 30, 0):  # pixel by pixel, and by a picture
        monkeypatch.setattr(support, "_MANY", many)
        found = support._distance_at(mask, places, 7.0)
        assert found[due <= 7.0] == pytest.approx(due[due <= 7.0], abs=1e-5)
        assert (found[due > 7.0] > 7.0).all()
    assert (support._distance_at(np.zeros_like(mask), places, 7.0) > 1e5).all()


@pytest.mark.parametrize("seed", range(4))
def test_what_a_coarse_drawing_says_is_held_is_held(seed):
    """Beads and areas as supports; places are held by no less than a fine drawing says, less a pixel."""
    rng = np.random.default_rng(seed)
    lines = [rng.uniform(0, 40, (3, 2)) for _ in range(3)]
    beads = pack_beads(lines, [SUPPORT] * 3, [0.8] * 3)
    layer = TheirLayer(1.0, "line 1", beads=beads, supports=[rng.uniform(0, 40, (3, 2))] if seed % 2 else [])
    side = types.SimpleNamespace(low=np.zeros(3), high=np.full(3, 40.0), grid=Grid(0.0, 0.0, 0.2, 20, 20))
    found = Alignment([layer], np.array([1.0]), T, "middle", False, 0.0, 0.0, 0.0, "", 1.0)
    posts, sheet = Posts(side, found, np.array([1.0]), 0.8, 4.5), Canvas(np.zeros(2), 0.1, (400, 400))
    far = distance(posts.drawn(sheet, 1.1, 1.3)) * 0.1
    places = rng.integers(0, 400, (2000, 2))
    held = np.array([posts.hold((p + 0.5)[None] * 0.1, 1.1, 1.3) for p in places])
    assert (far[places[held, 1], places[held, 0]] <= 4.5 - 0.1).all()
    assert held[far[places[:, 1], places[:, 0]] < 2.5].all() and 0 < held.sum() < len(held)
    assert not posts.hold(np.ones((1, 2)), 5.0, 6.0)  # nothing ends there
