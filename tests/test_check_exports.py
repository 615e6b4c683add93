"""check: DXF, NPZ, TIFF and Fab@Home in their other legal forms; damage by design; manifests and tables of no end."""

import json
import struct
import zipfile
import zlib

import models
import numpy as np
import plants
import pytest
import tifffile

from rasterslice import folder
from rasterslice.check import tiff_pages
from rasterslice.check.form import FILL, OUTER, SUPPORT, WALL
from rasterslice.check.readers import read
from rasterslice.check.run import check
from rasterslice.cli import main
from rasterslice.errors import ModelError, RasterSliceError

T = 0.4
SQUARE = np.array([(0.0, 0), (4, 0), (4, 2), (0, 2)])


def groups(*pairs):
    return "".join(f"{code}\n{value}\n" for code, value in pairs)


END = groups((0, "ENDSEC"), (0, "EOF"))


def dxf(tmp_path, entities, header="", end=END):
    path = tmp_path / "a.dxf"
    head = groups((0, "SECTION"), (2, "HEADER")) + header + groups((0, "ENDSEC"))
    path.write_text(head + groups((0, "SECTION"), (2, "ENTITIES")) + entities + end)
    return path


def lwpolyline(points, flags=1, name="0", z=0.2, more=""):
    rest = groups(*(pair for x, y in points for pair in ((10, x), (20, y))))
    return groups((0, "LWPOLYLINE"), (8, name), (90, len(points)), (70, flags), (38, z)) + more + rest


def line(a, b, name="0", z=0.2):
    ends = ((10, a[0]), (20, a[1]), (30, z), (11, b[0]), (21, b[1]), (31, z))
    return groups((0, "LINE"), (8, name), *ends)


def box_of(layer):
    points = np.concatenate(layer.loops)
    return [*points.min(axis=0).tolist(), *points.max(axis=0).tolist()]


@pytest.mark.parametrize(("code", "unit"), [(0, 1), (1, 25.4), (4, 1), (5, 10), (6, 1000)])
def test_units_of_dxf(code, unit, tmp_path):
    header = groups((9, "$ACADVER"), (1, "AC1015"), (9, "$INSUNITS"), (70, code))
    layer = read(dxf(tmp_path, lwpolyline(SQUARE), header)).layers[0]
    assert box_of(layer) == pytest.approx([0, 0, 4 * unit, 2 * unit]) and layer.z == pytest.approx(0.2 * unit)


OPEN = {
    "closed": lwpolyline(SQUARE), "repeats its first point": lwpolyline([*SQUARE, SQUARE[0]], 0),
    "lacks its last edge": lwpolyline(SQUARE, 0),
    "in two halves": lwpolyline(SQUARE[:3], 0) + lwpolyline(SQUARE[[0, 3, 2]], 0),
    "lines, some backwards": line(SQUARE[0], SQUARE[1]) + line(SQUARE[2], SQUARE[1]) + line(SQUARE[2], SQUARE[3])
    + line(SQUARE[0], SQUARE[3]),
}  # fmt: skip


@pytest.mark.parametrize("way", OPEN)
def test_contours_of_dxf(way, tmp_path):
    other = lwpolyline(SQUARE[::-1] * 0.25 + 1, z=0.2)  # within it, and wound the wrong way for an island
    found = read(dxf(tmp_path, OPEN[way] + other + groups((0, "TEXT"), (1, "note"))))
    outer, inner = sorted(found.layers[0].loops, key=np.ptp)[::-1]
    assert plants.shapely.Polygon(outer).equals(plants.shapely.box(0, 0, 4, 2))
    assert plants.shapely.LinearRing(outer).is_ccw and not plants.shapely.LinearRing(inner).is_ccw
    assert any("1 of TEXT" in note for note in found.notes)
    assert any("straight line" in note for note in found.notes) == (way == "lacks its last edge")


def test_layers_of_dxf(tmp_path):
    shifted = [(name, SQUARE + (10 * i, 0)) for i, name in enumerate(["outline", "SUPPORT_1", "scaffold", "infill"])]
    upper = lwpolyline(SQUARE, z=0.6)  # comes first: order means nothing
    found = read(dxf(tmp_path, upper + "".join(lwpolyline(p, name=name) for name, p in shifted)))
    assert [k.z for k in found.layers] == [0.2, 0.6] and found.scaffold and found.z_is is None
    layer = found.layers[0]
    assert [len(k) for k in (layer.loops, layer.supports, layer.scaffold)] == [1, 1, 1]
    assert layer.supports[0].min() == 0 and layer.supports[0][:, 0].min() == 10


