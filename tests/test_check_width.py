"""check: beads whose width no file says, and files of which little can be told."""

import models
import numpy as np
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
