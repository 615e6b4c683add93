"""check: several copies in one file are told apart, and what is wrong with one of them is said of it."""

import shutil
import subprocess

import models
import numpy as np
import oracle
import plants
import pytest
import shapely
from shapely import affinity

from rasterslice.check.run import check
from rasterslice.cli import main

T = 0.4
WRITERS = {**plants.AREA_WRITERS, **plants.BEAD_WRITERS}
STEP = (23.6, 19.6)  # the part, a path width beside it, whole pixels
FOUR = [(0.0, 0.0), (STEP[0], 0.0), (0.0, STEP[1]), STEP]
ELSEWHERE = [(0.0, 0.0), (31.0, 3.0), (2.0, 40.0)]


def body():
    """Return a tube and a foot beside it, on different heights."""
    tube = models.prism([models.circle(6, (6, 6), 48), models.circle(3, (6, 6), 48)[::-1]], 0.0, 4.0)
    return models.join(tube, models.prism([models.rectangle(14, 2, 22, 18)], 0.0, 3.2))


@pytest.fixture(scope="module")
def part(tmp_path_factory):
    """Give parameter files that ask for one and for four copies, the mesh, and exact slices of one."""
    folder = tmp_path_factory.mktemp("part")
    mesh = models.write_stl(folder / "part.stl", body().triangles())
    heights = np.arange(T / 2, 4.0, T)
    shapes = [plants.clean(oracle.to_shapely(r)) for r in oracle.regions(body().triangles(), heights)]
    found = {}
    for count, copies in ((1, (1, 1, 1)), (4, (2, 2, 4))):
        (folder / str(count)).mkdir()
        found[count] = models.write_params(folder / str(count), mesh, scaffolding=0, thickness=T, copies=copies)
    return found, mesh, [plants.Slice(float(z), s) for z, s in zip(heights, shapes, strict=True)]


def laid(slices, places, change=lambda copy, k, region: region):
    """Return the slices of copies at some places; ``change`` gives the region of copy and layer."""
    found = []
    for k, s in enumerate(slices):
        own = [affinity.translate(change(c, k, s.region), x, y) for c, (x, y) in enumerate(places, 1)]
        found.append(plants.Slice(s.z, plants.clean(shapely.union_all(own))))
    return found


@pytest.mark.parametrize("kind", WRITERS)
@pytest.mark.parametrize(("asked", "places"), [(1, FOUR[:2]), (1, ELSEWHERE), (4, FOUR)])
def test_copies_are_told_apart(kind, asked, places, part, tmp_path):
    params, _, slices = part
    suffix, write = WRITERS[kind]
    r = check(params[asked], write(laid(slices, places), tmp_path / f"a{suffix}", T))
    assert r["verdict"] == "pass" and r["passed"] == len(slices) and not r["faults"], (r["faults"], r["worst"][:2])
    at = np.array(r["copies"]) - r["copies"][0]
    assert np.allclose(at, places, atol=0.01)
    said = f"holds {len(places)} copies of the part"
    assert any(said in note and f"asks for {asked}" in note for note in r["notes"])


def only(copy, layer, shape):
    """Change one copy in one layer, or (layer -1) in all."""
    return lambda c, k, region: shape(region) if c == copy and layer in (k, -1) else region


def no_island(region):
    return shapely.MultiPolygon(sorted(region.geoms, key=lambda p: p.area)[1:])


DAMAGE = {
    "missing in a layer": (only(2, 5, lambda r: shapely.MultiPolygon()), "copy 2: the layer is missing"),
    "shifted in a layer": (only(3, 5, lambda r: affinity.translate(r, 0.3, 0)), "copy 3: extra at"),
    "hole filled in a layer": (only(4, 5, lambda r: shapely.union_all([shapely.Polygon(p.exterior) for p in r.geoms])),
                               "copy 4: extra at"),
    "island deleted in a layer": (only(1, 5, no_island), "copy 1: missing at"),
}  # fmt: skip


@pytest.mark.parametrize("kind", ["CSV polylines", "SVG Slic3r 1.3", "PNG stack", "G-code Cura", "G-code PrusaSlicer"])
@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_copy_is_named(kind, damage, part, tmp_path):
    params, _, slices = part
    suffix, write = WRITERS[kind]
    change, said = DAMAGE[damage]
    r = check(params[4], write(laid(slices, FOUR, change), tmp_path / f"a{suffix}", T))
    said = said.replace("extra", "bead leaves the part") if "shifted" in damage and "G-code" in kind else said
    said = said.split(": ")[0] if "G-code" in kind and "missing in" not in damage else said
    assert r["failed"] == [5] and not r["faults"], (r["faults"], r["worst"][:2])
    assert said in r["worst"][0]["reasons"] and r["worst"][0]["copy"] == int(said.split()[1].strip(":"))
    others = {f"copy {k}:" for k in range(1, 5)} - {said.split(":")[0] + ":"}
    assert not any(other in r["worst"][0]["reasons"] for other in others)


@pytest.mark.parametrize("kind", ["CSV polylines", "G-code PrusaSlicer"])
def test_a_copy_beside_its_place(kind, part, tmp_path):
    params, _, slices = part
    suffix, write = WRITERS[kind]
    moved = [*FOUR[:2], (FOUR[2][0], FOUR[2][1] + 0.7), FOUR[3]]
    r = check(params[4], write(laid(slices, moved), tmp_path / f"a{suffix}", T))
    assert r["verdict"] == "fail" and not r["failed"]
    assert len(r["faults"]) == 1 and r["faults"][0].startswith("copy 3 stands 0.7"), r["faults"]


