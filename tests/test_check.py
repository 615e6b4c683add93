"""check: true outputs pass, planted faults are found, frames are recognised, reports are written."""

import json
import shutil
import subprocess

import models
import numpy as np
import oracle
import plants
import pytest
from shapely import affinity

from rasterslice.check.run import check
from rasterslice.cli import main
from rasterslice.errors import RasterSliceError

T = 0.4
TRIES = 12


@pytest.fixture(scope="module")
def part(tmp_path_factory):
    """Give a parameter file and the exact slices of the lowest 6 mm, by polygons."""
    folder = tmp_path_factory.mktemp("part")
    body = plants.part()
    mesh = models.write_stl(folder / "part.stl", body.triangles())
    params = models.write_params(folder, mesh, scaffolding=0, thickness=T, pitch=0.2)
    heights = np.arange(T / 2, 30.0, T)
    regions = oracle.regions(body.triangles(), heights)
    slices = [plants.Slice(float(z), plants.clean(oracle.to_shapely(r))) for z, r in zip(heights, regions, strict=True)]
    return params, slices, folder


def between(slices, i):
    """Return a slice, and those a little lower and higher."""
    z = slices[i].z + plants.HEIGHT_SLACK * np.array([-1.0, 1.0])
    near = [plants.clean(oracle.to_shapely(r)) for r in oracle.regions(plants.part().triangles(), z)]
    return [slices[i].region, *near]


WRITERS = {**plants.AREA_WRITERS, **plants.BEAD_WRITERS}


@pytest.mark.parametrize("kind", WRITERS)
def test_true_slices_pass(kind, part, tmp_path):
    params, slices, _ = part
    suffix, write = WRITERS[kind]
    moved = [plants.Slice(k.z, plants.clean(affinity.translate(k.region, 50, 40))) for k in slices]
    r = check(params, write(moved, tmp_path / f"true{suffix}", T))
    assert r["verdict"] == "pass" and not r["failed"] and not r["faults"], r["worst"][:2]
    # Beads of the last layers of the cone do not fit into it.
    assert len(r["cannot_tell"]) <= (3 if kind.startswith(("G-code", "Fab")) else 0)
    # A picture has its own origin, but our writer of pictures starts it at the part.
    if kind not in plants.PICTURED:
        assert [r["alignment"]["dx"], r["alignment"]["dy"]] == pytest.approx([-50, -40], abs=0.01)
    assert r["alignment"]["z_is"] == ("top" if kind.startswith(("CLI", "G-code", "Fab")) else "middle")
    if kind.startswith(("SVG", "CLI", "CSV", "DXF", "NPZ")):
        assert r["worst_deviation"] < 0.01


CASES = [(kind, fault) for kind in plants.AREA_WRITERS for fault in plants.AREA_FAULTS]
CASES += [(kind, fault) for kind in plants.BEAD_WRITERS for fault in plants.BEAD_FAULTS]
CARRIED = [
    (kind, fault)
    for kind, fault in CASES
    if not (fault == "winding reversed" and kind not in plants.CARRIES_WINDING)
    and not (fault == "self intersection" and kind in plants.PICTURED)
]


@pytest.mark.parametrize(("kind", "fault"), CARRIED)
def test_plants_are_found(kind, fault, part, tmp_path):
    """A plant that exceeds the stated limits fails its own layer, and no other."""
    params, slices, _ = part
    suffix, write = WRITERS[kind]
    beads = kind in plants.BEAD_WRITERS
    rng = np.random.default_rng(len(kind) + 7 * len(fault))
    for _ in range(TRIES):
        k = int(rng.integers(1, 13))
        made = (plants.BEAD_FAULTS if beads else plants.AREA_FAULTS)[fault](rng, slices, k)
        if made is None:
            continue
        layers, wrong = made
        planted = {round(layer.z, 3): layer for layer in layers}
        limits = plants.stated(kind)
        due = [
            i for i in wrong
            if plants.exceeds(between(slices, i), planted.get(round(slices[i].z, 3)), fault, limits, beads)
        ]  # fmt: skip
        if due:
            break
    else:
        pytest.skip("no layer of this part shows this fault beyond our limits")
    r = check(params, write(layers, tmp_path / f"planted{suffix}", T))
    assert set(due) <= set(r["failed"]) <= set(wrong), r["worst"][:3]
    assert r["verdict"] == "fail"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda g: affinity.scale(g, -1, 1, origin=(0, 0)), "the file is mirrored in x"),
        (lambda g: affinity.rotate(g, 90, origin=(0, 0)), "the file is turned by 270 degrees"),
        (lambda g: affinity.rotate(g, -90, origin=(0, 0)), "the file is turned by 90 degrees"),
        (lambda g: affinity.scale(g, 1 / 25.4, 1 / 25.4, origin=(0, 0)), "25.4 times too small"),
    ],
)
def test_frames_are_named(change, said, part, tmp_path):
    params, slices, _ = part
    turned = [plants.Slice(k.z, plants.clean(change(k.region))) for k in slices]
    r = check(params, plants.cli_binary(turned, tmp_path / "a.cli", T))
    assert r["verdict"] == "fail" and not r["failed"]
    assert any(said in fault for fault in r["faults"]), r["faults"]