POLYLINE = groups((0, "POLYLINE"), (8, "0"), (66, 1))
VERTEX = groups((0, "VERTEX"), (10, 1), (20, 1), (30, 1))


@pytest.mark.parametrize(
    ("entities", "said"),
    [
        (groups((0, "SPLINE")), "entity SPLINE is not built yet"),
        (groups((0, "INSERT"), (2, "block")), "entity INSERT is not built yet"),
        (lwpolyline(SQUARE, more=groups((42, 0.5))), "an arc (bulge) is not built yet"),
        (lwpolyline(SQUARE, more=groups((230, -1))), "that does not lie flat is not built yet"),
        (POLYLINE + groups((70, 64)), "a curve or a mesh is not built yet"),
        (POLYLINE + VERTEX + groups((70, 16)), "a curve fitted to a polyline is not built yet"),
        (POLYLINE + groups((70, 8)) + VERTEX + VERTEX.replace("30\n1", "30\n2") + groups((0, "SEQEND")), "z changes"),
        (POLYLINE + VERTEX, "and not with SEQEND"),
        (groups((0, "LINE"), (10, 1), (20, 1)), "a line needs 2 points, got 1"),
        (groups((0, "LINE"), (10, 1), (10, 1)), "x of a point comes where it is not due"),
        (lwpolyline([("1e9", 0), (1, 0), (1, 1)]), "a coordinate must lie within"),
        (lwpolyline([("nan", 0), (1, 0), (1, 1)]), "a coordinate must lie within"),
        ("oops\n1\n", "must be a whole number, got 'oops'"),
        ("", "no polyline was found"),
        ("8\n" + "a" * 5000 + "\n", "a line of more than 4000 characters"),
    ],
)
def test_what_dxf_is_refused(entities, said, tmp_path):
    path = dxf(tmp_path, entities)
    with pytest.raises(ModelError) as caught:
        read(path)
    assert said in str(caught.value) and str(path) in str(caught.value) and "\n" not in str(caught.value)


def vertices(points, more="", z=0.2):
    return "".join(groups((0, "VERTEX"), (8, "0"), (10, x), (20, y), (30, z)) + more for x, y in points)


