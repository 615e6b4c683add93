"""Readers of check against damaged files: one line with the place, or layers; never anything else."""

import io
import struct
import tracemalloc
import zipfile

import numpy as np
import plants
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from shapely.geometry import MultiPolygon, Point, Polygon, box

from rasterslice.check.form import LIMIT_MM
from rasterslice.check.readers import read
from rasterslice.errors import ModelError

T = 0.4
WRITERS = {**plants.AREA_WRITERS, **plants.BEAD_WRITERS}
TOKENS = [
    b"nan", b"1e999", b"-1", b"99999999999", b"\0", b"\xff\xfe", b"&x;", b"<!ENTITY a 'b'>", b"$$LAYER/",
    b"G2 X1 Y1 I0 J0", b"\n", b",", b"]]>", b"G92 X0", b"M83", b";LAYER_CHANGE\n", b"NaN,NaN,NaN", b"<g>", b"</g>",
    b"", b"0x10", b"1_0", b"--5",
]  # fmt: skip


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    """Give a small whole file of every format; pictures one by one."""
    folder = tmp_path_factory.mktemp("fuzz")
    ring = Polygon(
        Point(0, 0).buffer(4, quad_segs=4).exterior.coords, [Point(0, 0).buffer(2, quad_segs=2).exterior.coords]
    )
    shape = plants.clean(MultiPolygon([ring, box(6, -2, 9, 2)]))
    slices = [plants.Slice(T * (k + 0.5), shape, support=plants.clean(box(12, 0, 14, 2))) for k in range(3)]
    found = {}
    for kind, (suffix, write) in WRITERS.items():
        path = write(slices, folder / f"{kind.replace(' ', '_')}{suffix}", T)
        found[kind] = (path, (next(path.glob("*.png")) if path.is_dir() else path).read_bytes())
    return found


def damage(data, draw):
    """Return bytes with some of them cut, changed, doubled or replaced by words that hurt."""
    for _ in range(draw(st.integers(1, 3))):
        a = draw(st.integers(0, len(data)))
        b = min(len(data), a + draw(st.integers(0, 40)))
        how = draw(st.sampled_from(["cut", "end", "word", "double", "noise"]))
        if how == "cut":
            data = data[:a] + data[b:]
        elif how == "end":
            data = data[:a]
        elif how == "word":
            data = data[:a] + draw(st.sampled_from(TOKENS)) + data[b:]
        elif how == "double":
            data = data[:b] + data[a:b] * draw(st.integers(1, 5)) + data[b:]
        else:
            data = data[:a] + draw(st.binary(max_size=8)) + data[b:]
    return data


