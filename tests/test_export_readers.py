"""Every format read back, by a reader of another project where there is one: nothing is lost, and areas agree."""

from __future__ import annotations

import re
import struct
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import shapely
from fakes import layer, pack, ring, washer

from rasterslice.export import FORMATS, Context
from rasterslice.export.coverage import coverage
from rasterslice.grid import cover
from rasterslice.paths import DEPOSITION, Layer, Paths

CONTEXT = Context("job", cover((-12, -12), (12, 12), 0.2, 1.0), 0.4, 1.5, 1.25)
LAYERS = [washer(k, 0.4 * (k + 0.5)) for k in range(3)]
DATA = Path(__file__).parent / "data"
SVG = {"s": "http://www.w3.org/2000/svg"}
SLIC3R = "{http://slic3r.org/namespaces/slic3r}"


def written(name: str, folder: Path, layers: Sequence[Layer] = LAYERS) -> Path:
    target = folder / FORMATS[name].target.format(stem="job")
    FORMATS[name].write(layers, target, CONTEXT)
    return target


def area(loops: list[Any]) -> float:
    """Return the area of an outer loop with holes, by shapely."""
    return float(shapely.Polygon(loops[0], loops[1:]).area) if loops else 0.0


def same_area(found: float, paths: Paths | None) -> None:
    assert paths is not None
    assert found == pytest.approx(paths.areas().sum(), rel=1e-4)


def test_svg_single_has_polygons_in_the_layout_of_slic3r(tmp_path: Path) -> None:
    root = ET.parse(written("svg-single", tmp_path)).getroot()
    groups = root.findall("s:g", SVG)
    assert [g.get("id") for g in groups] == ["layer0", "layer1", "layer2"]
    assert [float(g.get(SLIC3R + "z")) for g in groups] == pytest.approx([0.4, 0.8, 1.2])
    assert [float(g.get(SLIC3R + "slice-z")) for g in groups] == pytest.approx([0.2, 0.6, 1.0])
    assert {g.get(SLIC3R + "layer-height") for g in groups} == {"0.4000"}
    for group, item in zip(groups, LAYERS, strict=True):
        polygons = group.findall("s:polygon", SVG)
        assert [p.get(SLIC3R + "type") for p in polygons] == ["contour", "hole"]
        loops = [[[float(v) for v in p.split(",")] for p in e.get("points").split()] for e in polygons]
        same_area(area(loops), item.part)
        low, high = np.min(loops[0], axis=0), np.max(loops[0], axis=0)
        assert low.min() > 0
        assert high.max() < float(root.get("width"))
        (support,) = group.findall("s:path", SVG)
        data = re.findall("M([^Z]*)", support.get("d"))
        loops = [[[float(v) for v in p.split(",")] for p in loop.split()] for loop in data]
        same_area(area(loops), item.scaffold)


def test_svg_single_is_not_mirrored(tmp_path: Path) -> None:
    item = layer(0, 0.2, part=pack([[(0, 0), (9, 0), (0, 3)]], True))
    (polygon,) = ET.parse(written("svg-single", tmp_path, [item])).getroot().iterfind(".//s:polygon", SVG)
    corner, right, up = (np.array([float(v) for v in p.split(",")]) for p in polygon.get("points").split())
    assert (right - corner).tolist() == pytest.approx([9, 0])
    assert (up - corner).tolist() == pytest.approx([0, -3])  # down is positive


def read_cli(path: Path) -> list[tuple[float, list[tuple[int, int, np.ndarray]]]]:
    """Read what the standard says: (height, [(label, direction or -1 for hatches, points)]) of each layer."""
    data = path.read_bytes()
    head, found, body = data.partition(b"$$HEADEREND")
    assert found
    assert head.startswith(b"$$HEADERSTART\n")
    layers: list[tuple[float, list[tuple[int, int, np.ndarray]]]] = []
    if b"$$ASCII" in head:
        for line in body.decode("ascii").split():
            command, _, rest = line.partition("/")
            numbers = [float(v) for v in rest.split(",") if v]
            if command == "$$LAYER":
                layers.append((numbers[0], []))
            elif command == "$$POLYLINE":
                assert len(numbers) == 3 + 2 * numbers[2]
                layers[-1][1].append((int(numbers[0]), int(numbers[1]), np.reshape(numbers[3:], (-1, 2))))
            elif command == "$$HATCHES":
                assert len(numbers) == 2 + 4 * numbers[1]
                layers[-1][1].append((int(numbers[0]), -1, np.reshape(numbers[2:], (-1, 2))))
        return layers
    at = 0
    while at < len(body):
        (word,) = struct.unpack_from("<H", body, at)
        at += 2
        if word == 127:
            layers.append((struct.unpack_from("<f", body, at)[0], []))
            at += 4
        else:
            head3 = word == 130
            numbers = struct.unpack_from("<iii" if head3 else "<ii", body, at)
            at += 4 * len(numbers)
            n = 2 * numbers[-1] if head3 else 4 * numbers[-1]
            points = np.frombuffer(body, "<f4", n, at).reshape(-1, 2)
            layers[-1][1].append((numbers[0], numbers[1] if head3 else -1, points))
            at += 4 * n
    return layers