@pytest.mark.parametrize("breaks", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("more", ["", groups((70, 32)), groups((40, 0.0)), groups((70, 16)), "  70\n     0\n"])
def test_plain_vertices_are_read_together_as_one_by_one(more, breaks, tmp_path):
    """Whether vertices come in the plainest form or not: the same places, and the same errors in the same lines."""
    end = groups((0, "SEQEND"))
    head = groups((0, "POLYLINE"), (8, "0"), (66, 1), (70, 1))
    high = groups((0, "POLYLINE"), (8, "0"), (66, 1), (30, 0.6), (70, 1))
    path = dxf(tmp_path, head + vertices(SQUARE, more) + end + high + vertices(SQUARE + 7, more, z=0) + end)
    text = path.read_bytes().replace(b"\n", breaks.encode())
    path.write_bytes(text)
    if "16" in more:
        with pytest.raises(ModelError, match=r"a.dxf:30: a curve fitted to a polyline"):
            read(path)
        return
    layers = read(path).layers
    assert [k.z for k in layers] == [0.2, 0.6]
    assert layers[0].loops[0].tolist() == SQUARE.tolist() and layers[1].loops[0].tolist() == (SQUARE + 7).tolist()
    for old, new, said in (
        (b"4.0", b"1e99", "a coordinate must lie within"), (b"4.0", b"900000", "a coordinate must lie within"),
        (b"4.0", b"4.0.0", "must be a number"),
    ):  # fmt: skip
        path.write_bytes(text.replace(old, new, 1))
        lines = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
        with pytest.raises(ModelError) as caught:
            read(path)
        assert f"a.dxf:{lines.index(b'4.0') + 1}: " in str(caught.value) and said in str(caught.value)


def test_vertices_where_none_are_due(tmp_path):
    comment = "999\n" + vertices(SQUARE)  # the 0 is what the comment says, and VERTEX is no code
    path = dxf(tmp_path, POLYLINE + comment + groups((0, "SEQEND")))
    with pytest.raises(ModelError, match=r"a.dxf:19: the code of a group must be a whole number, got 'VERTEX'"):
        read(path)
    path = dxf(tmp_path, POLYLINE + vertices(SQUARE) + groups((0, "SEQEND")) + vertices(SQUARE))
    with pytest.raises(ModelError, match="a polyline ends with ENDSEC and not with SEQEND"):
        read(path)


def test_dxf_of_other_kinds(tmp_path):
    path = dxf(tmp_path, lwpolyline(SQUARE), end="")
    with pytest.raises(ModelError, match="the file ends before its EOF"):
        read(path)
    with pytest.raises(ModelError, match=r"\$INSUNITS 3 is not built yet"):
        read(dxf(tmp_path, "", groups((9, "$INSUNITS"), (70, 3))))
    path.write_bytes(b"AutoCAD Binary DXF\r\n\x1a\0" + b"\0" * 50)
    with pytest.raises(ModelError, match="binary form is not built yet"):
        read(path)


def test_ezdxf_writes_what_is_read(tmp_path):
    ezdxf = pytest.importorskip("ezdxf")
    for version in ("R12", "R2000", "R2018"):
        document = ezdxf.new(version)
        document.units = ezdxf.units.MM
        for k in range(3):
            z = T * (k + 0.5)
            if version == "R12":
                document.modelspace().add_polyline2d(SQUARE.tolist(), close=True, dxfattribs={"elevation": (0, 0, z)})
            else:
                document.modelspace().add_lwpolyline(SQUARE.tolist(), close=True, dxfattribs={"elevation": z})
        document.saveas(tmp_path / "a.dxf")
        found = read(tmp_path / "a.dxf")
        assert [k.z for k in found.layers] == pytest.approx([0.2, 0.6, 1.0]), version
        assert all(box_of(k) == [0, 0, 4, 2] for k in found.layers)


# ---- NPZ


def arrays(**changes):
    points = np.concatenate([SQUARE, SQUARE])
    whole = {
        "index": np.arange(2, dtype="<u4"), "z": np.array([0.2, 0.6]), "part_points": points,
        "part_offsets": np.array([0, 4, 8], "<u8"), "part_layers": np.array([0, 1, 2], "<u8"),
    }  # fmt: skip
    return {k: v for k, v in (whole | changes).items() if v is not None}


def test_npz_of_beads(tmp_path):
    names = ("part_boundary", "part_fill", "scaffold_boundary", "scaffold_fill")
    sets = {f"{name}_{what}": arrays()[f"part_{what}"] for name in names for what in ("points", "offsets", "layers")}
    np.savez(tmp_path / "a.npz", **arrays(part_points=None, part_offsets=None, part_layers=None), **sets)
    for layer in read(tmp_path / "a.npz").layers:
        assert layer.beads.role.tolist() == [OUTER, FILL, SUPPORT, SUPPORT]
        assert np.diff(layer.beads.offsets).tolist() == [5, 4, 5, 4]


def test_paths_of_npz_that_enclose_nothing(tmp_path):
    """Our regions may hold a loop of two points; beads may not."""
    np.savez(tmp_path / "a.npz", **arrays(part_offsets=np.array([0, 6, 8], "<u8")))
    assert [len(k.loops) for k in read(tmp_path / "a.npz").layers] == [1, 0]
    beads = {k.replace("part_", "part_boundary_"): v for k, v in arrays(part_offsets=np.array([0, 6, 8])).items()}
    np.savez(tmp_path / "b.npz", **beads)
    with pytest.raises(ModelError, match=r"part_boundary_offsets.npy: holds a path of fewer than 3 points"):
        read(tmp_path / "b.npz")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"z": None}, "without z.npy"),
        ({"z": np.array([0.2, np.nan])}, "z.npy: holds a number that is not within"),
        ({"z": np.array([])}, "z.npy: holds 0 layers"),
        ({"z": np.array([0.2, 0.4, 0.6])}, "part_layers.npy: tells of 2 layers, z of 3"),
        ({"z": np.array([[0.2, 0.6]])}, "z.npy: is no array of 1 column of plain numbers"),
        ({"z": np.array(["a", "b"])}, "z.npy: is no array of 1 column of plain numbers"),
        ({"z": np.array([{}, {}], object)}, "z.npy: is no array of 1 column of plain numbers"),
        ({"part_points": np.full((8, 2), 1e9)}, "part_points.npy: holds a number that is not within"),
        ({"part_points": np.zeros((8, 3))}, "part_points.npy: is no array of 2 columns"),
        ({"part_points": None}, ""),
        ({"part_offsets": None}, "part_offsets.npy: is not in the archive"),
        ({"part_offsets": np.array([0, 4, 9], "<u8")}, "part_offsets.npy: does not divide 8"),
        ({"part_offsets": np.array([0, 2**64 - 1, 8], "<u8")}, "part_offsets.npy: does not divide 8"),
        ({"part_offsets": np.array([0, 5, 4, 8], "<i8")}, "part_offsets.npy: does not divide 8"),
        ({"part_layers": np.array([0, 2, 1, 2], "<u8")}, "part_layers.npy: does not divide 2"),
    ],
)
def test_what_npz_is_refused(changes, said, tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, **arrays(**changes))
    with pytest.raises(ModelError) as caught:
        read(path)
    assert said in str(caught.value) and str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_bombs_of_npz(tmp_path):
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("z.npy", npy("<f8", "(12500000,)", bytes(100_000_000)))
    with pytest.raises(ModelError, match="at most 100 times as many are read"):
        read(path)
    with zipfile.ZipFile(path, "w") as archive:  # the head of the array promises more than the archive holds
        archive.writestr("z.npy", npy("<f8", "(999999999999,)", b"\0" * 16))
    with pytest.raises(ModelError, match=r"z.npy: promises 8000000000120 bytes and the archive holds"):
        read(path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_BZIP2) as archive:
        archive.writestr("z.npy", npy("<f8", "(2,)", b"\0" * 16))
    with pytest.raises(ModelError, match="packed in another way than by deflate"):
        read(path)
    with zipfile.ZipFile(path, "w") as archive:
        for i in range(300):
            archive.writestr(f"{i}.npy", b"")
    with pytest.raises(ModelError, match="its directory holds 300 entries"):
        read(path)
    path.write_bytes(b"PK\3\4" + b"\0" * 60)
    with pytest.raises(ModelError, match="no end of a zip archive was found"):
        read(path)