@pytest.mark.parametrize("kind", WRITERS)
def test_damage_is_an_error_or_layers(kind, samples, tmp_path_factory):
    path, whole = samples[kind]
    folder = tmp_path_factory.mktemp("damaged")
    target = folder / ("layer_0001.png" if path.is_dir() else path.name)

    @settings(max_examples=40, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
    @given(st.data())
    def one(data):
        target.write_bytes(damage(whole, data.draw))
        try:
            found = read(folder if path.is_dir() else target)
        except ModelError as error:
            text = str(error)
            assert text.startswith(str(folder)) and "\n" not in text
            return
        for layer in found.layers:
            lines = [*layer.loops, *layer.scaffold, *layer.supports]
            lines += [layer.beads.points] if layer.beads is not None else []
            for p in lines:
                assert p.ndim == 2 and p.shape[1] == 2 and np.all(np.abs(p) <= 26 * LIMIT_MM)

    one()


@pytest.mark.parametrize("kind", [k for k in WRITERS if k != "PNG stack"])
def test_a_file_cut_anywhere(kind, samples, tmp_path):
    """Cut at every 37th byte: an error, or fewer layers, or the last one shorter."""
    path, whole = samples[kind]
    target = tmp_path / path.name
    for end in range(1, len(whole), 37):
        target.write_bytes(whole[:end])
        try:
            assert len(read(target).layers) <= 3
        except ModelError as error:
            assert "\n" not in str(error)


def zipped(dtype, count, data):
    """Return an NPZ of heights whose head promises a count."""
    head = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': ({count},), }}".ljust(117) + "\n"
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("z.npy", b"\x93NUMPY\1\0" + struct.pack("<H", len(head)) + head.encode() + data)
    return file.getvalue()


def tiff(tags):
    """Return a TIFF of one picture with tags of one whole number each."""
    rows = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags.items())
    return b"II*\0\x08\0\0\0" + struct.pack("<H", len(tags)) + rows + b"\0\0\0\0"


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.cli", b"$$HEADERSTART\n$$BINARY\n$$UNITS/1\n$$HEADEREND"
         b"\x7f\x00\x00\x00\x80?\x82\x00" + b"\x01\0\0\0" * 2 + b"\xff\xff\xff\x7f"),
        ("a.cli", b"$$HEADERSTART\n$$LAYERS/2000000000\n$$HEADEREND\n"
         b"$$LAYER/1\n$$POLYLINE/1,1,2000000000,0,0\n$$GEOMETRYEND\n"),
        ("a.svg", b"<?xml version='1.0'?><!DOCTYPE l [<!ENTITY a 'aaaaaaaaaa'>" + b"".join(
            b"<!ENTITY %c '%s'>" % (98 + i, b"&%c;" % (97 + i) * 10) for i in range(9)) + b"]><svg>&j;</svg>"),
        ("a.svg", b"<!DOCTYPE svg [<!ENTITY e SYSTEM 'file:///etc/hostname'>]><svg>&e;</svg>"),
        ("a.svg", b"<svg>" + b"<g>" * 200_000),
        ("a.csv", b"0," * 1_000_000),
        ("a.csv", b"layer,ice,z,material,kind,path,x,y\n" + b"0," * 1_000_000),
        ("a.csv", b"0,0,0\n" * 200_000),
        ("a.dxf", b"999\n" + b"9" * 2_000_000),
        ("a.dxf", b"0\nSECTION\n2\nENTITIES\n" + b"0\nTEXT\n" * 100_000),
        ("a.fab", b"<fabAtHomePrinter><path>" + b"1" * 2_000_000),
        ("a.fab", b"<!DOCTYPE a [<!ENTITY a 'aaaaaaaaaa'>]><fabAtHomePrinter>&a;</fabAtHomePrinter>"),
        ("a.npz", zipped("<f8", 125_000_000_000, b"\0" * 64)),
        ("a.npz", zipped("<f8", 12_500_000, bytes(100_000_000))),
        ("a.tif", tiff({256: 60_000, 257: 1, 258: 8, 273: 8, 277: 1, 278: 1, 279: 100_000_000})),
        ("a.tif", tiff({256: 8_000_000_000 % 2**32, 257: 2**31, 258: 8, 273: 8, 279: 8})),
        ("a.tif", tiff({256: 1, 257: 60_000_000, 258: 8, 262: 1, 273: 8, 278: 1, 279: 8})),
        ("a.gcode", b";LAYER_CHANGE\n;TYPE:Perimeter\nG1 Z1\nG1 X1 Y1\nG2 X1 Y1 I90000 J0 E9\n" * 2),
    ],
)  # fmt: skip
def test_nothing_is_allocated_from_a_count(name, data, tmp_path):
    (tmp_path / name).write_bytes(data)
    read_or_error(tmp_path / name)  # imports, and what is kept
    tracemalloc.start()
    try:
        read_or_error(tmp_path / name)
        assert tracemalloc.get_traced_memory()[1] < 20 * len(data) + 4_000_000
    finally:
        tracemalloc.stop()


def read_or_error(path):
    try:
        read(path)
    except ModelError as error:
        assert "\n" not in str(error) and "root:" not in str(error)