@pytest.mark.parametrize(("lift", "z_is"), [(0.2, "top"), (0.0, "middle"), (-0.2, "bottom")])
def test_heights_are_recognised(lift, z_is, part, tmp_path):
    params, slices, _ = part
    lifted = [plants.Slice(k.z + lift, k.region) for k in slices]
    r = check(params, plants.csv_nan(lifted, tmp_path / "a.csv", T))
    assert (r["alignment"]["z_is"], r["verdict"]) == (z_is, "pass")


def test_a_given_shift_is_kept(part, tmp_path):
    params, slices, _ = part
    path = plants.cli_ascii(slices, tmp_path / "a.cli", T)
    assert check(params, path, shift="none")["verdict"] == "pass"
    r = check(params, path, shift=(0.2, 0.0))
    assert r["verdict"] == "fail" and len(r["failed"]) > 60
    assert check(params, path, shift=(0.2, 0.0), tolerance=0.25)["verdict"] == "pass"


def test_command_line(part, tmp_path, capsys):
    params, slices, _ = part
    good = plants.cli_ascii(slices, tmp_path / "good.cli", T)
    bad = plants.cli_ascii([k for i, k in enumerate(slices) if i != 4], tmp_path / "bad.cli", T)
    assert main(["check", str(params), "--against", str(good)]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("pass: 75 pass")
    out = tmp_path / "report"
    assert main(["check", str(params), "--against", str(bad), "--json", "-o", str(out)]) == 6
    shown = json.loads(capsys.readouterr().out)
    assert shown["failed"] == [4] and shown["worst"][0]["reasons"] == "the layer is missing"
    assert json.loads((out / "check.json").read_text()) == shown
    rows = (out / "check.csv").read_text().splitlines()
    assert len(rows) == 76 and rows[0].startswith("layer,z,their_z")
    page = (out / "check.html").read_text()
    assert page.count("<figure") == 13 and "the layer is missing" in page and "http" not in page


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--against", "none.cli"], "cannot be read"),
        (["--align", "1", "--against", "a"], "must be auto, none or dx,dy"),
        (["--tolerance", "-1", "--against", "a"], "must be > 0 mm"),
        (["--tolerance", "-1e3", "--against", "a"], "must be > 0 mm"),
        (["--support", "-2,3,40", "--against", "a"], "must be layers (0 to 100)"),
        ([], "--against"),
    ],
)
def test_mistakes_are_one_line(arguments, said, part, capsys):
    assert main(["check", str(part[0]), *arguments]) in (2, 3)
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1


@pytest.mark.parametrize("shift", ["-50,-40", "-5e1,-40.0", " -50,-40"])
def test_values_that_begin_with_a_minus(shift, part, tmp_path, capsys):
    params, slices, _ = part
    moved = [plants.Slice(k.z, plants.clean(affinity.translate(k.region, 50, 40))) for k in slices]
    common = ["check", str(params), "--against", str(plants.cli_binary(moved, tmp_path / "a.cli", T)), "--json"]
    for written in (["--align", shift], [f"--align={shift}"]):
        assert main([*common, *written]) == 0
        assert json.loads(capsys.readouterr().out)["alignment"]["dx"] == -50