def npy(dtype, shape, data):
    head = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(head)) + head.encode() + data


# ---- TIFF


def stack(dtype=np.uint8, full=255):
    """Return pictures of a rectangle of 0.8 x 0.4 pixels times 10, the upper row first."""
    pictures = np.zeros((3, 24, 40), dtype)
    pictures[:, 8:16, 10:26] = full
    return pictures


SIZES = {"resolution": (50, 50), "resolutionunit": "CENTIMETER"}  # 0.2 mm
FORMS = {
    "8 bits": (stack(), {}), "packed": (stack(), {"compression": "zlib"}),
    "16 bits": (stack(np.uint16, 65535), {"byteorder": ">"}), "0 and 1": (stack(full=1), {}),
    "float": (stack(np.float32, 1.0), {"rowsperstrip": 5}), "bits": (stack(bool, 1), {}),
    "distances": (1 - 2 * stack(np.float32, 1.0), {}), "distances, 16 bits": (128 - stack(np.int16, 256), {}),
    "tiles": (stack(), {"tile": (16, 16), "compression": "zlib"}), "64-bit places": (stack(), {"bigtiff": True}),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_forms_of_tiff(form, tmp_path):
    pictures, how = FORMS[form]
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, pictures, photometric="minisblack", **SIZES, **how)
    found = read(path)
    assert [k.z for k in found.layers] == [0, 1, 2] and found.z_is == "number" and found.format == "TIFF stack"
    for k in found.layers:
        assert box_of(k) == pytest.approx(np.multiply([9.5, 7.5, 25.5, 15.5], 0.2).tolist(), abs=1e-6)


