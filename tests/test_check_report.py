"""check: what is written about every kind of file, and what is refused before anything is looked at."""

import json
import shutil
import subprocess

import models
import numpy as np
import oracle
import plants
import pytest

from rasterslice.check import run as checking
from rasterslice.check.run import check
from rasterslice.cli import main

T = 0.4
WRITERS = {**plants.AREA_WRITERS, **plants.BEAD_WRITERS}


@pytest.fixture(scope="module")
def part(tmp_path_factory):
    folder = tmp_path_factory.mktemp("part")
    body = models.box((0, 0, 0), (12, 9, 2.4))
    mesh = models.write_stl(folder / "part.stl", body.triangles())
    params = models.write_params(folder, mesh, scaffolding=0, thickness=T, pitch=0.2)
    heights = np.arange(T / 2, 2.4, T)
    regions = oracle.regions(body.triangles(), heights)
    shapes = [plants.clean(oracle.to_shapely(r)) for r in regions]
    return params, [plants.Slice(float(z), shape) for z, shape in zip(heights, shapes, strict=True)]


@pytest.mark.parametrize("kind", WRITERS)
def test_every_kind_of_file_gets_its_three_files(kind, part, tmp_path, capsys):
    params, slices = part
    suffix, write = WRITERS[kind]
    path = write(slices, tmp_path / f"true{suffix}", T)
    main(["check", str(params), "--against", str(path), "--json", "-o", str(tmp_path / "out")])
    found = json.loads(capsys.readouterr().out)
    assert found == json.loads((tmp_path / "out" / "check.json").read_text())
    rows = (tmp_path / "out" / "check.csv").read_text().splitlines()
    assert len(rows) == 1 + found["layers"] == 1 + len(slices)
    page = (tmp_path / "out" / "check.html").read_text()
    assert found["verdict"] in page and page.count("deviation") >= len(slices)
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["check.csv", "check.html", "check.json"]


def test_a_report_that_fails_leaves_the_last_one(part, tmp_path, monkeypatch):
    params, slices = part
    path, out = plants.cli_ascii(slices, tmp_path / "a.cli", T), tmp_path / "out"
    check(params, path, out=out)
    before = {p.name: p.read_bytes() for p in out.iterdir()}

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checking, "write_page", full)
    assert main(["check", str(params), "--against", str(plants.cli_ascii(slices[:-1], path, T)), "-o", str(out)]) == 2
    assert {p.name: p.read_bytes() for p in out.iterdir()} == before


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--tolerance", "0.8", "more than half of a path of 1.5 mm"),
        ("--tolerance", "1e9", "more than half of a path of 1.5 mm"),
        ("--width", "1e9", "give 0.15 to 15 mm"),
        ("--width", "0.01", "give 0.15 to 15 mm"),
        ("--align", "1e9,0", "farther than 100000 mm"),
    ],
)
def test_options_that_let_anything_pass_are_refused(option, value, words, part, tmp_path, capsys):
    params, slices = part
    path = plants.cli_ascii(slices, tmp_path / "a.cli", T)
    assert main(["check", str(params), "--against", str(path), option, value]) == 2
    assert words in capsys.readouterr().err


def test_a_width_that_the_file_contradicts_is_refused(part, tmp_path, capsys):
    params, slices = part
    name = next(name for name in plants.BEAD_WRITERS if "Prusa" in name)
    path = plants.BEAD_WRITERS[name][1](slices, tmp_path / "b.gcode", T)
    assert "WIDTH" in path.read_text()
    assert main(["check", str(params), "--against", str(path), "--width", "1.1"]) == 2
    assert "the file says that its outer beads are" in capsys.readouterr().err


@pytest.mark.skipif(not shutil.which("prusa-slicer"), reason="no prusa-slicer")
def test_a_raft_holds_nothing_up_and_asks_for_nothing(tmp_path):
    """Overhangs of a part without supports are a note, with a raft as without."""
    mesh = models.write_stl(tmp_path / "m.stl", models.ball_on_stem().grounded().triangles())
    params, out = models.write_params(tmp_path, mesh, scaffolding=1, thickness=T), tmp_path / "out.gcode"
    flags = ["--layer-height", str(T), "--first-layer-height", str(T), "--nozzle-diameter", "0.6", "--raft-layers", "1"]
    for what in ("", "external-perimeter-", "first-layer-"):
        flags += [f"--{what}extrusion-width", "0.8"]
    flags += ["-g", "--elefant-foot-compensation", "0", "--skirts", "0"]
    subprocess.run(["prusa-slicer", *flags, "-o", str(out), str(mesh)], check=True, capture_output=True, timeout=120)
    assert "Support material" in out.read_text()
    r = check(params, out)
    assert not any("overhang" in w["reasons"] for w in r["worst"]), r["worst"][:2]
    assert any("the file has no supports" in note for note in r["notes"])
