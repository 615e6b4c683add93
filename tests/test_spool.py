"""Layers that come back from the disk are the layers that went there."""

from __future__ import annotations

import errno
import json
import time
from pathlib import Path

import numpy as np
import pytest
from fakes import layer, pack, ring, tree, washer
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import rasterslice
from rasterslice.errors import ModelError, UsageError
from rasterslice.paths import COLUMNS, DEPOSITION, REGIONS, Layer, Paths
from rasterslice.spool import CLOSED, RECORD, SETS, open_spool
from rasterslice.spooling import _RECORD, SpoolWriter


def write(folder: Path, layers: list[Layer], regions: bool = True) -> Path:
    with SpoolWriter(folder, len(layers), regions) as spool:
        for item in reversed(layers):
            spool.append(item)
    assert spool.stats() == [item.stats for item in layers]
    return folder


def same(a: Layer, b: Layer) -> None:
    assert (a.index, a.z, a.stats) == (b.index, b.z, b.stats)
    assert {n: type(v) for n, v in a.stats.items()} == {n: type(v) for n, v in b.stats.items()}
    for name in REGIONS + DEPOSITION:
        p, q = getattr(a, name), getattr(b, name)
        assert (p is None) == (q is None)
        if p is not None:
            assert p.points.tobytes() == q.points.tobytes()
            assert p.offsets.tobytes() == q.offsets.tobytes()
            assert p.closed == q.closed
            assert q.points.dtype == np.float64
            assert q.offsets.dtype == np.uint32


@pytest.mark.parametrize("regions", [True, False])
def test_layers_come_back_in_print_order(tmp_path: Path, regions: bool) -> None:
    layers = [washer(k, 0.4 * k, regions=regions) for k in range(5)]
    spool = open_spool(write(tmp_path / "s", layers, regions))
    assert len(spool) == 5
    assert spool.regions == regions
    for a, b in zip(layers, spool, strict=True):
        same(a, b)
    same(spool[-1], layers[4])
    assert [item.index for item in spool[1:4:2]] == [1, 3]
    assert [item.index for item in reversed(spool)] == [4, 3, 2, 1, 0]
    with pytest.raises(IndexError):
        spool[5]


numbers = st.floats(allow_nan=False, allow_infinity=False)
sets = st.tuples(
    *(
        st.lists(st.integers(0, 5).flatmap(lambda n: arrays(np.float64, (n, 2), elements=numbers)), max_size=3).map(
            lambda loops, closed=closed: pack(loops, closed)
        )
        for closed in CLOSED
    )
)
stats = st.fixed_dictionaries(
    {name: st.none() | st.integers(0, 2**53) | numbers for name in COLUMNS[:-1]}
    | {"flags": st.none() | st.sampled_from(["", "open", "open;mended"])}
)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(sets, stats, numbers), max_size=4))
def test_any_layers_round_trip(tmp_path_factory: pytest.TempPathFactory, content: list) -> None:
    layers = [
        Layer(index=i, z=z, stats=row, **dict(zip(SETS, paths, strict=True)))
        for i, (paths, row, z) in enumerate(content)
    ]
    spool = open_spool(write(tmp_path_factory.mktemp("s") / "layers", layers))
    for a, b in zip(layers, spool, strict=True):
        same(a, b)


def test_empty_layers_and_no_layers(tmp_path: Path) -> None:
    same(layer(0, 0.2), open_spool(write(tmp_path / "one", [layer(0, 0.2)]))[0])
    assert list(open_spool(write(tmp_path / "none", []))) == []


def test_not_a_number_becomes_a_blank(tmp_path: Path) -> None:
    item = layer(0, 0.2)
    item.stats["lost_area"] = float("nan")
    assert open_spool(write(tmp_path / "s", [item]))[0].stats["lost_area"] is None


def test_bytes_depend_on_the_layers_only(tmp_path: Path) -> None:
    layers = [washer(k, 0.4 * k) for k in range(4)]
    assert tree(write(tmp_path / "a", layers)) == tree(write(tmp_path / "b", layers))
    assert sorted(tree(tmp_path / "a")) == ["index.bin", "offsets.u32", "points.f64"]