@pytest.mark.parametrize("order", ["XYCZT", "XYZCT"])
def test_channels_of_ome(order, tmp_path):
    two = np.stack([stack(), np.roll(stack(), 8, axis=2)], axis=1)  # layers, channels
    about = {"axes": "ZCYX", "Channel": {"Name": ["part", "scaffold"]}, "PhysicalSizeX": 200, "PhysicalSizeY": 200,
             "PhysicalSizeZ": 0.04, "PhysicalSizeZUnit": "cm"}  # fmt: skip
    if order == "XYZCT":
        two, about["axes"] = two.swapaxes(0, 1), "CZYX"
    tifffile.imwrite(tmp_path / "a.ome.tif", two, photometric="minisblack", metadata=about)
    with tifffile.TiffFile(tmp_path / "a.ome.tif") as file:
        assert order in file.ome_metadata
    found = read(tmp_path / "a.ome.tif")
    assert [k.z for k in found.layers] == pytest.approx([0.2, 0.6, 1.0]) and found.scaffold
    for k in found.layers:
        assert box_of(k)[0] == pytest.approx(1.9) and k.scaffold[0][:, 0].min() == pytest.approx(3.5)


def test_sizes_of_imagej(tmp_path):
    about = {"spacing": 400.0, "unit": "um", "axes": "ZYX"}
    tifffile.imwrite(tmp_path / "a.tif", stack(), imagej=True, resolution=(1 / 200, 1 / 200), metadata=about)
    found = read(tmp_path / "a.tif")
    assert [k.z for k in found.layers] == pytest.approx([0.2, 0.6, 1.0]) and found.z_is == "middle"
    assert box_of(found.layers[0])[2] == pytest.approx(5.1)


def test_a_tiff_without_sizes_is_scaled(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", stack(), photometric="minisblack", metadata=None)
    assert "how large a pixel" in read(tmp_path / "a.tif").notes[0]


@pytest.mark.parametrize(
    ("pictures", "how", "said"),
    [
        (np.zeros((4, 5, 3), np.uint8), {"photometric": "rgb"}, "colours, or white that is 0"),
        (stack(), {"photometric": "miniswhite"}, "colours, or white that is 0"),
        (stack(np.float32, 37.0), {}, "neither shares of 1 nor distances"),
        (stack(np.float32, np.nan), {}, "a sample is no finite number"),
        (stack(np.complex64, 1), {}, "samples of 64 bits of kind"),
        (stack(), {"compression": "zlib", "predictor": 2}, "or its predictor is not built yet"),
        (stack(), {"resolution": (50, 25), "resolutionunit": "CENTIMETER"}, "pixels of 0.2 x 0.4 mm"),
        (np.stack([stack()] * 3, axis=1), {"metadata": {"axes": "ZCYX"}, "ome": True}, "3 channels"),
        (np.stack([stack()] * 3, axis=1), {"metadata": {"axes": "TZYX"}, "ome": True}, "channels at 3 times"),
    ],
)
def test_what_tiff_is_refused(pictures, how, said, tmp_path):
    path = tmp_path / "a.tif"
    try:
        tifffile.imwrite(path, pictures, **{"photometric": "minisblack", **how})
    except ValueError as error:  # packing that needs imagecodecs
        pytest.skip(str(error))
    with pytest.raises(ModelError) as caught:
        read(path)
    assert said in str(caught.value) and str(path) in str(caught.value) and "\n" not in str(caught.value)


def patched(path, tag, value, page=0):
    """Change one tag of a TIFF in its place."""
    with tifffile.TiffFile(path, mode="r+b") as file:
        file.pages[page].tags[tag].overwrite(value)


@pytest.mark.parametrize(
    ("tag", "value", "said"),
    [
        ("ImageWidth", 4_000_000, "at most 67108864 pixels are read"),
        ("ImageWidth", 60_000, "strip 0"), ("ImageLength", 0, "40 x 0 px"), ("Compression", 5, "packing 5"),
        ("StripByteCounts", 2**31, "samples lie beyond the end of the file"),
        ("StripOffsets", 2**31, "samples lie beyond the end of the file"),
        ("RowsPerStrip", 1, "1 strips or tiles of 24"), ("BitsPerSample", 64, "samples of 64 bits"),
    ],
)  # fmt: skip
def test_tags_that_lie(tag, value, said, tmp_path):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, stack()[0], photometric="minisblack", compression="zlib", rowsperstrip=24, metadata=None)
    patched(path, tag, value)
    with pytest.raises(ModelError, match=said):
        read(path)


