"""Exports hold every ice layer of every slice, at its height and with its own fill; `check` reads them."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import models
import numpy as np
import pytest
from fakes import pack, washer

from rasterslice.check import readers
from rasterslice.check.form import FILL, OUTER, SUPPORT
from rasterslice.cli import main
from rasterslice.export import FORMATS, Context
from rasterslice.grid import cover
from rasterslice.paths import Layer

GRID = cover((-12, -12), (12, 12), 0.2, 1.0)
ACROSS, ALONG = ([[(x, y) for x in (-6.0, -4.0)] for y in (-0.5, 0.5)], [[(-5.0, y) for y in (-1.0, 1.0)]])


def stack(n: int) -> list[Layer]:
    """Return three slices whose fill runs across, along, across, ... over n ice layers each."""
    sets = [pack(ACROSS, False), pack(ALONG, False)]
    return [
        replace(washer(k, 0.6 * (k + 0.5)), part_fill=sets[n * k % 2], part_second_fill=sets[(n * k + 1) % 2])
        for k in range(3)
    ]


def written(name: str, folder: Path, n: int) -> Path:
    context = Context("job", GRID, 0.6, 1.5, 1.25, settings={"part_layers_per_slice": n})
    target = folder / FORMATS[name].target.format(stem="job")
    FORMATS[name].write(stack(n), target, context)
    return target


def across(ends: Any) -> bool:
    """Whether a line runs in x."""
    (x0, y0), (x1, y1) = ends
    return bool(abs(x1 - x0) > abs(y1 - y0))


def turns(found: list[bool], n: int) -> None:
    assert found == [i % 2 == 0 for i in range(3 * n)]


@pytest.mark.parametrize("n", [1, 2, 3])
def test_gcode(tmp_path: Path, n: int) -> None:
    text = written("gcode", tmp_path, n).read_text()
    found = text.split(";LAYER_CHANGE\n")[1:]
    assert [float(re.search(r"^G0 Z([0-9.]+)", k, re.M)[1]) for k in found] == pytest.approx(
        [0.6 * (i + 1) / n for i in range(3 * n)], abs=1e-4
    )
    assert f"LAYER_COUNT:{3 * n}\n" in text
    fills = []
    for i, item in enumerate(found):
        assert item.startswith(f";Z:{0.6 * (i + 1) / n:.5g}\n;HEIGHT:{0.6 / n:.4g}\n;LAYER:{i}\n")
        assert ";TYPE:External perimeter" in item
        assert ("Support" in item) == (i % n == n - 1)
        lines = re.findall(r"G0 X(\S+) Y(\S+) F6000\nG1 X(\S+) Y(\S+)", item.partition(";TYPE:Solid")[2])
        x0, y0, x1, y1 = map(float, lines[0])
        fills.append(across([(x0, y0), (x1, y1)]))
    turns(fills, n)
    volume = {"T0": 0.0, "T1": 0.0}
    tool = ""
    for line in text.splitlines():
        tool = line if line in volume else tool
        if e := re.search(r"^G1 .* E([0-9.]+)", line):
            volume[tool] += float(e[1]) * np.pi * 1.75**2 / 4
    ice = sum(
        k.part_boundary.lengths().sum() + k.ice_fill(i).lengths().sum() for k in stack(n) for i in range(n)
    )
    warm = sum(k.scaffold_boundary.lengths().sum() + k.scaffold_fill.lengths().sum() for k in stack(n))
    assert volume["T0"] == pytest.approx(ice * 1.5 * 0.6 / n, rel=1e-3)
    assert volume["T1"] == pytest.approx(warm * 1.25 * 0.6, rel=1e-3)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_cli(tmp_path: Path, n: int) -> None:
    text = written("cli", tmp_path, n).read_text()
    assert f"$$LAYERS/{3 * n + 1:06d}" in text
    bottom, *found = text.split("$$LAYER/")[1:]
    assert float(bottom) == 0
    assert [float(k.split()[0]) for k in found] == pytest.approx([0.6 * (i + 1) / n for i in range(3 * n)], abs=1e-4)
    fills = []
    for i, item in enumerate(found):
        assert item.count("$$POLYLINE/1,") == 2
        assert item.count("$$POLYLINE/2,") == (2 if i % n == n - 1 else 0)
        values = [float(v) for v in re.search(r"HATCHES/1,\d+,(\S+)", item)[1].split(",")]
        fills.append(across(np.reshape(values[:4], (2, 2))))
    turns(fills, n)


@pytest.mark.parametrize("n", [2, 3])
def test_fab(tmp_path: Path, n: int) -> None:
    fills, scaffold, heights = [], set(), []
    for path in ET.parse(written("fab", tmp_path, n)).getroot().iterfind("path"):
        points = [[float(p.findtext(c) or "nan") for c in "xyz"] for p in path.iterfind("point")]
        z = points[0][2]
        if path.findtext("materialCalibrationName") == "scaffold":
            scaffold.add(z)
        elif len(points) == 2 and z not in heights:
            heights.append(z)
            fills.append(across([p[:2] for p in points]))
    assert heights == pytest.approx([0.6 * (i + 1) / n for i in range(3 * n)], abs=1e-4)
    assert sorted(scaffold) == pytest.approx([0.6, 1.2, 1.8])
    turns(fills, n)


@pytest.mark.parametrize("n", [2, 3])
def test_csv_and_dxf(tmp_path: Path, n: int) -> None:
    cells = [row.split(",") for row in written("csv", tmp_path, n).read_text().splitlines()[1:]]
    fills: dict[tuple[int, int], list[tuple[float, float]]] = {}
    for k, ice, _, material, kind, path, x, y in cells:
        if (material, kind, path) == ("part", "fill", "0"):
            fills.setdefault((int(k), int(ice)), []).append((float(x), float(y)))
    assert list(fills) == [(k, i) for k in range(3) for i in range(n)]
    turns([across(ends) for ends in fills.values()], n)
    ezdxf = pytest.importorskip("ezdxf")
    found: dict[float, bool] = {}
    for entity in ezdxf.readfile(written("dxf", tmp_path, n)).modelspace():
        points = [tuple(v.dxf.location) for v in entity.vertices]
        if entity.dxf.layer == "PART_FILL":
            found[points[0][2]] = across([p[:2] for p in points])
    assert list(found) == pytest.approx([0.6 * (i + 1) / n for i in range(3 * n)], abs=1e-4)
    turns(list(found.values()), n)


@pytest.mark.parametrize("n", [1, 2])
def test_npz_and_svg_hold_both_fills(tmp_path: Path, n: int) -> None:
    with np.load(written("npz", tmp_path, n)) as found:
        assert found["part_second_fill_layers"].tolist() == ([0, 1, 2, 3] if n == 2 else [0, 1, 3, 4])
    folder = written("svg", tmp_path, n)
    for k, item in enumerate(stack(n)):
        root = ET.parse(folder / f"layer_{k:04d}.svg").getroot()
        ids = {e.attrib["id"]: e for e in root.iter() if "id" in e.attrib}
        assert ("part_second_fill" in ids) == (n == 2)
        assert ids["part_fill"].attrib["d"].count("M") == len(item.part_fill)
        if n == 2:
            assert ids["part_second_fill"].attrib["d"].count("M") == len(item.part_second_fill)


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("name", ["gcode", "cli", "cli-binary", "csv", "dxf", "fab"])
def test_check_reads_slices(tmp_path: Path, name: str, n: int) -> None:
    theirs = readers.read(written(name, tmp_path, n))
    assert len(theirs.layers) == 3
    top = n == 1 and "cli" in name  # which says nothing of ice layers then; the others tell where slices were cut
    assert theirs.z_is == ("top" if top else "middle")
    want = [0.6, 1.2, 1.8] if top else [0.3, 0.9, 1.5]
    assert [k.z for k in theirs.layers] == pytest.approx(want, abs=1e-6)
    for k, item in zip(theirs.layers, stack(n), strict=True):
        assert k.beads is not None
        assert int((k.beads.role == OUTER).sum()) == 2
        assert int((k.beads.role == FILL).sum()) == (0 if "cli" in name else len(item.part_fill))
        assert (k.beads.role == SUPPORT).any()  # that of the last ice layer
        np.testing.assert_allclose(k.beads.points[: k.beads.offsets[1] - 1], item.part_boundary[0], atol=1e-4)


def test_check_finds_an_ice_layer_with_another_boundary(tmp_path: Path) -> None:
    path = written("cli", tmp_path, 2)
    head, *found = path.read_text().split("$$LAYER/")
    x = re.search(r"POLYLINE/1,1,\d+,([0-9.]+)", found[2])[1]
    found[2] = found[2].replace(x, f"{float(x) + 1:.4f}", 1)
    path.write_text("$$LAYER/".join([head, *found]))
    heights = [k.z for k in readers.read(path).layers]
    assert heights == pytest.approx([0.3, 0.3, 0.9, 1.5])


def test_a_run_is_checked_by_its_own_gcode(tmp_path: Path) -> None:
    """A cone: heights that are off by a quarter of a slice would show."""
    body = models.revolve([(0, 0), (9, 0), (4, 6), (0, 6)], around=96)
    mesh = models.write_stl(tmp_path / "a.stl", body.triangles())
    file = models.write_params(tmp_path, mesh, thickness=0.4, scaffolding=0)
    assert main([str(file), "--export", "gcode", "--quiet", "-o", str(tmp_path / "out")]) == 0
    name = json.loads((tmp_path / "out/manifest.json").read_text())["name"]
    code = main(["check", str(file), "--against", str(tmp_path / f"out/{name}.gcode"), "-o", str(tmp_path / "check")])
    report = json.loads((tmp_path / "check/check.json").read_text())
    assert (code, report["verdict"]) == (0, "pass"), report
