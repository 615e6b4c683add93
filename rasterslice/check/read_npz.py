"""The packed arrays of our own export, NPZ: regions where it holds them, else the beads.

The archive is looked through before anything of it is unpacked: few entries, none larger than its bytes make
believable, and each of exactly the size that the head of its array asks for. Nothing is ever unpickled.
"""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ModelError
from ..grid import MOST_SLICES
from ..paths import REGIONS
from .form import FILL, LIMIT_MM, OUTER, SUPPORT, Floats, TheirLayer, Theirs, load, pack_beads

_HEAD = re.compile(
    rb"\{'descr': '([<|][fiu][1248])', 'fortran_order': False, 'shape': \(([0-9]{1,12})(?:,|, 2)\),? \} *\n"
)
_DAMAGE = (zipfile.BadZipFile, zlib.error, struct.error, EOFError, ValueError, RuntimeError, OSError)
_MOST_ENTRIES = 200
_MOST_DIRECTORY = 1 << 20  # bytes
_MOST_RATIO = 100  # of what is unpacked to the file
_CHUNK = 1 << 20
_BEADS = (
    ("part_boundary", OUTER, 3), ("part_fill", FILL, 2), ("scaffold_boundary", SUPPORT, 3),
    ("scaffold_fill", SUPPORT, 2),
)  # fmt: skip


def read(path: Path) -> Theirs:
    """Read an NPZ of ours.

    Raises
    ------
    ModelError
        ``file: entry: message``: no archive, an array that is missing, of another kind than it should be or of
        another size than the archive says, paths that do not fit, numbers out of bounds.
    """
    data = load(path)
    _directory(data, path)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return _layers(_Arrays(archive, path, len(data)), path)
    except _DAMAGE as error:
        raise ModelError(f"{path}: a damaged archive: {error or 'it ends too early'}; export it anew") from None


def _directory(data: bytes, path: Path) -> None:
    """Refuse an archive whose directory promises more than an NPZ holds, before it is read."""
    at = data.rfind(b"PK\5\6", max(0, len(data) - 22 - 65535))
    if at < 0 or at + 22 > len(data):
        raise ModelError(f"{path}: no end of a zip archive was found: the file is cut short, or no NPZ; export it anew")
    entries, size = struct.unpack("<HI", data[at + 10 : at + 16])
    if entries > _MOST_ENTRIES or size > _MOST_DIRECTORY or data[max(at - 20, 0) : at].startswith(b"PK\6\7"):
        held = f"its directory holds {entries} entries in {size} bytes"
        raise ModelError(f"{path}: {held}, an NPZ of layers at most {_MOST_ENTRIES}; unpack it, and name the folder")


class _Arrays:
    """The arrays of an archive, checked before they are read."""

    def __init__(self, archive: zipfile.ZipFile, path: Path, size: int) -> None:
        self.archive, self.path = archive, path
        self.sizes = {info.filename: info.file_size for info in archive.infolist()}
        if any(info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for info in archive.infolist()):
            raise ModelError(f"{path}: packed in another way than by deflate; export it anew")
        held = sum(self.sizes.values())
        if held > _MOST_RATIO * size + _CHUNK:
            what = f"{size} bytes would unpack to {held}, at most {_MOST_RATIO} times as many are read"
            raise ModelError(f"{path}: {what}; export it anew")

    def has(self, name: str) -> bool:
        return f"{name}.npy" in self.sizes

    def get(self, name: str, kinds: str, columns: int = 1) -> NDArray[Any]:
        """Return an array of one column or two, of one of some kinds of number, once its size is known to be right."""
        entry = f"{name}.npy"
        if entry not in self.sizes:
            raise self.wrong(name, "is not in the archive")
        with self.archive.open(entry) as file:
            start = file.read(10)
            if len(start) < 10 or start[:8] != b"\x93NUMPY\x01\x00":
                raise self.wrong(name, "is no NPY of version 1")
            length = int.from_bytes(start[8:], "little")
            found = _HEAD.fullmatch(file.read(length))
            if not found or found[1][1:2].decode() not in kinds or (b", 2)" in found[0]) != (columns == 2):
                raise self.wrong(name, f"is no array of {columns} column{'s' * (columns > 1)} of plain numbers")
            dtype, rows = np.dtype(found[1].decode()), int(found[2])
            due = 10 + length + rows * columns * dtype.itemsize
            if due != self.sizes[entry]:
                raise self.wrong(name, f"promises {due} bytes and the archive holds {self.sizes[entry]}")
            parts = list(iter(lambda: file.read(_CHUNK), b""))
        values: NDArray[Any] = np.frombuffer(b"".join(parts), dtype)
        if len(values) != rows * columns:
            raise self.wrong(name, f"promises {rows * columns} numbers and holds {len(values)}")
        return values.reshape(rows, 2) if columns == 2 else values

    def numbers(self, name: str, columns: int = 1) -> Floats:
        """Return lengths, mm."""
        values = self.get(name, "f", columns).astype(np.float64, copy=False)
        if not bool(np.all(np.abs(values) <= LIMIT_MM)):
            raise self.wrong(name, f"holds a number that is not within {LIMIT_MM:g} mm")
        return values

    def ends(self, name: str, last: int) -> NDArray[np.int64]:
        """Return offsets, which must grow from 0 to the number of what they divide."""
        values = self.get(name, "iu")
        if values.dtype == np.uint64 and bool(np.any(values > np.uint64(last))):
            raise self.wrong(name, f"does not divide {last}")
        ends = values.astype(np.int64)
        if not len(ends) or ends[0] != 0 or ends[-1] != last or bool(np.any(ends[1:] < ends[:-1])):
            raise self.wrong(name, f"does not divide {last}")
        return ends

    def wrong(self, name: str, what: str) -> ModelError:
        return ModelError(f"{self.path}: {name}.npy: {what}; export it anew")