def test_bombs_of_tiff(tmp_path):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, stack()[0], photometric="minisblack", compression="zlib", rowsperstrip=24, metadata=None)
    data = path.read_bytes()
    bomb = zlib.compress(bytes(50_000_000))  # unpacked as far as the picture is large
    path.write_bytes(data + bomb)
    patched(path, "StripOffsets", len(data))
    patched(path, "StripByteCounts", len(bomb))
    assert read(path).layers[0].loops == []
    tifffile.imwrite(path, stack(), photometric="minisblack", metadata=None)
    data, order = bytearray(path.read_bytes()), "<"
    with tifffile.TiffFile(path) as file:
        first, last = file.pages[0].offset, file.pages[2].offset
    end = last + 2 + 12 * struct.unpack_from(order + "H", data, last)[0]
    data[end : end + 4] = struct.pack("<I", first)  # the last picture is followed by the first
    path.write_bytes(data)
    with pytest.raises(ModelError, match="the chain of pictures does not end"):
        read(path)


def test_pictures_that_share_samples(tmp_path, monkeypatch):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, stack()[:2], photometric="minisblack", metadata=None)
    size = path.stat().st_size
    patched(path, "StripByteCounts", size - 8, 0)
    patched(path, "StripByteCounts", size - 8, 1)
    patched(path, "StripOffsets", 8, 0)
    patched(path, "StripOffsets", 8, 1)
    with pytest.raises(ModelError, match="pictures share their samples"):
        read(path)
    monkeypatch.setattr(tiff_pages, "MOST_PAGES", 1)
    with pytest.raises(ModelError, match=r"does not end|share"):
        read(path)


def test_a_tiff_that_promises_more(tmp_path):
    path = tmp_path / "a.ome.tif"
    tifffile.imwrite(path, stack(), photometric="minisblack", metadata={"axes": "ZYX"})
    path.write_bytes(path.read_bytes().replace(b'SizeZ="3"', b'SizeZ="9"'))
    with pytest.raises(ModelError, match="promises 9 pictures and holds 3"):
        read(path)


# ---- Fab@Home


CALIBRATION = "<materialCalibration><name>water</name><pathWidth>0.8</pathWidth></materialCalibration>"
FAB = "<fabAtHomePrinter>" + CALIBRATION + "{}</fabAtHomePrinter>"
PATH = "<path><materialCalibrationName>{}</materialCalibrationName>{}</path>"


def fab_path(points, name="water", z=0.4):
    return PATH.format(name, "".join(f"<point><x>{x}</x><y>{y}</y><z>{z}</z></point>" for x, y in points))


def test_paths_of_fab(tmp_path):
    path = tmp_path / "a.fab"
    walls, fill = fab_path([*SQUARE, SQUARE[0]]), fab_path(SQUARE[:2])
    path.write_text(FAB.format(walls + fill + fab_path(SQUARE[:2], "Support silicone") + fab_path(SQUARE, z=0.8)))
    found = read(path)
    assert [k.z for k in found.layers] == [0.4, 0.8] and found.z_is == "top"
    assert found.layers[0].beads.role.tolist() == [WALL, FILL, SUPPORT]
    assert found.layers[0].beads.width[:2].tolist() == [0.8, 0.8] and np.isnan(found.layers[0].beads.width[2])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (FAB.format(""), "no path was found"),
        (FAB.format(fab_path(SQUARE[:1])), ":1: a path of 1 points lays nothing"),
        (FAB.format(fab_path(SQUARE, z="oops")), ":1: z must be a number, got 'oops'"),
        (FAB.format(fab_path(SQUARE, z="1e9")), ":1: z must lie within"),
        (FAB.format(PATH.format("water", "<point><x>1</x><y>1</y></point>")), ":1: a point must hold x, y and z"),
        (FAB.format(PATH.format("a", "<point><x>1</x><y>1</y><z>1</z></point><point><x>1</x><y>2</y><z>2</z></point>")),
         ":1: z changes from 1 to 2 mm within a path"),
        (FAB.format("<a>" * 20), "elements are nested deeper than 16"),
        (FAB.format("<path><point><x>" + "1" * 300 + "</x></point></path>"), "more than 200 characters of text"),
        ("<!DOCTYPE a [<!ENTITY b 'c'>]>" + FAB.format("&b;"), "declares entities"),
        ("<?xml version='1.0' encoding='utf-99'?>" + FAB.format(""), ":1: unknown encoding"),
        (FAB.format("<path>"), ":1: not sound XML"),
    ],
)  # fmt: skip
def test_what_fab_is_refused(text, said, tmp_path):
    path = tmp_path / "a.fab"
    path.write_text(text)
    with pytest.raises(ModelError) as caught:
        read(path)
    assert said in str(caught.value) and str(path) in str(caught.value) and "\n" not in str(caught.value)


