"""The whole program on real files and the real device: results, and every bad input of the issue."""

from __future__ import annotations

import csv
import json
import math
import os
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import models
import numpy as np
import pytest
from fakes import PARAMS, tree

import rasterslice
from rasterslice.cli import main
from rasterslice.params import read_params

COMMAND = [sys.executable, "-m", "rasterslice"]
ROOT = Path(__file__).resolve().parents[1]  # where `-m` finds a package that is not installed


def stl(path: Path, triangles: np.ndarray, count: int | None = None) -> Path:
    """Write a binary STL; `count` is what its header promises."""
    rows = np.zeros(len(triangles), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])
    rows["corners"] = triangles
    path.write_bytes(bytes(80) + struct.pack("<I", len(rows) if count is None else count) + rows.tobytes())
    return path


def cube(side: float = 8.0) -> np.ndarray:
    """Return 12 facets of a cube on the origin, counter-clockwise from outside."""
    quads = []
    for axis in range(3):
        for top in (0, 1):
            corners = np.zeros((4, 3))
            corners[:, axis] = top
            corners[:, (axis + 1) % 3] = (0, 1, 1, 0)
            corners[:, (axis + 2) % 3] = (0, 0, 1, 1)
            quads.append(corners if top else corners[::-1])
    return side * np.array([t for q in quads for t in (q[[0, 1, 2]], q[[0, 2, 3]])])


