"""Finished layers on disk: three files however many layers there are, appended top-down, read bottom-up.

::

    points.f64    x y of all vertices, float64, mm, in the order in which layers finish
    offsets.u32   the offsets of each path set, uint32, the same order
    index.bin     HEADER, then one RECORD per layer, layer 0 first

All numbers are little endian. Nothing in the files depends on batches, times or the machine.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from .errors import ModelError, UsageError
from .folder import MANIFEST, read_manifest
from .paths import COLUMNS, DEPOSITION, REGIONS, Layer, Paths, Stat

SETS = REGIONS + DEPOSITION
CLOSED = tuple(not name.endswith("fill") for name in SETS)
MAGIC = b"rslspool"
VERSION = 2

#: Kinds of a statistic. Integers and floats share a float64, exact for integers below 2^53.
BLANK, INTEGER, FLOAT, TEXT = range(4)
TEXT_BYTES = 112

HEADER = np.dtype(
    [("magic", "S8"), ("version", "<u4"), ("layers", "<u4"), ("regions", "<u4"), ("crc32", "<u4"),
     ("points", "<u8"), ("offsets", "<u8")]
)  # fmt: skip
RECORD = np.dtype(
    [("index", "<u4"), ("z", "<f8"), ("points", "<u8", len(SETS)), ("offsets", "<u8", len(SETS)),
     ("paths", "<u4", len(SETS)), ("kinds", "u1", len(COLUMNS)), ("values", "<f8", len(COLUMNS)),
     ("text", f"S{TEXT_BYTES}")]
)  # fmt: skip


class Spool(Sequence[Layer]):
    """Layers in print order, read from disk when they are asked for.

    Attributes
    ----------
    regions : bool
        Whether layers hold their regions.
    """

    def __init__(
        self, folder: Path, records: NDArray[np.void], regions: bool, stats: list[dict[str, Stat]] | None
    ) -> None:
        self._folder, self._records, self.regions, self._stats = folder, records, regions, stats
        self._points: NDArray[np.float64] = _map(folder / "points.f64", "<f8").reshape(-1, 2)
        self._offsets: NDArray[np.uint32] = _map(folder / "offsets.u32", "<u4")

    def __len__(self) -> int:
        return len(self._records)

    @overload
    def __getitem__(self, key: int) -> Layer: ...
    @overload
    def __getitem__(self, key: slice) -> list[Layer]: ...
    def __getitem__(self, key: int | slice) -> Layer | list[Layer]:
        if isinstance(key, slice):
            return [self[i] for i in range(len(self))[key]]
        record = self._records[range(len(self))[key]]
        sets: dict[str, Any] = dict.fromkeys(SETS)
        for s, name in enumerate(SETS):
            if self.regions or name not in REGIONS:
                sets[name] = self._paths(record, s)
        index = int(record["index"])
        return Layer(index=index, z=float(record["z"]), stats=_rows(self._records[index : index + 1])[0], **sets)

    def __iter__(self) -> Iterator[Layer]:
        return (self[i] for i in range(len(self)))

    def rows(self) -> list[dict[str, Stat]]:
        """Return the statistics of all layers without reading their paths; they are not to be changed."""
        if self._stats is None:
            self._stats = _rows(self._records)
        return self._stats

    def _paths(self, record: Any, s: int) -> Paths:
        start = int(record["offsets"][s])
        offsets = self._offsets[start : start + int(record["paths"][s]) + 1]
        first = int(record["points"][s])
        points = self._points[first : first + int(offsets[-1] if len(offsets) else 0)]
        sound = len(offsets) == record["paths"][s] + 1 and offsets[0] == 0 and bool(np.all(offsets[1:] >= offsets[:-1]))
        if not sound or len(points) != offsets[-1]:
            raise _damaged(self._folder, f"paths of layer {record['index']} do not fit")
        return Paths(points, offsets, CLOSED[s])


def _rows(records: NDArray[np.void]) -> list[dict[str, Stat]]:
    """Return the statistics of each record."""
    packed = (records[name].tolist() for name in ("kinds", "values", "text"))
    return [
        {
            name: value if kind == FLOAT else int(value) if kind == INTEGER else text.decode("ascii") if kind else None
            for name, kind, value in zip(COLUMNS, kinds, values, strict=True)
        }
        for kinds, values, text in zip(*packed, strict=True)
    ]


def open_spool(folder: Path, stats: list[dict[str, Stat]] | None = None) -> Spool:
    """Return the layers of a spool in print order, memory-mapped.

    Parameters
    ----------
    folder : Path
    stats : list of dict, optional
        Their statistics, which who has just written them knows.

    Raises
    ------
    ModelError
        When a file is missing, truncated or damaged.
    """
    try:
        data = (folder / "index.bin").read_bytes()
        sizes = [(folder / name).stat().st_size for name in ("points.f64", "offsets.u32")]
    except OSError as error:
        raise _damaged(folder, f"{Path(error.filename).name}: {error.strerror}") from error
    header = np.frombuffer(data[: HEADER.itemsize].ljust(HEADER.itemsize, b"\0"), HEADER)[0]
    if header["magic"] != MAGIC:
        raise _damaged(folder, "index.bin is not an index of layers")
    if header["version"] != VERSION:
        raise ModelError(f"{folder}: layers of format {header['version']}, this program reads {VERSION}; slice again")
    body = data[HEADER.itemsize :]
    if len(body) != int(header["layers"]) * RECORD.itemsize or zlib.crc32(body) != header["crc32"]:
        raise _damaged(folder, "index.bin is truncated or altered")
    for name, size, due in zip(
        ("points.f64", "offsets.u32"), sizes, (16 * int(header["points"]), 4 * int(header["offsets"])), strict=True
    ):
        if size != due:
            raise _damaged(folder, f"{name} holds {size} bytes of {due}")
    return Spool(folder, np.frombuffer(body, RECORD), bool(header["regions"]), stats)


def open_result(folder: str | Path) -> Spool:
    """Return the layers of an output folder in print order; public as ``rasterslice.open``.

    Parameters
    ----------
    folder : str or Path
        What ``rasterslice PARAMS.txt`` wrote.

    Raises
    ------
    UsageError
        When there is no such folder or it is not ours.
    ModelError
        When its layers are missing or damaged.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise UsageError(f"{folder}: no such folder; name one that rasterslice wrote")
    if read_manifest(folder) is None:
        raise UsageError(f"{folder}: has no {MANIFEST} of rasterslice; name a folder that it wrote")
    return open_spool(folder / "layers")


def _map(path: Path, dtype: str) -> NDArray[Any]:
    """Map a file; one that holds nothing cannot be mapped."""
    if not path.stat().st_size:
        return np.empty(0, dtype)
    return np.asarray(np.memmap(path, dtype, "r"))


def _damaged(folder: Path, what: str) -> ModelError:
    return ModelError(f"{folder}: damaged layers, {what}; slice again")
