"""check: beads whose width no file says, and files of which little can be told."""

import shutil
import subprocess

import models
import numpy as np
import oracle
import plants
import pytest
import shapely
from plants import BEAD_WRITERS, Slice, clean

from rasterslice.check.run import check
from rasterslice.check.verdict import ENOUGH
from rasterslice.cli import main

T = 0.4
SQUARE = clean(shapely.box(0, 0, 20, 14))
_, CURA = BEAD_WRITERS["G-code Cura"]


@pytest.fixture(scope="module")
def params(tmp_path_factory):
    folder = tmp_path_factory.mktemp("block")
    mesh = models.write_stl(folder / "m.stl", models.box((0, 0, 0), (20, 14, 8)).triangles())
    return models.write_params(folder, mesh, scaffolding=0, thickness=T)


def layers(inset=0.5):
    return [Slice(float(z), SQUARE, inset=inset) for z in np.arange(T / 2, 8, T)]


def test_filament_bears_the_width_out(params, tmp_path):
    r = check(params, CURA(layers(), tmp_path / "a.gcode", T))
    assert r["verdict"] == "pass" and r["width"] == pytest.approx(0.8, abs=0.01)
    assert any("filament of 1.75 mm bears out" in note for note in r["notes"])


@pytest.mark.parametrize("inset", [1.0, 1.5])
def test_walls_that_are_all_too_deep_do_not_pass(inset, params, tmp_path):
    path = CURA(layers(inset), tmp_path / "a.gcode", T)
    r = check(params, path)
    wide = inset == 1.5  # wider than any bead of such layers
    assert r["verdict"] == ("fail" if wide else "cannot tell") and r["passed"] == 0
    assert main(["check", str(params), "--against", str(path)]) == (6 if wide else 7)
    r = check(params, path, width=0.8)
    assert r["verdict"] == "fail" and len(r["failed"]) == 20


def test_no_filament_no_width(params, tmp_path):
    path = CURA(layers(), tmp_path / "a.gcode", T)
    text = path.read_text().splitlines()
    path.write_text("\n".join(line.partition(" E")[0] + f" E{1000 * i}" if " E" in line else line
                              for i, line in enumerate(text)) + "\n")  # fmt: skip
    assert check(params, path)["verdict"] == "cannot tell"
    assert check(params, path, width=0.8)["verdict"] == "pass"


def test_a_wide_guess_excuses_no_missing_layer(params, tmp_path):
    few = layers(6.0)
    r = check(params, CURA(few[:8] + few[9:], tmp_path / "a.gcode", T))
    assert r["verdict"] == "fail" and 8 in r["failed"]


def test_most_layers_must_be_told(params, tmp_path):
    """Layers between tolerance less and plus uncertainty: half of them at most."""
    from plants import csv_nan

    off = clean(SQUARE.buffer(0.05, join_style="mitre"))
    for share, verdict in ((1 - ENOUGH, "pass"), (1 - ENOUGH + 0.05, "cannot tell")):
        some = layers()
        for i in range(round(share * len(some))):
            some[i].region = off
        r = check(params, csv_nan(some, tmp_path / "a.csv", T), tolerance=0.05)
        assert r["verdict"] == verdict and len(r["cannot_tell"]) == round(share * 20)


def stripped(path):
    """Remove every comment of a G-code file."""
    lines = (line.partition(";")[0].rstrip() for line in path.read_text().splitlines())
    path.write_text("\n".join(line for line in lines if line) + "\n")
    return path


@pytest.fixture(scope="module")
def part(tmp_path_factory):
    """Give a part with an island, a hole and a slope, and its exact slices."""
    folder, body = tmp_path_factory.mktemp("part"), plants.part()
    mesh = models.write_stl(folder / "m.stl", body.triangles())
    heights = np.arange(T / 2, 30.0, T)
    shapes = [clean(oracle.to_shapely(r)) for r in oracle.regions(body.triangles(), heights)]
    slices = [Slice(float(z), s) for z, s in zip(heights, shapes, strict=True)]
    return models.write_params(folder, mesh, scaffolding=0, thickness=T), mesh, slices


SLICERS = {
    "PrusaSlicer": ["prusa-slicer", "-g", "--elefant-foot-compensation", "0", "--perimeter-generator", "classic"],
    "Arachne": ["prusa-slicer", "-g", "--elefant-foot-compensation", "0", "--perimeter-generator", "arachne"],
    "Slic3r": ["slic3r"],
}


@pytest.mark.parametrize("chosen", [True, False])
@pytest.mark.parametrize("program", SLICERS)
def test_no_comments_at_all(program, chosen, part, tmp_path):
    """No name, no width: the outer beads are found, and those of a first layer that is wider by itself."""
    if not shutil.which(SLICERS[program][0]):
        pytest.skip(f"no {SLICERS[program][0]}")
    params, mesh, _ = part
    out = tmp_path / "a.gcode"
    flags = ["--layer-height", "0.4", "--first-layer-height", "0.4", "--nozzle-diameter", "0.6", "--skirts", "0"]
    for what in ("", "external-perimeter-", "first-layer-") if chosen else ():
        flags += [f"--{what}extrusion-width", "0.8"]
    command = [*SLICERS[program], *flags, "-o", str(out), str(mesh)]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    r = check(params, stripped(out))
    assert r["verdict"] == "pass" and not r["failed"] and not r["faults"], r["worst"][:2]
    assert len(r["cannot_tell"]) <= 4 and any("bears out" in note for note in r["notes"])
    assert not chosen or r["width"] == pytest.approx(0.8, abs=0.005)


@pytest.mark.parametrize("fault", ["offset whole width", "offset wrong way", "island deleted", "layer missing"])
def test_faults_without_comments(fault, part, tmp_path):
    params, _, slices = part
    rng = np.random.default_rng(5)
    layers, wrong = plants.BEAD_FAULTS[fault](rng, slices, 6)
    r = check(params, stripped(CURA(layers, tmp_path / "a.gcode", T)))
    assert r["failed"] == wrong, r["worst"][:3]


def test_a_wider_layer_is_told_by_its_filament(params, tmp_path):
    """A bead as wide as what it is fed may lie as deep; one that is fed as all others may not."""
    wide = CURA(layers()[:1], tmp_path / "w.gcode", T, width=1.2).read_text().splitlines()
    rest = CURA(layers(), tmp_path / "a.gcode", T).read_text().splitlines()
    at = [i for i, line in enumerate(rest) if line.startswith(";LAYER:")]
    fed = [";LAYER:0", *wide[wide.index(";LAYER:0") + 1 :], "G92 E0"]
    before = max(float(line.partition(" E")[2]) for line in rest[: at[1]] if " E" in line)
    tail = [f"G92 E{before:.5f}", *rest[at[1] :]]
    path = tmp_path / "b.gcode"
    path.write_text("\n".join([*rest[: at[0]], *fed, *tail]) + "\n")
    assert check(params, path)["passed"] == 20
    starved = [line.partition(" E")[0] + f" E{float(line.partition(' E')[2]) * 0.8 / 1.2:.5f}" if " E" in line else line
               for line in fed[:-1]]  # fmt: skip
    path.write_text("\n".join([*rest[: at[0]], *starved, *tail]) + "\n")
    assert check(params, path)["failed"] == [0]
