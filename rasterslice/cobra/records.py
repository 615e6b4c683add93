"""The trajectory file ``<PART>.RSD``: ASCII records that the player reads, one motion each.

::

    RSD 1 <layers> <records> <name>
    H <code>                      2: stop for measuring
    L <slice> <z> <mat> <npaths>  mat 1: ice, 2: scaffold; z: height of the tip
    P <id> <kind> <n> <v>         kind 1: boundary, 2: fill; n points follow; v: mm/s
    T x y                         travel there, shut, lifted; then down
    M x y                         straight on
    V x y                         straight on; the valve opens where this motion begins
    W x y                         straight on; the valve shuts where this motion begins
    E                             end of the path: the arm stops
    C <sum>                       sum of all bytes since the last L, without its record, modulo 65536
    Z                             end of the job

Lines end with CR LF. Numbers are mm with three decimals, tip in the frame of the part.
"""

from __future__ import annotations

import re
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from ..paths import Toolpath
from ..profile import Profile

_LETTERS = np.frombuffer(b"TMVW", np.uint8)
_WIDTH = 9  # -9999.999
_HEADER = "RSD 1 {:06d} {:09d} {}\r\n"
LIMIT_MM = 9999.999


class RecordWriter:
    """Writes toolpaths in the order of laying into a new file.

    Attributes
    ----------
    layers, records, points, paths : int
        How many were written; a layer is one material at one height.
    """

    def __init__(self, path: Path, name: str, profile: Profile) -> None:
        self.layers = self.records = self.points = self.paths = 0
        self._name, self._profile = name, profile
        self._file = path.open("wb", 1 << 20)
        self._file.write(_HEADER.format(0, 0, name).encode("ascii"))

    def add(self, path: Toolpath) -> None:
        """Write one toolpath."""
        z = path.top + self._profile.nozzles[path.material].standoff
        if abs(z) > LIMIT_MM or np.abs(path.points).max() > LIMIT_MM:
            raise UsageError(f"layer {path.layer}: a coordinate is beyond {LIMIT_MM} mm; move the part")
        head = "H 2\r\n" if path.hold else ""
        head += f"L {path.layer} {z:.3f} {path.material + 1} {len(path)}\r\n"
        body = _body(path, self.paths)
        total = int(np.frombuffer(body, np.uint8).sum(dtype=np.uint64)) & 0xFFFF
        self._file.write(head.encode("ascii"))
        self._file.write(body)
        self._file.write(b"C %d\r\n" % total)
        self.layers += 1
        self.paths += len(path)
        self.points += len(path.points)
        self.records += len(path.points) + 2 * len(path) + 2 + path.hold

    def close(self) -> None:
        """End the job, which makes the file complete."""
        self._file.write(b"Z\r\n")
        self.records += 1
        self._file.seek(0)
        self._file.write(_HEADER.format(self.layers, self.records, self._name).encode("ascii"))
        self._file.close()

    def __enter__(self) -> RecordWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: object, trace: TracebackType | None) -> None:
        if kind is None:
            self.close()
        else:
            self._file.close()


def base_name(stem: str) -> str:
    """Return a file name that old disks take: at most eight capital letters and digits, a letter first."""
    name = re.sub(r"[^A-Z0-9]", "", stem.upper().encode("ascii", "ignore").decode("ascii"))[:8]
    return name if name[:1].isalpha() and name not in ("RSPLAY", "RSCFG") else ("P" + name)[:8] if name else "PART"


def _body(path: Toolpath, first_id: int) -> bytes:
    """Return all records between L and C."""
    text, ends = _point_records(path)
    v = f"{path.speed:.3f}"
    kinds, sizes = path.kinds.tolist(), np.diff(path.offsets).tolist()
    cuts = ends[path.offsets].tolist()
    out = []
    for i, (kind, n, a, b) in enumerate(zip(kinds, sizes, cuts[:-1], cuts[1:], strict=True), first_id):
        out.append(b"P %d %d %d %s\r\n" % (i, kind, n, v.encode("ascii")))
        out.append(text[a:b])
        out.append(b"E\r\n")
    return b"".join(out)


def _point_records(path: Toolpath) -> tuple[bytes, NDArray[np.int64]]:
    """Return the T, M, V and W records of all points, and where each begins (one more: the end)."""
    n = len(path.points)
    rows = np.full((n, 2 * _WIDTH + 5), ord(" "), np.uint8)
    used = np.ones(rows.shape, bool)
    rows[:, 0] = _LETTERS[path.ops]
    for axis in (0, 1):
        at = 2 + axis * (_WIDTH + 1)
        _digits(path.points[:, axis], rows[:, at : at + _WIDTH], used[:, at : at + _WIDTH])
    rows[:, -2], rows[:, -1] = 13, 10
    ends = np.concatenate([[0], np.cumsum(used.sum(axis=1))])
    return rows[used].tobytes(), ends


def _digits(values: NDArray[np.float64], rows: NDArray[np.uint8], used: NDArray[np.bool_]) -> None:
    """Put mm with three decimals into columns, and say which columns are used."""
    micro = np.rint(values * 1000).astype(np.int32)
    rows[:, 0], used[:, 0] = ord("-"), micro < 0
    rest = np.abs(micro)
    for column in (8, 7, 6, 4, 3, 2, 1):
        used[:, column] = (rest > 0) | (column >= 4)
        over = rest // 10
        rows[:, column] = rest - 10 * over + ord("0")
        rest = over
    rows[:, 5] = ord(".")