def test_two_runs(part, tmp_path):
    params, _, _ = part
    text = params.read_text()
    runs = []
    for name, extra in (("a", "export = svg"), ("b", "export = svg"), ("c", "")):
        path = tmp_path / f"{name}.txt"
        path.write_text(text.replace("pitch = 0.2", f"pitch = {0.25 if name == 'b' else 0.2}") + extra + "\n")
        assert main([str(path), "--quiet"]) == 0
        runs.append(tmp_path / f"{name}.slices")
    a, b, c = runs
    same = check(a, a)
    assert same["verdict"] == "pass" and same["worst_deviation"] < 1e-3
    assert check(a, b)["verdict"] == "pass"
    assert check(a, c)["verdict"] == "pass"
    assert check(params, a)["verdict"] == check(params, a / "svg")["verdict"] == "pass"
    with pytest.raises(RasterSliceError, match="is no run of rasterslice"):
        check(a, params)


def test_scaffold_is_compared(tmp_path):
    """A table: its scaffold stands under the top; a hole in it is found."""
    body = models.join(models.box((-8, -8, 4), (8, 8, 6)), models.box((-2, -2, 0), (2, 2, 4)))
    mesh = models.write_stl(tmp_path / "table.stl", body.triangles())
    params = models.write_params(tmp_path, mesh, scaffolding=1, thickness=T, pitch=0.2, export="svg")
    out = tmp_path / "table.slices"
    assert main([str(params), "-o", str(out), "--quiet"]) == 0
    assert check(params, out / "svg")["verdict"] == "pass"
    path = out / "svg" / "layer_0003.svg"
    text = path.read_text()
    start = text.index('id="scaffold_region"')
    first, last = text.index(' d="', start) + 4, text.index('"/>', start)
    path.write_text(text[:first] + text[last:])
    r = check(params, out / "svg")
    assert r["failed"] == [3] and "scaffold missing" in r["worst"][0]["reasons"]


@pytest.mark.parametrize("program", ["slic3r", "prusa-slicer"])
def test_real_slicers_pass(program, part, tmp_path):
    if not shutil.which(program):
        pytest.skip(f"no {program}")
    params, _, folder = part
    out = tmp_path / ("out.svg" if program == "slic3r" else "out.gcode")
    flags = ["--layer-height", str(T), "--first-layer-height", str(T), "-o", str(out)]
    if program == "slic3r":
        flags += ["--export-svg"]
    else:
        flags += ["-g", "--nozzle-diameter", "0.6", "--extrusion-width", "0.8", "--first-layer-extrusion-width", "0.8"]
        flags += ["--external-perimeter-extrusion-width", "0.8", "--elefant-foot-compensation", "0", "--skirts", "0"]
    subprocess.run([program, *flags, str(folder / "part.stl")], check=True, capture_output=True, timeout=120)
    r = check(params, out)
    assert r["verdict"] == "pass", r["worst"][:2]
    assert not r["failed"] and not r["faults"]


def test_huge_and_empty_files(part, tmp_path):
    params, slices, _ = part
    path = plants.csv_nan(slices, tmp_path / "a.csv", T)
    first, rest = path.read_text().split("\n", 1)
    path.write_text("99999," + first.split(",", 1)[1] + "\n" + rest)
    with pytest.raises(RasterSliceError, match="a layer spans"):
        check(params, path)
    path = tmp_path / "far.csv"
    path.write_text("0,0,1\n1,0,1\n1,1,1\nNaN,NaN,NaN\n")
    r = check(params, path)
    assert r["verdict"] == "fail" and len(r["failed"]) >= 70


@pytest.mark.parametrize("pixel", [0.02, 0.1, 0.3])
@pytest.mark.parametrize("said", [True, False])
def test_pictures_of_any_pixel_pass(pixel, said, part, tmp_path):
    """Pixels that are right at their middles are right, however large they are; those of no said size, and turned."""
    import cv2

    params, slices, _ = part
    folder = plants.png_stack(slices, tmp_path / "a", T, pixel=pixel)
    for path in folder.glob("*.png") if not said else ():
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        path.write_bytes(cv2.imencode(".png", np.rot90(image))[1].tobytes())  # without the chunk that says a size
    r = check(params, folder)
    assert r["passed"] == 75 and not r["faults"], r["worst"][:2]
    assert ("the file is turned by 270 degrees" in r["notes"]) == (not said)
    assert r["worst_deviation"] < 0.05 and r["uncertainty"] == pytest.approx(0.004 + 0.75 * pixel, rel=0.01)