def _layers(arrays: _Arrays, path: Path) -> Theirs:
    if not arrays.has("z"):
        raise ModelError(f"{path}: an archive without z.npy is no NPZ of ours; unpack pictures, and name the folder")
    z = arrays.numbers("z").tolist()
    if not 0 < len(z) <= MOST_SLICES:
        raise arrays.wrong("z", f"holds {len(z)} layers; 1 to {MOST_SLICES} are read")
    if arrays.has("part_points"):
        part = _paths(arrays, "part", len(z), 3)
        scaffold = _paths(arrays, "scaffold", len(z), 3) if arrays.has("scaffold_points") else [[] for _ in z]
        regions = [
            TheirLayer(height, f"layer {k}", part[k], scaffold[k], [0] * len(part[k])) for k, height in enumerate(z)
        ]
        return Theirs("NPZ of rasterslice", regions, "middle", precision=0.025, scaffold=any(scaffold), grain=np.nan)
    sets = [(role, least, _paths(arrays, name, len(z), least)) for name, role, least in _BEADS]
    parts: list[TheirLayer] = []
    props: list[TheirLayer] = []
    for k, height in enumerate(z):
        lines = [(role, np.vstack([p, p[:1]]) if least > 2 else p) for role, least, found in sets for p in found[k]]
        roles = [role for role, _ in lines]
        beads = pack_beads([p for _, p in lines], roles, [np.nan] * len(roles))
        if roles:
            (props if min(roles) == SUPPORT else parts).append(TheirLayer(height, f"layer {k}", beads=beads))
    return Theirs("NPZ of rasterslice, beads", parts, "middle", precision=0.0001, props=props)


def _paths(arrays: _Arrays, name: str, count: int, least: int) -> list[list[Floats]]:
    """Return the paths of each layer; of fewer points than they need, regions may hold some, which enclose nothing."""
    points = arrays.numbers(f"{name}_points", 2)
    offsets = arrays.get(f"{name}_offsets", "iu")
    ends = arrays.ends(f"{name}_offsets", len(points))
    layers = arrays.ends(f"{name}_layers", len(offsets) - 1)
    if len(layers) != count + 1:
        raise arrays.wrong(f"{name}_layers", f"tells of {len(layers) - 1} layers, z of {count}")
    few = np.diff(ends) < least
    if name not in REGIONS and bool(few.any()):
        raise arrays.wrong(f"{name}_offsets", f"holds a path of fewer than {least} points")
    kept = np.concatenate([[0], np.cumsum(~few)])[layers]
    found = [points[a:b] for a, b in zip(ends[:-1][~few].tolist(), ends[1:][~few].tolist(), strict=True)]
    return [found[a:b] for a, b in zip(kept[:-1].tolist(), kept[1:].tolist(), strict=True)]
