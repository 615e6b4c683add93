"""The million-facet statue through every format that other tools read, and back by their readers or their parsers.

Formats that take long are written of every 15th layer. Areas of regions and of boundaries agree within 0.01 %.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import models
import numpy as np
import pytest
import shapely
from test_export_readers import DATA, SLIC3R, SVG, read_cli

from rasterslice import job
from rasterslice.export import FORMATS, Context
from rasterslice.grid import Grid
from rasterslice.params import Params
from rasterslice.paths import Layer, Paths
from rasterslice.spool import open_result

STATUE = models.SHARED_MODELS / "lucy_1M.ply"
STEM = "statue"
EVERY = 15


class Statue:
    """Its layers, and formats written when they are asked for."""

    def __init__(self, folder: Path) -> None:
        manifest = job.run(Params((STATUE,), export=("svg-single",)), out=folder / "run")
        grid = Grid(*(manifest["grid"][name] for name in ("x0", "y0", "pitch", "tiles_x", "tiles_y")))
        self.layers = open_result(folder / "run")
        self.some = [self.layers[k] for k in range(0, len(self.layers), EVERY)]
        self.context, self.folder = Context(STEM, grid, 0.4, 1.5, 1.5), folder

    def written(self, name: str, layers: Any) -> Path:
        path = self.folder / FORMATS[name].target.format(stem=STEM)
        FORMATS[name].write(layers, path, self.context)
        return path


@pytest.fixture(scope="module")
def statue(tmp_path_factory: pytest.TempPathFactory) -> Statue:
    if not STATUE.exists():
        pytest.skip(f"no {STATUE}")
    return Statue(tmp_path_factory.mktemp("statue"))


def enclosed(loops: list[Any]) -> float:
    """Return the area inside loops, even-odd, by shapely: holes and islands come in any order."""
    shape = shapely.Polygon()
    for loop in loops:
        if len(loop) > 2:
            shape = shape.symmetric_difference(shapely.Polygon(loop).buffer(0))
    return float(shape.area)


def same(found: float, paths: Paths | None, what: str) -> None:
    """Hold an area to 0.01 %, or where it is that small, to what the last digit of a coordinate can do."""
    assert paths is not None
    rounding = 1e-4 * float(paths.lengths().sum())
    assert found == pytest.approx(float(paths.areas().sum()), rel=1e-4, abs=rounding), what


def of_materials(layer: Layer, loops: dict[str, list[Any]]) -> None:
    for material, found in loops.items():
        same(enclosed(found), getattr(layer, f"{material}_boundary"), f"{material} of layer {layer.index}")


@pytest.mark.parametrize("name", ["cli", "cli-binary"])
def test_cli(statue: Statue, name: str) -> None:
    _, *found = read_cli(statue.written(name, statue.layers))
    assert len(found) == len(statue.layers)
    for layer in statue.some:
        items = found[layer.index][1]
        loops = {m: [p for i, way, p in items if i == n and way >= 0] for n, m in ((1, "part"), (2, "scaffold"))}
        of_materials(layer, loops)


def test_gcode(statue: Statue) -> None:
    parser = pytest.importorskip("gcodeparser")
    text = statue.written("gcode", statue.layers).read_text()
    head, *chunks = text.split(";LAYER_CHANGE\n")
    assert len(chunks) == len(statue.layers)
    assert "M83" in head
    for layer in statue.some:
        loops: dict[str, list[Any]] = {"part": [], "scaffold": []}
        # Fill has one kind in the part; in the scaffold a bead that does not close is fill.
        for kind, body in re.findall(r";TYPE:([^\n]*)\n(.*?)(?=;TYPE:|\Z)", chunks[layer.index], re.DOTALL):
            paths: list[list[tuple[float, float]]] = []
            for line in parser.parse_gcode_lines(body):
                if "X" in line.params:
                    if line.command == ("G", 0):
                        paths.append([])
                    paths[-1].append((line.params["X"], line.params["Y"]))
            material = "scaffold" if kind == "Support material" else "part"
            loops[material] += [p for p in paths if p[0] == p[-1]]
        of_materials(layer, loops)


def test_fab(statue: Statue) -> None:
    etree = pytest.importorskip("lxml.etree")
    tree = etree.parse(statue.written("fab", statue.some))
    etree.XMLSchema(etree.parse(DATA / "fab.xsd")).assertValid(tree)
    found: dict[float, dict[str, list[Any]]] = {}
    for path in tree.iterfind("path"):
        points = np.array([[float(v.text) for v in p] for p in path.iterfind("point")])
        if (points[0] == points[-1]).all():
            name = {"water": "part"}.get(path.findtext("materialCalibrationName"), "scaffold")
            found.setdefault(round(points[0, 2], 4), {"part": [], "scaffold": []})[name].append(points[:, :2])
    for layer in statue.some:
        of_materials(layer, found.get(round((layer.index + 1) * 0.4, 4), {"part": [], "scaffold": []}))


def test_dxf(statue: Statue) -> None:
    ezdxf = pytest.importorskip("ezdxf")
    found: dict[float, dict[str, list[Any]]] = {}
    for entity in ezdxf.readfile(statue.written("dxf", statue.some)).modelspace().query("POLYLINE"):
        if entity.is_closed:
            points = np.array([tuple(v.dxf.location) for v in entity.vertices])
            name = entity.dxf.layer.removesuffix("_BOUNDARY").lower()
            found.setdefault(round(points[0, 2], 4), {"part": [], "scaffold": []})[name].append(points[:, :2])
    for layer in statue.some:
        of_materials(layer, found.get(round((layer.index + 1) * 0.4, 4), {"part": [], "scaffold": []}))


def groups(path: Path) -> Iterator[Any]:
    etree = pytest.importorskip("lxml.etree")
    for _, element in etree.iterparse(path, tag=f"{{{SVG['s']}}}g"):
        yield element
        element.clear()


def test_svg_single(statue: Statue) -> None:
    count = 0
    for layer, group in zip(statue.layers, groups(statue.folder / "run" / f"{STATUE.stem}.svg"), strict=True):
        count += 1
        if layer.index % EVERY:
            continue
        assert float(group.get(SLIC3R + "slice-z")) == pytest.approx(layer.z)
        loops = [
            [[float(v) for v in p.split(",")] for p in polygon.get("points").split()]
            for polygon in group.findall("s:polygon", SVG)
        ]
        same(enclosed(loops), layer.part, f"part of layer {layer.index}")
        data = [e.get("d") for e in group.findall("s:path", SVG)]
        loops = [
            [[float(v) for v in p.split(",")] for p in loop.split()] for d in data for loop in re.findall("M([^Z]*)", d)
        ]
        same(enclosed(loops), layer.scaffold, f"scaffold of layer {layer.index}")
    assert count == 765


def test_csv_and_npz(statue: Statue) -> None:
    table = np.loadtxt(statue.written("csv", statue.some), delimiter=",", skiprows=1, dtype="U12", usecols=(0, 3, 4))
    total = sum(len(p.points) for k in statue.some for p in (k.part_boundary, k.scaffold_boundary))
    assert (table[:, 2] == "boundary").sum() == total
    with np.load(statue.written("npz", statue.layers)) as found:
        points, offsets = found["part_boundary_points"], found["part_boundary_offsets"]
        first = found["part_boundary_layers"]
        for layer in statue.some:
            ends = offsets[first[layer.index] : first[layer.index + 1] + 1]
            of_materials(layer, {"part": [points[a:b] for a, b in zip(ends[:-1], ends[1:], strict=True)]})


def test_pictures(statue: Statue) -> None:
    """A sample is exact to half a step of 255: of small shapes that is more than 0.01 %."""
    tifffile = pytest.importorskip("tifffile")
    images = tifffile.imread(statue.written("tiff", statue.some))
    folder = statue.written("png", statue.some)
    for image, layer in zip(images, statue.some, strict=True):
        for channel, name in enumerate(("part", "scaffold")):
            want = getattr(layer, name)
            edge = float(want.lengths().sum()) / 0.2  # pixels that an edge crosses, about
            limit = 1e-4 * float(want.areas().sum()) + 0.04 / 510 * 3 * edge**0.5
            png = cv2.imread(str(folder / f"{name}_{layer.index:04d}.png"), cv2.IMREAD_UNCHANGED)
            for found in (image[channel], png):
                assert abs(found.sum(dtype=float) / 255 * 0.04 - want.areas().sum()) <= limit, f"{name} {layer.index}"