@pytest.mark.parametrize("name", ["cli", "cli-binary"])
def test_cli_holds_contours_and_hatches(tmp_path: Path, name: str) -> None:
    path = written(name, tmp_path)
    zero, *found = read_cli(path)
    assert b"$$LAYERS/000004\n" in path.read_bytes()
    assert zero == (0.0, [])
    assert [z for z, _ in found] == pytest.approx([0.4, 0.8, 1.2])
    for (_, items), want in zip(found, LAYERS, strict=True):
        for label, material in ((1, "part"), (2, "scaffold")):
            loops = [(way, p) for i, way, p in items if i == label and way >= 0]
            assert [way for way, _ in loops] == [1, 0]
            assert all((p[0] == p[-1]).all() for _, p in loops)
            same_area(area([p for _, p in loops]), getattr(want, f"{material}_boundary"))
            (lines,) = [p for i, way, p in items if i == label and way == -1]
            assert lines == pytest.approx(getattr(want, f"{material}_fill").points, abs=1e-4)


def test_gcode_lays_every_bead_once(tmp_path: Path) -> None:
    text = written("gcode", tmp_path).read_text()
    assert text.count(";LAYER_CHANGE\n") == 3
    assert [float(z) for z in re.findall(r";Z:(.*)", text)] == pytest.approx([0.4, 0.8, 1.2])
    assert set(re.findall(r";TYPE:(.*)", text)) == {"External perimeter", "Solid infill", "Support material"}
    length = {"part": 0.0, "scaffold": 0.0}
    for item in LAYERS:
        for material in length:
            length[material] += getattr(item, f"{material}_boundary").lengths().sum()
            length[material] += getattr(item, f"{material}_fill").lengths().sum()
    volume = {"T0": 0.0, "T1": 0.0}
    tool = ""
    for line in text.splitlines():
        tool = line if line in volume else tool
        e = re.search(r"^G1 .* E([0-9.]+)", line)
        if e:
            volume[tool] += float(e[1]) * np.pi * 1.75**2 / 4
    assert volume["T0"] == pytest.approx(length["part"] * 1.5 * 0.4, rel=1e-4)
    assert volume["T1"] == pytest.approx(length["scaffold"] * 1.25 * 0.4, rel=1e-4)


def test_gcode_is_read_by_another_parser(tmp_path: Path) -> None:
    parser = pytest.importorskip("gcodeparser")
    lines = parser.parse_gcode_lines(written("gcode", tmp_path, LAYERS[:1]).read_text())
    loops: list[list[tuple[float, float]]] = []
    for line in lines:
        if "X" in line.params:
            if line.command == ("G", 0):
                loops.append([])
            loops[-1].append((line.params["X"], line.params["Y"]))
    same_area(area(loops[:2]), LAYERS[0].part_boundary)
    same_area(area([p for p in loops if len(p) > 2][2:]), LAYERS[0].scaffold_boundary)


def test_fab_follows_its_schema(tmp_path: Path) -> None:
    etree = pytest.importorskip("lxml.etree")
    tree = etree.parse(written("fab", tmp_path))
    etree.XMLSchema(etree.parse(DATA / "fab.xsd")).assertValid(tree)
    names = [e.text for e in tree.iterfind("materialCalibration/name")]
    loops = {name: [] for name in names}
    for path in tree.iterfind("path"):
        points = [[float(p.findtext(c)) for c in "xyz"] for p in path.iterfind("point")]
        if points[0][2] == 0.4 and len(points) > 2:
            loops[path.findtext("materialCalibrationName")].append(np.array(points)[:, :2])
    same_area(area(loops["water"]), LAYERS[0].part_boundary)
    same_area(area(loops["scaffold"]), LAYERS[0].scaffold_boundary)


def test_dxf_is_read_by_ezdxf_and_trimesh(tmp_path: Path) -> None:
    ezdxf = pytest.importorskip("ezdxf")
    path = written("dxf", tmp_path, LAYERS[:1])
    loops: dict[str, list[Any]] = {}
    for entity in ezdxf.readfile(path).modelspace():
        points = [tuple(v.dxf.location) for v in entity.vertices]
        assert {p[2] for p in points} == {0.4}  # the upper surface
        assert entity.is_closed == entity.dxf.layer.endswith("BOUNDARY")
        loops.setdefault(entity.dxf.layer, []).append([p[:2] for p in points])
    assert set(loops) == {"PART_BOUNDARY", "PART_FILL", "SCAFFOLD_BOUNDARY", "SCAFFOLD_FILL"}
    same_area(area(loops["PART_BOUNDARY"]), LAYERS[0].part_boundary)
    same_area(area(loops["SCAFFOLD_BOUNDARY"]), LAYERS[0].scaffold_boundary)


