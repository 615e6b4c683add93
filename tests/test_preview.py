"""The preview: a picture of the right thing, and the report of a run."""

from __future__ import annotations

import dataclasses
import json
import re
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from fakes import install, layer, pack, params_file, ring, washer

from rasterslice import job
from rasterslice.cli import main
from rasterslice.export import FORMATS, Context
from rasterslice.export.material import build_hours
from rasterslice.grid import cover
from rasterslice.params import Params, read_params
from rasterslice.profile import read_profile
from rasterslice.report import preview
from rasterslice.report.picture import nice, picture, short
from rasterslice.report.preview import LAYERS, PIXELS, STEPS, coarser
from rasterslice.report.shade import depths, shade

CONTEXT = Context("job", cover((-12, -12), (12, 12), 0.2, 1.0), 0.4, 1.5, 1.25)


def box_stl(path: Path, size: tuple[float, float, float]) -> Path:
    """Write a box as a binary STL."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32) * size
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    data = bytes(80) + struct.pack("<I", 12)
    for a, b, c, d in faces:
        for triangle in ((a, b, c), (a, c, d)):
            data += struct.pack("<12fH", 0, 0, 0, *corners[list(triangle)].ravel().tolist(), 0)
    path.write_bytes(data)
    return path


def test_a_mesh_needs_no_parameter_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh = box_stl(tmp_path / "box.stl", (70, 40, 20))
    assert main(["preview", str(mesh), "--html", "--json"]) == 0
    made = json.loads(capsys.readouterr().out)
    assert made["files"] == [str(tmp_path / "box.preview.png"), str(tmp_path / "box.preview.html")]
    assert (made["layers"], made["thickness"], made["facets"]) == (50, 0.4, 12)
    assert {"bounds", "read", "section", "picture", "html", "total"} <= made["seconds"].keys()
    image = cv2.imread(made["files"][0])
    assert image.shape == (1500, 2000, 3)
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 100
    assert sorted(p.name for p in tmp_path.iterdir()) == ["box.preview.html", "box.preview.png", "box.stl"]
    before = (tmp_path / "box.preview.png").read_bytes()
    assert main(["preview", str(mesh), "--quiet"]) == 0
    assert (tmp_path / "box.preview.png").read_bytes() == before
    assert capsys.readouterr() == ("", "")


def test_what_cannot_be_written_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh = box_stl(tmp_path / "box.stl", (10, 10, 4))
    (tmp_path / "box.preview.png").mkdir()
    assert main(["preview", str(mesh)]) == 2
    assert "box.preview.png: cannot be written: Is a directory; name another with -o" in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["box.preview.png", "box.stl"]


def test_a_page_of_somebody_else_is_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh = str(box_stl(tmp_path / "box.stl", (10, 10, 4)))
    (tmp_path / "mine.html").write_text("<title>mine</title>")
    assert main(["preview", mesh, "-o", str(tmp_path / "mine.png"), "--html"]) == 2
    assert "mine.html: is there and is no layer viewer" in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["box.stl", "mine.html"]
    for _ in range(2):  # our own is
        assert main(["preview", mesh, "-o", str(tmp_path / "other.png"), "--html"]) == 0


def test_a_parameter_file_can_be_previewed_in_full(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = params_file(tmp_path)
    box_stl(tmp_path / "cube.stl", (10, 10, 4))
    assert main(["preview", str(path), "--full", "--json", "-o", str(tmp_path / "x.png")]) == 0
    made = json.loads(capsys.readouterr().out)
    assert (made["layers"], made["pitch"]) == (10, 0.2)


SIZES = [
    (0.3, 0.2, 0.5), (5, 5, 5), (70, 40, 20), (900, 500, 800), (2, 2, 3000), (0.02, 0.02, 0.02), (6e4, 6e4, 6e4),
    (100, 100, 0.15), (100, 100, 1e-5), (5000, 5000, 5000), (1e-7, 1e-7, 1e-7), (9e5, 1e5, 2e5),
]  # fmt: skip


@pytest.mark.parametrize("size", SIZES)
def test_a_preview_of_any_size_is_small(tmp_path: Path, size: tuple[float, float, float]) -> None:
    params = coarser(Params((box_stl(tmp_path / "box.stl", size),)), free=True)
    factor = params.scaling[0] if params.scaling else 1.0
    wide, high = max(size[:2]) * factor, size[2] * factor
    assert 1 - 1e-6 <= high / params.thickness <= LAYERS + 1e-3
    assert high / params.thickness == pytest.approx(round(high / params.thickness), rel=1e-5)  # float32 has the mesh
    assert wide / params.pitch <= PIXELS + 1
    assert params.part_width < max(wide, high) / 4
    assert params.part_width >= 2 * params.pitch


@pytest.mark.parametrize("size", [(0.02, 0.02, 0.02), (6e4, 6e4, 6e4), (100, 100, 0.15), (1e-7, 2e-7, 1e-7)])
def test_a_picture_comes_out_of_any_mesh(
    tmp_path: Path, size: tuple[float, ...], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: dict[str, float] = {}

    def volume(layers: Any, context: Context, facts: str) -> bytes:
        seen["mm3"] = sum(item.stats["part_area"] for item in layers) * context.thickness
        seen["scaled"] = float((re.findall("scaled by ([0-9.e+-]+)", facts) or [1])[0])
        return picture(layers, context, facts)

    monkeypatch.setattr(preview, "picture", volume)
    assert main(["preview", str(box_stl(tmp_path / "box.stl", size)), "--json"]) == 0
    assert cv2.imread(json.loads(capsys.readouterr().out)["files"][0]) is not None
    assert seen["mm3"] == pytest.approx(float(np.prod(size)) * seen["scaled"] ** 3, rel=0.01)


def test_beads_of_a_parameter_file_widen_only_where_pixels_do(tmp_path: Path) -> None:
    small = Params((box_stl(tmp_path / "a.stl", (30, 30, 10)),), part_width=1.0, support_width=2.0)
    assert coarser(small, free=False) == small
    large = dataclasses.replace(small, files=(box_stl(tmp_path / "b.stl", (3200, 100, 100)),))
    found = coarser(large, free=False)
    assert (found.pitch, found.part_width, found.support_width, found.scaffold_buffer) == (10, 20, 40, 100)


def test_short_numbers() -> None:
    assert [short(v) for v in (0, 0.1499, 0.00012345, 9.876, 12.34, 305.61)] == [
        "0.0", "0.15", "0.000123", "9.88", "12.3", "305.6"
    ]  # fmt: skip


def test_nice_numbers() -> None:
    assert [nice(v) for v in (0.3, 1, 1.1, 49, 51)] == [0.5, 1, 2, 50, 100]
    assert nice(1.21, STEPS) == 1.5


def test_depths_are_those_of_round_beads() -> None:
    found = depths([pack([ring(10, 4000)], True), pack([], True)], 0.3, 241, -12.0, 0.1, 1.0)
    x = np.arange(241) * 0.1 - 12
    inside = np.abs(x) < 10.5
    assert found[0][inside] == pytest.approx(-np.sqrt(121 - x[inside] ** 2), abs=0.06)
    assert np.isinf(found[0][np.abs(x) > 11.05]).all()
    assert np.isinf(found[1]).all()


def test_a_turn_is_about_z_and_the_front_is_seen() -> None:
    square = pack([[(-1, -1), (5, -1), (5, 1), (-1, 1)]], True)
    front = depths([square], 0.0, 81, -8.0, 0.2, 0.0)[0]
    assert front[40] == -1
    assert np.flatnonzero(np.isfinite(front)).tolist() == list(range(35, 66))
    turned = depths([square], np.pi, 81, -8.0, 0.2, 0.0)[0]
    assert np.flatnonzero(np.isfinite(turned))[[0, -1]] == pytest.approx([15, 45], abs=1)


def test_what_faces_the_light_is_brighter() -> None:
    depth = np.repeat([np.abs(np.linspace(-8, 8, 161))], 40, axis=0)  # an edge towards the eye
    bright = shade(depth, (0.4, 0.1))
    assert bright[20, 40] > bright[20, 120] + 0.2
    assert not shade(np.full((5, 5), np.inf), (1, 1)).any()


def page_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, extra: str = "") -> tuple[str, dict[str, Any]]:
    install(monkeypatch)
    result = job.run(read_params(params_file(tmp_path, extra)))
    return (tmp_path / "job.slices" / "report.html").read_text(), result


def test_every_run_has_a_report_that_tells_about_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page, result = page_of(tmp_path, monkeypatch)
    assert result["exports"] == []
    assert result["seconds"]["report"] > 0
    assert "report.html" in [entry["path"] for entry in result["files"]]
    assert result["inputs"][0]["sha256"] in page
    for text in ("cube.stl: a warning", "scaffold_buffer", ">fake<", "<polygon class=part", "<td>export</td><td>0.0"):
        assert text in page
    assert "http" not in page.replace("http://www.w3.org", "")
    assert 'id="part_region" fill="#cfe8f5" fill-rule="evenodd" d=""' in page or "<figure>" not in page
    result = job.export_more(tmp_path / "job.slices", ["report"])
    assert result["exports"] == ["report.html"]


def test_the_report_is_well_formed_and_draws_the_worst(tmp_path: Path) -> None:
    items = [washer(k, 0.4 * (k + 0.5)) for k in range(8)]
    items[3] = layer(
        3, 1.4, part=pack([ring(2) + (4, 0), ring(0.3) - (4, 0)], True), part_boundary=pack([ring(1) + (4, 0)], True)
    )
    items[5] = layer(5, 2.2)
    for k in (3, 5):
        items[k].stats["flags"] = "lost"
    about = {"worst": {"lost_area": [{"layer": 3, "z": 1.4, "lost_area": 0.3}]}, "copies": [[0, 0], [30, 0]]}
    context = dataclasses.replace(CONTEXT, about=about, settings={"part_layers_per_slice": 2})
    FORMATS["report"].write(items, tmp_path / "report.html", context)
    page = (tmp_path / "report.html").read_text()
    assert page.count("<figure>") == 2
    circle = re.search('<circle class=lost cx="([-0-9.]+)" cy="([-0-9.]+)" r="([0-9.]+)"/>', page)
    assert circle is not None
    assert [float(v) for v in circle.groups()] == pytest.approx([-4, 0, 0.42], abs=0.02)
    assert "no path in this layer" in page
    assert "2 x 2 copies" in page
    volume = 2 * sum(item.stats["part_area"] for item in items) * 0.4 / 1000
    assert f"{volume:.1f} cm\N{SUPERSCRIPT THREE}" in page


def test_build_time_is_that_of_the_nozzles() -> None:
    row = {"part_boundary_mm": 3e6, "part_fill_mm": None, "scaffold_boundary_mm": 0.0, "scaffold_fill_mm": 6e6}
    profile = read_profile(None)
    hours = build_hours([row], {"part": 2, "scaffold": 1}, profile)
    assert hours["part"] == pytest.approx(2 * 3e6 / profile.part_nozzle.speed / 3600)
    assert hours["scaffold"] == pytest.approx(6e6 / profile.scaffold_nozzle.speed / 3600)


def test_a_machine_that_cannot_be_read_is_a_warning(tmp_path: Path) -> None:
    context = dataclasses.replace(CONTEXT, settings={"machine": str(tmp_path / "none.toml")}, warnings=[])
    FORMATS["report"].write([washer(0, 0.2)], tmp_path / "report.html", context)
    (warning,) = context.warnings
    assert warning.startswith("report: ")
    assert "none.toml" in warning
    assert "that of the default machine" in warning


def test_the_time_of_the_robot_is_told_where_it_is_known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page, _ = page_of(tmp_path, monkeypatch, "export = cobra\n")
    told = json.loads((tmp_path / "job.slices/job.cobra/JOB.json").read_text())["estimated_seconds"]
    assert f"The program of the robot takes {told / 3600:.1f} h" in page