def test_order_and_kinds_are_checked(tmp_path: Path) -> None:
    spool = SpoolWriter(tmp_path / "s", 3, True)
    with pytest.raises(ValueError, match="layer 1 came where 2 was due"):
        spool.append(washer(1, 0.4))
    with pytest.raises(ValueError, match="part is missing"):
        spool.append(washer(2, 0.4, regions=False))
    with pytest.raises(ValueError, match="damaged paths"):
        spool.append(layer(2, 0.4, part_boundary=Paths.empty(False)))
    with pytest.raises(ValueError, match="3 layers are missing"):
        spool.close()
    with pytest.raises(ModelError, match="damaged layers"):
        open_spool(tmp_path / "s")


@pytest.mark.parametrize("name", ["index.bin", "points.f64", "offsets.u32"])
@pytest.mark.parametrize("harm", ["missing", "shorter", "longer", "empty"])
def test_damaged_files_are_named(tmp_path: Path, name: str, harm: str) -> None:
    path = write(tmp_path / "s", [washer(k, 0.4 * k) for k in range(3)]) / name
    data = path.read_bytes()
    path.write_bytes({"shorter": data[:-5], "longer": data + b"12345678"}.get(harm, b""))
    if harm == "missing":
        path.unlink()
    with pytest.raises(ModelError, match=rf"damaged layers, {name}.*slice again") as error:
        open_spool(tmp_path / "s")
    assert "\n" not in str(error.value)


def test_altered_index_and_offsets_are_found(tmp_path: Path) -> None:
    write(tmp_path / "s", [washer(k, 0.4 * k) for k in range(3)])
    offsets = np.fromfile(tmp_path / "s/offsets.u32", "<u4")
    offsets[1] += 1000
    offsets.tofile(tmp_path / "s/offsets.u32")
    with pytest.raises(ModelError, match="do not fit"):
        list(open_spool(tmp_path / "s"))
    index = bytearray((tmp_path / "s/index.bin").read_bytes())
    index[-7] ^= 1
    (tmp_path / "s/index.bin").write_bytes(index)
    with pytest.raises(ModelError, match="altered"):
        open_spool(tmp_path / "s")


def test_open_checks_whose_folder_it_is(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such folder"):
        rasterslice.open(tmp_path / "nowhere")
    with pytest.raises(UsageError, match=r"no manifest\.json of rasterslice"):
        rasterslice.open(tmp_path)
    (tmp_path / "manifest.json").write_text(json.dumps({"program": "rasterslice"}))
    with pytest.raises(ModelError, match="damaged layers"):
        rasterslice.open(tmp_path)
    write(tmp_path / "layers", [washer(0, 0.2)])
    same(rasterslice.open(str(tmp_path))[0], washer(0, 0.2))


def test_two_million_points_take_no_time(tmp_path: Path) -> None:
    n = 765
    loops, lines = pack([ring(9, 400)] * 2, True), pack([ring(1, 2)] * 130, False)
    layers = [
        layer(k, 0.4 * k, part=loops, scaffold=loops, part_boundary=loops, part_fill=lines, scaffold_fill=lines)
        for k in range(n)
    ]
    best = 9.0
    for i in range(3):
        start = time.perf_counter()
        write(tmp_path / str(i), layers)
        best = min(best, time.perf_counter() - start)
    assert best < 0.5


def test_what_failed_is_not_said_twice(tmp_path: Path) -> None:
    """A file that could not be written fails again as it is closed, which would hide the first reason."""

    class Full:
        def close(self) -> None:
            raise OSError(errno.ENOSPC, "No space left on device")

    writer = SpoolWriter(tmp_path / "layers", 1, False)
    points, writer._points.file = writer._points.file, Full()  # type: ignore[assignment]
    writer.abort()
    assert writer._offsets.file.closed
    points.close()


def test_a_record_is_packed_as_it_is_read() -> None:
    assert _RECORD.size == RECORD.itemsize
