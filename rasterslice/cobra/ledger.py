"""What a file of records says must happen: sums, counts, heights, and every point, to hold a simulation against."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .chains import Array, Timed, spans

_POINTS = frozenset((b"T", b"M", b"V", b"W"))
_NEAR = 1e-6
_ROUNDED = 6e-4  # heights are written with three decimals
_WORDS = {b"RSD": 5, b"H": 2, b"L": 5, b"P": 5, b"T": 3, b"M": 3, b"V": 3, b"W": 3, b"E": 1, b"C": 2, b"Z": 1}


@dataclass(slots=True)
class Ledger:
    """Points of all paths in order, and what is wrong with the file.

    Attributes
    ----------
    points : (N, 4) float64
        x, y, height of the tip, mm; speed of the path, mm/s.
    letters : (N,) uint8
        ``T``, ``M``, ``V`` or ``W``.
    tools : (N,) uint8
        0 ice, 1 scaffold.
    faults : list of str
    """

    points: Array = field(default_factory=lambda: np.empty((0, 4)))
    letters: NDArray[np.uint8] = field(default_factory=lambda: np.empty(0, np.uint8))
    tools: NDArray[np.uint8] = field(default_factory=lambda: np.empty(0, np.uint8))
    faults: list[str] = field(default_factory=list)
    done: int = 0

    def match(self, t: Timed, pairs: NDArray[np.int64], tool: int) -> str | None:
        """Compare the next paths with motions that were played; return the first difference.

        Parameters
        ----------
        t : Timed
        pairs : (R, 3) int64
            Motion that opens a valve, motion that shuts it, nozzle.
        tool : int
        """
        which = np.unique(t.chain[pairs[:, 0]]) if len(pairs) else np.empty(0, np.int64)
        begin = np.concatenate([[0], t.moves.ends[:-1] + 1])[which]
        index = spans(begin, t.moves.ends[which] + 2)
        got = np.column_stack([t.moves.points[index], np.append(t.moves.speed, 0.0)[index - 1]])
        letters = np.full(len(t.moves.points), ord("M"), np.uint8)
        letters[begin], letters[pairs[:, 0] + 1], letters[pairs[:, 1] + 1] = ord("T"), ord("V"), ord("W")
        here = slice(self.done, self.done + len(index))
        self.done += len(index)
        want = self.points[here]
        if len(want) < len(got):
            return f"{len(got)} points are played where the records hold {len(want)} more"
        moved = got[:, 3] * (letters[index] != ord("T")) + want[:, 3] * (letters[index] == ord("T"))
        off = np.abs(np.column_stack([got[:, :3], moved]) - want).max(axis=1) > _NEAR
        off |= (letters[index] != self.letters[here]) | (self.tools[here] != tool)
        if not off.any():
            return None
        k = int(off.argmax())
        say = [f"{chr(a)} {p[0]:.3f} {p[1]:.3f} at {p[2]:.3f} mm, {p[3]:g} mm/s" for a, p in
               ((letters[index][k], got[k]), (self.letters[here][k], want[k]))]  # fmt: skip
        return f"point {here.start + k} is played as {say[0]}; the records say {say[1]}, tool {self.tools[here][k] + 1}"


def audit(data: bytes, manifest: dict[str, Any]) -> Ledger:
    """Read records and check their sums, counts, numbers of slices and heights.

    Parameters
    ----------
    data : bytes
        The whole file.
    manifest : dict
        Of the export: how many layers, and where slices lie.
    """
    out = Ledger()
    lines = data.split(b"\r\n")
    for n, line in enumerate(lines[:-1], 1):
        words = line.split(b" ")
        if _WORDS.get(words[0]) != len(words):
            out.faults.append(f"record {n} is none of ours: {line[:40].decode('ascii', 'replace')!r}")
            return out
    try:
        _sums(lines, out)
        _heads(lines, manifest, out)
        _points(lines, out)
    except ValueError as error:
        out.faults.append(f"the records hold what is no number: {error}")
    return out


def _sums(lines: list[bytes], out: Ledger) -> None:
    """Check the header, the end, and the sum of every layer."""
    layers = sum(line[:1] == b"L" for line in lines)
    head = lines[0].split()
    if not head or head[0] != b"RSD" or (int(head[2]), int(head[3])) != (layers, len(lines) - 2):
        out.faults.append(f"the header promises other counts than {layers} layers and {len(lines) - 2} records")
    if lines[-2:] != [b"Z", b""]:
        out.faults.append("the last record is not Z: the file is cut short")
    total = np.concatenate([[0], np.cumsum([sum(line) + 23 for line in lines], dtype=np.int64)])
    begin = -1
    for n, line in enumerate(lines):
        if line[:1] == b"L":
            if begin >= 0:
                out.faults.append(f"record {n + 1}: the layer before has no sum")
            begin = n
        elif line[:1] == b"C":
            got = int(total[n] - total[begin + 1]) & 0xFFFF
            if begin < 0 or int(line[2:]) != got:
                out.faults.append(f"record {n + 1}: {line.decode('ascii', 'replace')}, the sum of its layer is {got}")
            begin = -1


def _heads(lines: list[bytes], manifest: dict[str, Any], out: Ledger) -> None:
    """Check numbers, heights and materials of layers; numbers and kinds of paths."""
    low, step, layers = manifest.get("bottom"), manifest["thickness"], manifest["part_layers"]
    heads = [(n, line.split()) for n, line in enumerate(lines, 1) if line[:1] in (b"L", b"P")]
    top, slice_before, left, number = {1: -np.inf, 2: -np.inf}, -1, 0, 0
    for n, words in heads:
        if words[0] == b"P":
            left -= 1
            if int(words[1]) != number or int(words[2]) not in (1, 2):
                out.faults.append(f"record {n}: path {int(words[1])} of kind {int(words[2])}, expected path {number}")
            number += 1
            continue
        k, z, material, count = int(words[1]), float(words[2]), int(words[3]), int(words[4])
        if material not in top:
            out.faults.append(f"record {n}: material {material} is neither 1 nor 2")
            return
        if left:
            out.faults.append(f"record {n}: the layer before promises {left} more paths than it has")
        left = count
        if k < slice_before:
            out.faults.append(f"record {n}: slice {k} comes after slice {slice_before}")
        if z <= top[material]:
            out.faults.append(f"record {n}: the tip at {z:g} mm is not above {top[material]:g} mm, its last layer")
        slice_before, top[material] = k, z
        standoff = manifest["profile"][("part_nozzle", "scaffold_nozzle")[material - 1]]["standoff"]
        shares = [(i + 1) / layers for i in range(layers)] if material == 1 else [1.0]
        if low is not None and min(abs(low + (k + s) * step + standoff - z) for s in shares) > _ROUNDED:
            out.faults.append(f"record {n}: the tip at {z:g} mm is at no height of slice {k}")
    if left:
        out.faults.append(f"the last layer promises {left} more paths than it has")


def _points(lines: list[bytes], out: Ledger) -> None:
    """Keep every point with its height, speed and tool."""
    at = [n for n, line in enumerate(lines) if line[:1] in _POINTS]
    heads = np.array([(n, float(w[2]), float(w[3]) - 1) for n, w in _split(lines, b"L")]).reshape(-1, 3)
    speeds = np.array([(n, float(w[4])) for n, w in _split(lines, b"P")]).reshape(-1, 2)
    if not len(at) or not len(heads) or not len(speeds):
        return
    layer = np.searchsorted(heads[:, 0], at) - 1
    path = np.searchsorted(speeds[:, 0], at) - 1
    xy = np.array(b" ".join(lines[n][2:] for n in at).split(), np.float64).reshape(-1, 2)
    out.points = np.column_stack([xy, heads[layer, 1], speeds[path, 1]])
    out.letters = np.array([lines[n][0] for n in at], np.uint8)
    out.tools = heads[layer, 2].astype(np.uint8)


def _split(lines: list[bytes], letter: bytes) -> list[tuple[int, list[bytes]]]:
    return [(n, line.split()) for n, line in enumerate(lines) if line[:1] == letter]