WIDE = [(0.0, 0.0), (32.0, 0.0), (0.0, 29.0), (32.0, 29.0)]


@pytest.mark.parametrize(("places", "said"), [
    (WIDE, []),
    ([*WIDE[:2], (4.0, 32.0), WIDE[3]], ["copy 3 stands 4.999 mm beside its place at the spacing of the others"]),
    ([*WIDE[:2], (0.0, 32.0), WIDE[3]],
     ["the copies stand not equally far apart: one of 3, 4 was moved, which one cannot be told"]),
])  # fmt: skip
def test_copies_at_another_spacing(places, said, part, tmp_path):
    """Farther apart than asked for is a note; the one that does not stand where the others say is named."""
    params, _, slices = part
    r = check(params[4], plants.csv_nan(laid(slices, places), tmp_path / "a.csv", T))
    assert r["faults"] == said and not r["failed"] and len(r["copies"]) == 4
    assert any("do not stand as far apart" in note for note in r["notes"]), r["notes"]


@pytest.mark.parametrize("kind", ["CLI ASCII", "G-code Slic3r"])
def test_too_few_copies(kind, part, tmp_path):
    params, _, slices = part
    suffix, write = WRITERS[kind]
    path = write(laid(slices, [FOUR[0], FOUR[1], FOUR[3]]), tmp_path / f"a{suffix}", T)
    r = check(params[4], path)
    assert r["verdict"] == "fail" and not r["failed"] and len(r["faults"]) == 1
    assert "copy 3 of the parameter file, 0 and 19.6 mm from the first, is not in the file" in r["faults"][0]
    r = check(params[4], write(slices, tmp_path / f"b{suffix}", T))
    assert r["faults"] == ["the file holds 1 copy of the part, the parameter file asks for 4: write all, or ask for 1"]


@pytest.mark.parametrize("kind", ["SVG Slic3r legacy", "G-code Cura"])
def test_what_is_no_copy_is_named(kind, part, tmp_path):
    """Something else on the plate: it is left out, and what to do is said."""
    params, _, slices = part
    suffix, write = WRITERS[kind]
    other = shapely.box(40, 0, 60, 9)
    layers = [plants.Slice(s.z, plants.clean(s.region.union(other))) for s in slices]
    r = check(params[1], write(layers, tmp_path / f"a{suffix}", T))
    assert r["verdict"] == "fail" and not r["failed"] and len(r["faults"]) == 1
    assert "is no copy of the part and was left out: write the file without it" in r["faults"][0]


def test_what_no_copies_explain(part, tmp_path):
    params, _, slices = part
    big = [plants.Slice(s.z, plants.clean(affinity.scale(s.region, 2, 1.3, origin=(0, 0)))) for s in slices]
    r = check(params[1], plants.csv_nan(big, tmp_path / "a.csv", T))
    assert r["verdict"] == "fail" and any("write the part alone" in note for note in r["notes"]), r["notes"]


EXPORTS = {"svg": "svg", "svg-single": "params.svg", "cli": "params.cli", "cli-binary": "params.binary.cli",
           "gcode": "params.gcode", "csv": "params.csv", "png": "png"}  # fmt: skip


@pytest.mark.parametrize("copies", [(2, 1, 2), (2, 2, 3)])
def test_our_own_exports_of_copies(copies, tmp_path):
    """With scaffolds, which reach towards each other."""
    shape = models.join(models.box((-9, -7, 2.1), (6, 8, 3)), models.box((-2, -2, 0), (2, 3, 2.2)))
    mesh = models.write_stl(tmp_path / "m.stl", shape.triangles())
    params = models.write_params(tmp_path, mesh, thickness=T, copies=copies, export=" ".join(EXPORTS))
    assert main([str(params), "--quiet"]) == 0
    out = tmp_path / "params.slices"
    for name, made in EXPORTS.items():
        r = check(params, out / made)
        assert not r["failed"] and not r["faults"], (name, r["faults"], r["worst"][:2])
        assert len(r["copies"]) == copies[2] and r["layers"] == 7
    r = check(params, out)  # a run holds one
    assert r["verdict"] == "pass" and not r["copies"] and not r["faults"]


@pytest.mark.parametrize("way", ["prusa-slicer", "prusa-slicer one by one", "slic3r"])
def test_duplicates_of_real_slicers(way, part, tmp_path):
    """Two objects of PrusaSlicer, layer by layer and one after the other, and of Slic3r: each is compared."""
    params, mesh, _ = part
    program = way.split()[0]
    if not shutil.which(program):
        pytest.skip(f"no {program}")
    out = tmp_path / "a.gcode"
    flags = ["--layer-height", str(T), "--first-layer-height", str(T), "--nozzle-diameter", "0.6", "--duplicate", "2"]
    for what in ("", "external-perimeter-", "first-layer-"):
        flags += [f"--{what}extrusion-width", "0.8"]
    flags += ["-g", "--elefant-foot-compensation", "0"] if program == "prusa-slicer" else ["--gcode-comments"]
    flags += ["--complete-objects"] if "one by one" in way else []
    subprocess.run([program, *flags, "-o", str(out), str(mesh)], check=True, capture_output=True, timeout=120)
    r = check(params[1], out)
    assert r["verdict"] == "pass" and not r["failed"] and not r["faults"], (r["faults"], r["worst"][:2])
    assert len(r["copies"]) == 2 and any("asks for 1: each was compared" in note for note in r["notes"])
