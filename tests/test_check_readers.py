"""Readers of check: every format gives the same loops back, and damage is one line with its place."""

import math
import struct

import models
import numpy as np
import plants
import pytest
from shapely.geometry import MultiPolygon, Point, Polygon, box

from rasterslice.check.form import FILL
from rasterslice.check.readers import read
from rasterslice.check.run import check
from rasterslice.errors import ModelError

T = 0.4


@pytest.fixture(scope="module")
def slices():
    ring = Polygon(Point(0, 0).buffer(8).exterior.coords, [Point(0, 0).buffer(3).exterior.coords])
    return [plants.Slice(T * (k + 0.5), plants.clean(MultiPolygon([ring, box(12, -4, 18, 4)]))) for k in range(5)]


def area(layer):
    shapes = [Polygon(p) for p in layer.loops]
    inside = [any(q is not p and q.contains(p) for q in shapes) for p in shapes]
    return sum(-p.area if hole else p.area for p, hole in zip(shapes, inside, strict=True))


@pytest.mark.parametrize("kind", plants.AREA_WRITERS)
def test_areas_come_back(kind, slices, tmp_path):
    suffix, write = plants.AREA_WRITERS[kind]
    found = read(write(slices, tmp_path / f"layers{suffix}", T))
    assert len(found.layers) == len(slices)
    for k, layer in enumerate(found.layers):
        assert area(layer) == pytest.approx(slices[k].region.area, rel=2e-2 if kind in plants.PICTURED else 1e-4)
    z = [layer.z for layer in found.layers]
    due = {"top": [T * (k + 1) for k in range(5)], "middle": [T * (k + 0.5) for k in range(5)], "number": range(5)}
    assert z == pytest.approx(list(due[found.z_is or "middle"]), abs=1e-5)


@pytest.mark.parametrize("kind", plants.BEAD_WRITERS)
def test_beads_come_back(kind, slices, tmp_path):
    suffix, write = plants.BEAD_WRITERS[kind]
    found = read(write(slices, tmp_path / f"layers{suffix}", T))
    assert kind.split()[-1] in found.format
    assert len(found.layers) == len(slices) and found.z_is == "top"
    for k, layer in enumerate(found.layers):
        walls, fill = plants.beads_of(slices[k], 0.8)
        roles = layer.beads.role
        outer = roles < FILL
        assert outer.sum() == len(walls) and (~outer).sum() == len(fill)
        assert layer.z == pytest.approx(T * (k + 1))
        due = sum(float(np.hypot(*np.diff(p, axis=0).T).sum()) for p in [*walls, *fill])
        step = np.hypot(*np.diff(layer.beads.points, axis=0).T)
        step[layer.beads.offsets[1:-1] - 1] = 0
        assert step.sum() == pytest.approx(due, rel=1e-3)


def gcode(tmp_path, *lines):
    path = tmp_path / "x.gcode"
    path.write_text("\n".join((";LAYER_CHANGE", "G1 Z.4", ";TYPE:External perimeter", *lines)) + "\n")
    return read(path)


def test_arcs(tmp_path):
    layer = gcode(tmp_path, "G92 E0", "G0 X10 Y0", "G3 X-10 Y0 I-10 J0 E1", "G3 X10 Y0 I10 J0 E2").layers[0]
    assert np.hypot(*layer.beads.points.T) == pytest.approx(10, abs=1e-9)
    assert len(layer.beads.role) == 1
    assert Polygon(layer.beads.points).area == pytest.approx(math.pi * 100, rel=2e-3)
    clockwise = gcode(tmp_path, "G0 X10 Y0", "G2 X-10 Y0 I-10 J0 E1").layers[0]
    assert clockwise.beads.points[:, 1].min() == pytest.approx(-10, abs=0.01)