def test_csv_has_every_vertex(tmp_path: Path) -> None:
    header, *rows = written("csv", tmp_path).read_text().splitlines()
    assert header == "layer,ice,z,material,kind,path,x,y"
    cells = [row.split(",") for row in rows]
    loops: dict[str, list[Any]] = {}
    for number, ice, z, material, kind, loop, x, y in cells:
        assert ice == "0"
        assert float(z) == pytest.approx(0.4 * (int(number) + 0.5))
        if (number, material, kind) == ("1", "part", "boundary"):
            loops.setdefault(loop, []).append((float(x), float(y)))
    same_area(area(list(loops.values())), LAYERS[1].part_boundary)
    assert len(rows) == sum(len(getattr(item, name).points) for item in LAYERS for name in DEPOSITION)


def test_npz_holds_the_same_bits(tmp_path: Path) -> None:
    with np.load(written("npz", tmp_path)) as found:
        assert found["index"].tolist() == [0, 1, 2]
        assert found["stats_part_area"].tolist() == [item.stats["part_area"] for item in LAYERS]
        for name in ("part", "scaffold", "part_boundary", "scaffold_boundary", "part_fill", "scaffold_fill"):
            points, offsets, first = (found[f"{name}_{what}"] for what in ("points", "offsets", "layers"))
            for k, item in enumerate(LAYERS):
                ends = offsets[first[k] : first[k + 1] + 1]
                got = [points[a:b] for a, b in zip(ends[:-1], ends[1:], strict=True)]
                assert all((a == b).all() for a, b in zip(got, getattr(item, name), strict=True))


def test_tiff_has_scale_channels_and_area(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    with tifffile.TiffFile(written("tiff", tmp_path)) as file:
        assert file.is_ome
        images, xml = file.asarray(), file.ome_metadata
        assert file.series[0].axes == "ZCYX"
    pixels = ET.fromstring(xml).find(".//{*}Pixels")
    assert [float(pixels.get(f"PhysicalSize{a}")) for a in "XYZ"] == [0.2, 0.2, 0.4]
    assert {pixels.get(f"PhysicalSize{a}Unit") for a in "XYZ"} == {"mm"}
    assert [c.get("Name") for c in pixels.iterfind("{*}Channel")] == ["part", "scaffold"]
    for image, item in zip(images, LAYERS, strict=True):
        same_area(image[0].sum() / 255 * 0.04, item.part)
        same_area(image[1].sum() / 255 * 0.04, item.scaffold)


def test_png_has_scale_and_area_and_is_not_mirrored(tmp_path: Path) -> None:
    item = layer(7, 0.2, part=pack([[(0, 0), (9, 0), (0, 3)]], True))
    folder = written("png", tmp_path, [item])
    assert sorted(p.name for p in folder.iterdir()) == ["part_0007.png", "scaffold_0007.png"]
    data = (folder / "part_0007.png").read_bytes()
    assert struct.unpack(">IIB", data.partition(b"pHYs")[2][:9]) == (5000, 5000, 1)
    assert b"layer 7; z 0.2000 mm; pitch 0.2 mm" in data
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert image.ndim == 2
    assert image.sum() / 255 * 0.04 == pytest.approx(13.5, rel=1e-3)  # a third of its pixels are cut by the edge
    rows, columns = np.nonzero(image)
    (x, y), (u, v) = CONTEXT.grid.to_pixels([(0, 0), (9, 3)])
    assert (columns.min(), columns.max()) == pytest.approx((x, u), abs=1)
    assert (rows.min(), rows.max()) == pytest.approx((CONTEXT.grid.height - 1 - v, CONTEXT.grid.height - 1 - y), abs=1)


def test_coverage_of_a_pixel_is_its_area_inside() -> None:
    grid = CONTEXT.grid
    loops = [ring(8.1) + (0.03, 0.07), ring(3, clockwise=True)]
    shape, image = shapely.Polygon(loops[0], [loops[1]]), coverage(pack(loops, True), grid)
    assert image.sum() * 0.04 == pytest.approx(shape.area, rel=1e-6)
    for j, i in np.argwhere((image > 0) & (image < 1))[::7]:
        x, y = grid.to_mm((i, j))
        square = shapely.box(x - 0.1, y - 0.1, x + 0.1, y + 0.1)
        assert image[j, i] == pytest.approx(shape.intersection(square).area / 0.04, abs=1e-6)
    assert not coverage(None, grid).any()
    assert coverage(pack([ring(500)], True), grid).all()


def test_memory_does_not_grow_with_layers(tmp_path: Path) -> None:
    """Writers take layers one by one, and keep none (cobra plans 64 layers at a time)."""
    import gc
    import weakref

    alive: list[weakref.ref[Any]] = []

    class Lazy(Sequence[Layer]):
        def __len__(self) -> int:
            return 40

        def __getitem__(self, k: Any) -> Any:
            item = washer(range(40)[k], 0.4 * (range(40)[k] + 0.5))
            gc.collect(0)
            assert sum(ref() is not None for ref in alive) <= 12
            alive.append(weakref.ref(item.part_boundary.points))
            return item

    for name in FORMATS:
        if name not in ("sheet", "report", "cobra"):
            alive.clear()
            written(name, tmp_path, Lazy())
