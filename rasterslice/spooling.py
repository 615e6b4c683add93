"""Writes finished layers to disk, in the form that `spool` reads."""

from __future__ import annotations

import contextlib
import hashlib
import math
import struct
import zlib
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .paths import COLUMNS, REGIONS, Layer, Paths, Stat
from .spool import BLANK, CLOSED, FLOAT, HEADER, INTEGER, MAGIC, RECORD, SETS, TEXT, TEXT_BYTES, VERSION

#: `spool.RECORD`, as the numbers of a layer are put together fastest.
_RECORD = struct.Struct(f"<Id{len(SETS)}Q{len(SETS)}Q{len(SETS)}I{len(COLUMNS)}B{len(COLUMNS)}d{TEXT_BYTES}s")
_BUFFER = 1 << 20  # bytes of a file that are held, about


class SpoolWriter:
    """Writes layers into a new folder, highest index first.

    Parameters
    ----------
    folder : Path
        Is made; its parent must exist.
    n_layers : int
        How many layers will come.
    regions : bool
        Whether layers bring their regions, `Layer.part` and `Layer.scaffold`.
    """

    def __init__(self, folder: Path, n_layers: int, regions: bool) -> None:
        folder.mkdir()
        self._folder, self._regions = folder, regions
        self._records = bytearray(n_layers * RECORD.itemsize)
        self._layers = self._left = n_layers
        self._stats = list[dict[str, Stat]]()
        self._n_points = self._n_offsets = 0
        self._points, self._offsets = _Stream(folder / "points.f64", "<f8"), _Stream(folder / "offsets.u32", "<u4")

    def append(self, layer: Layer) -> None:
        """Add the next layer down; its arrays must not be changed until `close`."""
        if layer.index != self._left - 1:
            raise ValueError(f"layer {layer.index} came where {self._left - 1} was due")
        points, offsets, counts = [0] * len(SETS), [0] * len(SETS), [0] * len(SETS)
        for s, name in enumerate(SETS):
            paths: Paths | None = getattr(layer, name)
            if (paths is None) != (name in REGIONS and not self._regions):
                raise ValueError(f"layer {layer.index}: {name} is {'missing' if paths is None else 'unexpected'}")
            if paths is None:
                continue
            n, m = len(paths.points), len(paths.offsets)
            if paths.closed != CLOSED[s] or int(paths.offsets[-1]) != n:
                raise ValueError(f"{name}: damaged paths")
            points[s], offsets[s], counts[s] = self._n_points, self._n_offsets, m - 1
            self._n_points += n
            self._n_offsets += m
            self._points.add(paths.points)
            self._offsets.add(paths.offsets)
        self._points.flush(_BUFFER)
        self._offsets.flush(_BUFFER)
        numbers = layer.index, layer.z, *points, *offsets, *counts, *_packed(layer.stats)
        _RECORD.pack_into(self._records, layer.index * RECORD.itemsize, *numbers)
        self._stats.append(layer.stats)
        self._left -= 1

    def stats(self) -> list[dict[str, Stat]]:
        """Return the statistics of the layers so far, in print order: `append` takes them from the top."""
        return self._stats[::-1]

    def close(self) -> None:
        """Write the index, which makes the spool complete."""
        try:
            if self._left:
                raise ValueError(f"{self._left} layers are missing")
            for stream in (self._points, self._offsets):
                stream.flush()
        finally:
            self.abort()
        crc, sizes = zlib.crc32(self._records), (self._n_points, self._n_offsets)
        header = np.zeros(1, HEADER)
        header[0] = (MAGIC, VERSION, self._layers, self._regions, crc, *sizes)
        (self._folder / "index.bin").write_bytes(header.tobytes() + self._records)

    def sums(self) -> dict[str, str]:
        """Return the SHA-256 of the files that are as large as the paths, in hex, by their names."""
        return {stream.path.name: stream.sum.hexdigest() for stream in (self._points, self._offsets)}

    def abort(self) -> None:
        """Close the files without an index; what cannot be written then has been said."""
        for stream in (self._points, self._offsets):
            with contextlib.suppress(OSError):
                stream.file.close()

    def __enter__(self) -> SpoolWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: object, trace: TracebackType | None) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()


class _Stream:
    """A file that is written and hashed some at a time: each time, Python's lock is given away, and got back late."""

    def __init__(self, path: Path, dtype: str) -> None:
        self.path, self.file, self.sum = path, path.open("wb", buffering=0), hashlib.sha256()
        self._dtype, self._held, self._size = np.dtype(dtype), list[Any](), 0

    def add(self, array: NDArray[Any]) -> None:
        """Add the items of an array, which must not be changed until they are written."""
        if array.dtype != self._dtype or not array.flags.c_contiguous:
            array = np.ascontiguousarray(array, self._dtype)
        self._held.append(array)
        self._size += array.nbytes

    def flush(self, most: int = 0) -> None:
        """Write what is held, when it is more than ``most`` bytes."""
        if self._size <= most:
            return
        data, self._held, self._size = memoryview(b"".join(self._held)), [], 0
        self.sum.update(data)
        while data:  # a disk that is almost full takes a part
            data = data[self.file.write(data) :]


def _packed(stats: dict[str, Stat]) -> list[int | float | bytes]:
    """Return statistics as a record holds them: the kind of each, the value of each, and the text."""
    kinds: list[int | float | bytes] = []
    values: list[int | float | bytes] = []
    text = b""
    for name in COLUMNS:
        value = stats.get(name)
        if isinstance(value, str):
            text = value.encode("ascii")
            if name != "flags" or len(text) > TEXT_BYTES:
                raise ValueError(f"{name}: no room for the text {value!r}")
            kinds.append(TEXT)
            values.append(0.0)
        elif value is None or value != value:
            kinds.append(BLANK)
            values.append(math.nan)
        else:
            kinds.append(FLOAT if isinstance(value, float) else INTEGER)
            values.append(value)
    return [*kinds, *values, text]