def test_relative_everything(tmp_path):
    layer = gcode(tmp_path, "M83", "G0 X1 Y1", "G1 X3 E.1", "G1 Y3 E.1", "G1 E-2", "G0 X9 Y9", "G1 X8 E.1").layers[0]
    assert layer.beads.offsets.tolist() == [0, 3, 5]
    inches = gcode(tmp_path, "G20", "M82", "G0 X1 Y1", "G1 X2 E.1").layers[0]
    assert inches.beads.points[-1].tolist() == [50.8, 25.4]


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("a.gcode", b";LAYER_CHANGE\n;TYPE:Perimeter\nG1 X1 Yoops E1\n", ":3: Y must be a number, got 'oops'"),
        ("a.gcode", b"G1 X1 Y1\nG1 X1e9 Y2 E1\n", ":2: X must lie within"),
        ("a.gcode", b"G1 X1 Y1\nG1 X1000000 Y2 E1\n", ":2: a place must lie within 100000 mm, got X1e+06 Y2;"),
        ("a.gcode", b"G91\nG1 X90000 Y1\nG1 X90000 Y2 E1\n", ":3: a place must lie within"),
        ("a.gcode", b"G1 X1 Y1\nG1 X2\0 Y2 E1\n", ":2: this is not text"),
        ("a.gcode", b"G1 X1 Y1\nG92 X0\n", ":2: G92 moves the frame, which is not built yet"),
        ("a.gcode", b"G1 X1 Y1\nG2 X2 Y2 R5 E1\n", ":2: an arc without I and J"),
        ("a.gcode", b"G1 X1 Y1\nM82\n", "no bead was found"),
        ("a.gcode", b"G1 Z1\nG1 X1 Y1 E1\nG1 X2 Z2 E2\n;LAYER_CHANGE\n", "no bead was found"),
        ("a.gcode", b";LAYER_CHANGE\n;TYPE:Perimeter\nG1 Z1\nG1 X1 E1\nG1 X2 Z2 E2\n", ":5: z changes from 1 to 2 mm"),
        ("a.svg", b"<svg><g slic3r:z='1'", ":1: not sound XML"),
        ("a.svg", b"<!DOCTYPE a [<!ENTITY b 'c'>]><svg>&b;</svg>", ":1: the document declares entities"),
        ("a.svg", b"<svg xmlns:slic3r='x'><g slic3r:z='nan'/></svg>", "slic3r:z must lie within"),
        ("a.svg", b"<svg>\n<g slic3r:z='1'>\n<polygon points='1,2 3'/></g></svg>", ":3: 3 numbers make no points"),
        ("a.svg", b"<svg>\n<g slic3r:z='1'>\n<path d='M0 0 C 1 1 2 2 3 3'/></g></svg>", ":3: path command 'C'"),
        ("a.svg", b"<svg>\n<g transform='skewX(9)'/></svg>", ":2: transform skewX(9) is not built yet"),
        ("a.svg", b"<svg/>", "no group has a slic3r:z"),
        ("a.svg", b"<svg xmlns:slic3r='x'>\n<g id='layer0' slic3r:z='1'/>\n<g id='layer1'/></svg>",
         ":3: the layer layer1 says"),
        ("a.cli", b"$$HEADERSTART\n$$ASCII\n", ":3: the header does not end"),
        ("a.cli", b"$$HEADERSTART\n$$HEADEREND\n\n$$LAYER/1\n$$POLYLINE/1,1,9,0,0\n", ":5: $$POLYLINE promises"),
        ("a.cli", b"$$HEADERSTART\n$$UNITS/0\n$$HEADEREND\n", ":2: $$UNITS must be > 0"),
        ("a.cli", b"$$HEADERSTART\n$$HEADEREND\n$$GEOMETRYSTART\n$$LAYER/x\n", ":4: $$LAYER must be a number"),
        ("a.cli", b"$$HEADERSTART\n$$HEADEREND\n$$LAYER/1\n$$SPIRAL/1\n", ":4: unknown command $$SPIRAL"),
        ("a.cli", b"$$HEADERSTART\n$$BINARY\n$$HEADEREND" + struct.pack("<Hf", 127, 1.0)
         + struct.pack("<Hiii", 130, 1, 1, 2**30), "bytes are promised and 0 are left"),
        ("a.cli", b"$$HEADERSTART\n$$BINARY\n$$HEADEREND" + struct.pack("<Hf", 127, math.nan), "a coordinate must lie"),
        ("a.csv", b"0,0,1\n1,0,1\n1,1,2\n", ":3: z changes from 1 to 2 mm within a polyline"),
        ("a.csv", b"0,0,1\n1,0\n", ":2: a row must hold x, y and z"),
        ("a.csv", b"0,0,1\n1,inf,1\n", ":2: y must lie within"),
        ("a.cli", b"$$HEADERSTART\n$$HEADEREND\n$$LAYER/1\n$$POLYLINE/1,1,3,3_1.25,0,1,0,1,1\n",
         ":4: $$POLYLINE: a value must be a number, got '3_1.25'"),
        ("a.cli", b"$$HEADERSTART\n$$HEADEREND\n$$LAYER/1\n$$POLYLINE/1e999,1,3,0,0,1,0,1,1\n",
         ":4: $$POLYLINE: a value must be finite"),
        ("a.cli", b"$$HEADERSTART\n$$HEADEREND\n$$LAYER/1\n$$POLYLINE/1,1,3,inf,0,1,0,1,1\n",
         ":4: $$POLYLINE: a value"),
        ("a.svg", b"<svg>\n<g slic3r:z='1'>\n<polygon points='7_0.17,2 3,4 5,5'/></g></svg>", ":3: a coordinate must"),
        ("a.svg", "<svg>\n<g slic3r:z='1'>\n<polygon points='\u0663,2 3,4 5,5'/></g></svg>".encode(),
         ":3: a coordinate"),
        ("a.svg", b"<svg>\n<g slic3r:z='1'>\n<path d='M7_0.17 2 L3,4 5,5Z'/></g></svg>", ":3: a coordinate must"),
        ("a.svg", "<svg>\n<g slic3r:z='1'>\n<path d='M\u0663 1 2 L3,4 5,5Z'/></g></svg>".encode(), ":3: a coordinate"),
        ("a.svg", "<svg>\n<g slic3r:z='\u0663'/></svg>".encode(), ":2: slic3r:z must be a number"),
        ("a.csv", "0,0,1\n\u0661,0,1\n".encode(), ":2: x must be a number"),
        ("a.bin", b"\x00\x01\x02\xff" * 20, "no format that is known"),
        ("a.svg", b"", "the file is empty"),
    ],
)  # fmt: skip
def test_damage_is_one_line(name, data, said, tmp_path):
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(ModelError) as caught:
        read(path)
    text = str(caught.value)
    assert said in text and str(path) in text and "\n" not in text