# ---- our own exports of slices cut at another height, in one ice layer or three


ICE = [{"part_layers_per_slice": 3}, {"part_layers_per_slice": 1, "slice_position": 0.3}]


@pytest.mark.parametrize("settings", ICE)
def test_ice_layers_of_our_exports(settings, tmp_path):
    mesh = models.write_stl(tmp_path / "m.stl", models.cone(6, 12, 64).triangles())
    exports = "npz,dxf,fab,gcode"
    params = models.write_params(tmp_path, mesh, scaffolding=1, thickness=T, pitch=0.2, export=exports, **settings)
    assert main([str(params), "--quiet"]) == 0
    for name in exports.split(","):
        found = read(tmp_path / "params.slices" / f"params.{name}")
        assert found.z_is == "middle"
        z = settings.get("slice_position", 0.5) * T + T * np.arange(len(found.layers))
        assert [k.z for k in found.layers] == pytest.approx(z.tolist(), abs=1e-6)
        r = check(params, tmp_path / "params.slices" / f"params.{name}")
        assert not r["failed"] and not r["faults"] and r["verdict"] == "pass", (name, r["worst"][:2])


# ---- tables and manifests of no end


@pytest.mark.parametrize("head", ["", "layer,ice,z,material,kind,path,x,y\n"])
def test_a_line_of_no_end(head, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(head + "0," * 500_000 + "0\n")
    with pytest.raises(ModelError, match=rf"a.csv:{1 + bool(head)}: a line of more than 1000 characters"):
        read(path)
    path.write_text(head + "0,0,0\r\n" * 3 + "1" * 2000)
    with pytest.raises(ModelError, match=r"a.csv:\d: "):
        read(path)


def test_lines_end_as_on_any_system(tmp_path):
    rows = ["x,y,z", *(f"{x},{y},1" for x, y in SQUARE), "NaN NaN NaN"]
    for end in ("\n", "\r\n", "\r"):
        (tmp_path / "a.csv").write_text(end.join(rows), newline="")
        assert box_of(read(tmp_path / "a.csv").layers[0]) == [0, 0, 4, 2]


@pytest.fixture
def run_of_ours(tmp_path):
    mesh = models.write_stl(tmp_path / "m.stl", models.box((0, 0, 0), (4, 4, 2)).triangles())
    params = models.write_params(tmp_path, mesh, scaffolding=0, thickness=T, pitch=0.2)
    assert main([str(params), "--quiet"]) == 0
    return params, tmp_path / "params.slices" / folder.MANIFEST


@pytest.mark.parametrize("text", ["[" * 200_000, '{"program":' * 50_000])
def test_a_manifest_nested_without_end(text, run_of_ours, capsys):
    params, manifest = run_of_ours
    manifest.write_text(text)
    assert main(["check", str(params), "--against", str(manifest.parent)]) == 2
    assert "nested too deeply for a manifest" in capsys.readouterr().err


def test_a_manifest_of_no_end(run_of_ours, capsys):
    params, manifest = run_of_ours
    with manifest.open("r+b") as file:
        file.truncate(20 << 30)  # holds nothing, and takes no room
    assert main(["check", str(params), "--against", str(manifest.parent)]) == 2
    error = capsys.readouterr().err
    assert "manifest.json: 21475 MB, at most 67 MB are read" in error and error.count("\n") == 1


@pytest.mark.parametrize(
    ("group", "key", "value"),
    [("settings", "part_width", []), ("grid", "pitch", "wide"), ("grid", "pitch", 10**400), ("grid", "pitch", 0),
     ("settings", "thickness", "thick"), ("settings", None, 3), ("grid", None, [])],
)  # fmt: skip
def test_a_manifest_that_says_nonsense(group, key, value, run_of_ours):
    _, manifest = run_of_ours
    said = json.loads(manifest.read_text())
    if key is None:
        said[group] = value
    else:
        said[group][key] = value
    manifest.write_text(json.dumps(said))
    with pytest.raises(RasterSliceError, match=r"params.slices|slice thickness") as caught:
        check(manifest.parent, manifest.parent)
    assert "\n" not in str(caught.value)