def sphere(radius: float, n: int = 96) -> np.ndarray:
    """Return a sphere on z = 0 from bands of latitude."""
    lat, lon = np.meshgrid(np.linspace(0, np.pi, n // 2 + 1), np.linspace(0, 2 * np.pi, n + 1), indexing="ij")
    lon[:, -1] = lon[:, 0]
    p = radius * np.stack([np.sin(lat) * np.cos(lon), np.sin(lat) * np.sin(lon), 1 - np.cos(lat)], axis=-1)
    p[0, :, :2] = p[-1, :, :2] = 0
    a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
    facets = np.stack([a, c, b, a, d, c], axis=2).reshape(-1, 3, 3)
    sides = np.linalg.norm(facets - np.roll(facets, 1, axis=1), axis=2)
    return facets[(sides > 0).all(axis=1)]  # at a pole one of the two has no width


@pytest.fixture
def job(tmp_path: Path) -> Path:
    stl(tmp_path / "cube.stl", cube())
    (tmp_path / "job.txt").write_text(PARAMS)
    return tmp_path / "job.txt"


def test_a_cube_in_a_process_of_its_own(job: Path) -> None:
    done = subprocess.run(
        [*COMMAND, str(job), "--export", "svg,sheet"], capture_output=True, text=True, check=False, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    out = job.parent / "job.slices"
    assert str(out / "sheet.png") in done.stdout
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["layers"] == 20
    rows = list(csv.DictReader((out / "layers.csv").read_text().splitlines()))
    assert [float(row["z"]) for row in rows] == pytest.approx([0.4 * k + 0.2 for k in range(20)])
    for row in rows:
        assert float(row["part_area"]) == pytest.approx(64, abs=4 * 0.25 * 0.2**2 * 1.5)  # images cut corners
        assert float(row["part_area_exact"]) == pytest.approx(64, abs=1e-3)
        assert row["open_rows"] == "0"
    layers = rasterslice.open(out)
    for layer in layers:
        assert layer.part is not None
        (region,), (path,) = layer.part, layer.part_boundary
        assert region.min(axis=0) == pytest.approx((0, 0), abs=0.02)
        assert region.max(axis=0) == pytest.approx((8, 8), abs=0.02)
        assert path.min(axis=0) == pytest.approx((0.75, 0.75), abs=0.05)
        assert path.max(axis=0) == pytest.approx((7.25, 7.25), abs=0.05)
        assert len(layer.part_fill) in (4, 5)
    assert len(list((out / "svg").iterdir())) == 20
    assert cv2.imread(str(out / "sheet.png")).shape[1] == 2000


def test_a_sphere_has_its_volume_and_scaffold_under_the_waist(tmp_path: Path) -> None:
    stl(tmp_path / "cube.stl", sphere(6.0, 192))
    (tmp_path / "job.txt").write_text(PARAMS)
    assert main([str(tmp_path / "job.txt"), "--quiet"]) == 0
    out = tmp_path / "job.slices"
    totals = json.loads((out / "manifest.json").read_text())["totals"]
    assert totals["part_mm3"] == pytest.approx(4 / 3 * math.pi * 6**3, rel=0.005)
    rows = list(csv.DictReader((out / "layers.csv").read_text().splitlines()))
    grown = math.pi * 11**2
    assert float(rows[0]["scaffold_area"]) == pytest.approx(grown - float(rows[0]["part_area"]), rel=0.005)
    assert float(rows[-1]["scaffold_area"]) == 0


def test_python_gives_what_the_folder_holds(job: Path) -> None:
    assert main([str(job), "--quiet"]) == 0
    computed = list(rasterslice.slice(read_params(job)))
    assert [layer.index for layer in computed] == list(range(20))[::-1]
    for a, b in zip(reversed(computed), rasterslice.open(job.parent / "job.slices"), strict=True):
        assert a.stats == b.stats
        assert a.part_boundary.points.tobytes() == b.part_boundary.points.tobytes()
        assert a.scaffold_fill.offsets.tobytes() == b.scaffold_fill.offsets.tobytes()


def test_the_same_bytes_twice(job: Path) -> None:
    folders = [job.parent / name for name in "ab"]
    for folder in folders:
        assert main([str(job), "--quiet", "--export", "svg,sheet", "-o", str(folder)]) == 0
    a, b = (tree(folder, but=("manifest.json", "report.html")) for folder in folders)
    assert a == b


def test_a_dry_run_and_the_devices(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = tree(job.parent)
    assert main([str(job), "--dry-run", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["layers"] == 20
    assert main(["devices", "--json"]) == 0
    assert set(json.loads(capsys.readouterr().out)[0]) >= {"name", "platform", "kind", "driver", "memory_mb", "usable"}
    assert tree(job.parent) == before


def broken(triangles: np.ndarray, value: float) -> np.ndarray:
    triangles = triangles.copy()
    triangles[7, 1, 2] = value
    return triangles


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-77])


# what is done to a sound job, further arguments, exit code, what the one line must name
BAD: dict[str, tuple[Callable[[Path], object], list[str], int, str]] = {
    "missing mesh": (lambda f: (f / "cube.stl").unlink(), [], 3, "cube.stl"),
    "empty mesh": (lambda f: (f / "cube.stl").write_bytes(b""), [], 3, "cube.stl"),
    "no facets": (lambda f: stl(f / "cube.stl", cube()[:0]), [], 3, "cube.stl"),
    "not a number": (lambda f: stl(f / "cube.stl", broken(cube(), math.nan)), [], 3, "cube.stl"),
    "infinite": (lambda f: stl(f / "cube.stl", broken(cube(), math.inf)), [], 3, "cube.stl"),
    "truncated": (lambda f: cut(f / "cube.stl"), [], 3, "cube.stl"),
    "promises more": (lambda f: stl(f / "cube.stl", cube(), 1000), [], 3, "1000"),
    "mesh is a folder": (lambda f: ((f / "cube.stl").unlink(), (f / "cube.stl").mkdir()), [], 3, "cube.stl"),
    "missing parameters": (lambda f: (f / "job.txt").unlink(), [], 2, "job.txt"),
    "empty parameters": (lambda f: (f / "job.txt").write_bytes(b""), [], 2, "job.txt"),
    "unwritable output": (lambda f: None, ["-o", "/proc/out"], 2, "/proc/out"),
    "output is not ours": (lambda f: (f / "job.slices").mkdir(), [], 2, "job.slices"),
    "pitch and memory": (
        lambda f: (f / "job.txt").write_text(PARAMS + "memory_mb = 1\n"), ["--pitch", "0.002"], 2, "pitch",
    ),
    "thick slices": (
        lambda f: (f / "job.txt").write_text(PARAMS.replace("\n0.4\n", "\n40\n")), [], 2, "40",
    ),
    "unknown device": (lambda f: None, ["--device", "no such device"], 5, "no such device"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_with_its_code_and_leaves_nothing(
    job: Path, capsys: pytest.CaptureFixture[str], case: str
) -> None:
    harm, argv, code, name = BAD[case]
    harm(job.parent)
    before = tree(job.parent)
    assert main([str(job), *argv]) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("rasterslice: error: ")
    assert err.count("\n") == 1
    assert name in err
    assert "Traceback" not in err
    assert tree(job.parent) == before
    assert not list(job.parent.glob(".*"))


@pytest.mark.skipif(os.name != "posix", reason="sends a POSIX signal")
def test_ctrl_c_while_slicing(tmp_path: Path) -> None:
    stl(tmp_path / "cube.stl", sphere(40.0, 400))
    (tmp_path / "job.txt").write_text(PARAMS.replace("\n0.4\n", "\n0.05\n") + "pitch = 0.05\n")
    before = tree(tmp_path)
    with subprocess.Popen([*COMMAND, str(tmp_path / "job.txt")], stderr=subprocess.PIPE, text=True, cwd=ROOT) as child:
        points = tmp_path / f".job.slices.part-{child.pid}" / "layers" / "points.f64"
        end = time.monotonic() + 60
        while not (points.exists() and points.stat().st_size) and time.monotonic() < end:
            time.sleep(0.02)
        child.send_signal(signal.SIGINT)
        assert child.wait(60) == 130
        assert child.stderr is not None
        assert child.stderr.read() == "rasterslice: error: interrupted\n"
    assert tree(tmp_path) == before
    assert not list(tmp_path.glob(".*"))


def test_a_mesh_or_parameters_that_are_no_file_on_disk(tmp_path):
    """A pipe blocks its reader and a device never ends: both are refused before they are opened."""
    pipe = tmp_path / "pipe.stl"
    os.mkfifo(pipe)
    for mesh in (pipe, Path("/dev/zero")):
        file = models.write_params(tmp_path, mesh)
        done = subprocess.run(
            [sys.executable, "-m", "rasterslice", str(file)], capture_output=True, text=True, timeout=60
        )
        assert done.returncode == 3 and "is not a file on disk" in done.stderr
    done = subprocess.run([sys.executable, "-m", "rasterslice", str(pipe)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and "is not a file on disk" in done.stderr