def test_a_bomb_of_a_picture_is_refused_before_it_is_decoded(tmp_path):
    head = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4s2I5B", 13, b"IHDR", 100_000, 100_000, 8, 0, 0, 0, 0) + b"\0" * 16
    (tmp_path / "layer_0.png").write_bytes(head)
    with pytest.raises(ModelError, match="at most"):
        read(tmp_path)


def test_nothing_there(tmp_path):
    with pytest.raises(ModelError, match="cannot be read"):
        read(tmp_path / "none.gcode")
    with pytest.raises(ModelError, match="holds neither SVG nor PNG"):
        read(tmp_path)


@pytest.mark.parametrize("name", ["logo", "thumbnail400x400", "part_front", "copy_0001"])
def test_a_picture_of_another_name_is_left_out(name, slices, tmp_path):
    alone = read(plants.png_stack(slices, tmp_path / "a", T))
    folder = plants.png_stack(slices, tmp_path / "b", T)
    first = min(folder.glob("*.png"))
    (folder / f"{name}.png").write_bytes(first.read_bytes())
    found = read(folder)
    assert [k.z for k in found.layers] == [k.z for k in alone.layers]
    assert any(note.startswith("left out") and note.endswith(f": {name}.png") for note in found.notes)
    assert len(found.notes) == len(alone.notes) + 1


def test_cut_pictures_say_so(slices, tmp_path, capfd):
    path = plants.tiff_stack(slices, tmp_path / "a.tif", T)
    data = path.read_bytes()
    folder = plants.png_stack(slices, tmp_path / "b", T)
    picture = max(folder.glob("*.png"))
    for cut in (40, 100, 200):
        picture.write_bytes(picture.read_bytes()[:-cut])
        with pytest.raises(ModelError, match=r"layer_\d+.png: a damaged picture: the file ends before its last chunk"):
            read(folder)
    tag = data.index(struct.pack("<HH", 270, 2))  # its text now lies where the file ended
    path.write_bytes(data[: tag + 8] + struct.pack("<I", len(data) - 10) + data[tag + 12 :])
    with pytest.raises(ModelError, match=r"a.tif: picture 0: the file ends before byte"):
        read(path)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(("x", "said"), [("90000", r"a.csv:\d+: a layer spans"), ("", r"a.svg holds no contour")])
def test_errors_of_whole_files_name_them(x, said, slices, tmp_path):
    mesh = models.write_stl(tmp_path / "m.stl", models.box((0, 0, 0), (20, 14, 2)).triangles())
    params = models.write_params(tmp_path, mesh, scaffolding=0, thickness=T)
    path = tmp_path / ("a.csv" if x else "a.svg")
    path.write_text(f"0,0,.2\n20,0,.2\n{x},14,.2\n" if x else "<svg xmlns:slic3r='x'><g slic3r:z='1'/></svg>")
    with pytest.raises(ModelError, match=said):
        check(params, path)
