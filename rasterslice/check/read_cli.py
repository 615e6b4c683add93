"""Common Layer Interface, ASCII and binary: contours of part and supports; of hatches those of our own scaffold."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..errors import ModelError
from .form import (
    OUTER,
    SUPPORT,
    Floats,
    TheirLayer,
    Theirs,
    bounded,
    damaged,
    load,
    number,
    numbers,
    one_per_slice,
    pack_beads,
    ring,
)  # fmt: skip

_SCAFFOLD = re.compile(r"scaffold|sme", re.IGNORECASE)  # by our rule: sacrificial material all round
_SUPPORT = re.compile(r"support", re.IGNORECASE)
_DIRECTION = {0: -1, 1: 1}  # clockwise is a hole, counter-clockwise an outer contour; 2 is open
#: The header of our own export, whose polylines are the middle lines of boundary beads.
_OURS = re.compile(rb"\$\$LABEL/1,part\s+\$\$LABEL/2,scaffold\s+\$\$DIMENSION/[^$]*\$\$LAYERS/[0-9]{6}\s")
_COMMENT = re.compile(rb"//.*?//", re.DOTALL)
_GEOMETRY = {b"$$LAYER", b"$$POLYLINE", b"$$HATCHES"}


class _Layers:
    """Layers as they grow, whichever way they are written."""

    def __init__(self, path: Path, unit: float, labels: dict[int, str], head: bytes) -> None:
        self.path, self.unit, self.labels, self.head = path, unit, labels, head
        self.layers: list[TheirLayer] = []
        self.opened, self.ours = 0, _OURS.search(head) is not None

    def layer(self, z: float, where: str | int) -> None:
        z = float(bounded(np.array([z * self.unit]), self.path, where)[0])
        self.layers.append(TheirLayer(z, f"line {where}" if isinstance(where, int) else where))

    def polyline(self, label: int, direction: int, points: Floats, where: str | int) -> None:
        if not self.layers:
            raise damaged(self.path, where, "a polyline comes before the first layer")
        if direction not in (0, 1, 2):
            raise damaged(self.path, where, f"the direction of a polyline must be 0, 1 or 2, got {direction}")
        points = ring(bounded(points * self.unit, self.path, where))
        if direction == 2:
            self.opened += 1
            return
        if len(points) < 3:
            raise damaged(self.path, where, f"a closed contour needs 3 points, got {len(points)}")
        layer = self.layers[-1]
        if _SCAFFOLD.search(self.labels.get(label, "")):
            layer.scaffold.append(points)
        elif _SUPPORT.search(self.labels.get(label, "")):
            layer.supports.append(points)
        else:
            layer.loops.append(points)
            layer.declared.append(_DIRECTION[direction])

    def hatches(self, label: int, ends: Floats, where: str | int) -> None:
        """Take straight lines (N, 4), of which those of our own scaffold are its fill: lines of two points."""
        if self.keeps(label) and self.layers:
            lines = bounded(ends.reshape(-1, 2, 2) * self.unit, self.path, where)
            self.layers[-1].scaffold.extend(lines)

    def keeps(self, label: int) -> bool:
        """Whether the hatches of a label are looked at."""
        return self.ours and _SCAFFOLD.search(self.labels.get(label, "")) is not None

    def finish(self, kind: str) -> Theirs:
        layers = self.layers
        base = layers[0].z if layers else 0.0
        if layers and not (layers[0].loops or layers[0].scaffold or layers[0].supports):
            layers = layers[1:]  # the empty layer at the bottom, which lets readers infer the first thickness
        if not layers:
            raise ModelError(f"{self.path}: no layer was found; name a file that holds layers")
        layers, z_is = one_per_slice(layers, self.head, self.path, base)
        if self.ours:
            return self.beads(kind, layers, z_is)
        notes = [f"{self.opened} open polylines were skipped"] if self.opened else []
        scaffold = any(k.scaffold for k in layers) or any(_SCAFFOLD.search(t) for t in self.labels.values())
        return Theirs(f"CLI, {kind}", layers, z_is, precision=0.0005 * self.unit, scaffold=scaffold, notes=notes)

    def beads(self, kind: str, layers: list[TheirLayer], z_is: str) -> Theirs:
        """Return the polylines as beads, the scaffold as support."""
        parts: list[TheirLayer] = []
        props: list[TheirLayer] = []
        for k in layers:
            rings = [np.vstack([p, p[:1]]) if len(p) > 2 else p for p in (*k.loops, *k.scaffold)]
            roles = [OUTER] * len(k.loops) + [SUPPORT] * len(k.scaffold)
            layer = TheirLayer(k.z, k.where, beads=pack_beads(rings, roles, [np.nan] * len(roles)))
            (parts if k.loops else props).append(layer)
        return Theirs(f"CLI of rasterslice, {kind}", parts, z_is, precision=0.0005 * self.unit, props=props)


def read(path: Path) -> Theirs:
    """Read a CLI file.

    Raises
    ------
    ModelError
        ``file:line: message`` (in binary geometry: the byte), for whatever is not as the format says. A count is
        believed only when the bytes that it promises are there.
    """
    data = load(path)
    end = data.find(b"$$HEADEREND")
    if end < 0:
        raise damaged(path, data.count(b"\n") + 1, "the header does not end: no $$HEADEREND")
    head = _COMMENT.sub(_only_breaks, data[:end])
    unit, labels, binary = 1.0, {}, False
    for line, command, text in _commands(head, 1):
        if command == b"$$UNITS":
            unit = number(text, path, line, "$$UNITS")
            if unit <= 0:
                raise damaged(path, line, f"$$UNITS must be > 0 mm, got {unit:g}")
        elif command == b"$$BINARY":
            binary = True
        elif command == b"$$ALIGN":
            raise damaged(path, line, "$$ALIGN is not built yet", "write the file without it")
        elif command == b"$$LABEL":
            key, _, name = text.partition(b",")
            labels[int(number(key, path, line, "$$LABEL"))] = name.decode("utf-8", "replace")
    layers = _Layers(path, unit, labels, head)
    if binary:
        _binary(layers, data, end + len(b"$$HEADEREND"))
        return layers.finish("binary")
    _ascii(layers, data[end:], data.count(b"\n", 0, end) + 1)
    return layers.finish("ASCII")


def _only_breaks(comment: re.Match[bytes]) -> bytes:
    return b"\n" * comment[0].count(b"\n")


def _commands(data: bytes, line: int) -> Iterator[tuple[int, bytes, bytes]]:
    """Give line, name and rest of each command."""
    for part in data.split(b"$$")[1:] if b"$$" in data else ():
        name, _, rest = part.partition(b"/")
        yield line, b"$$" + name.split()[0] if name.split() else b"$$", rest.strip()
        line += part.count(b"\n")


def _ascii(layers: _Layers, data: bytes, line: int) -> None:
    path, ended = layers.path, False
    for where, command, text in _commands(_COMMENT.sub(_only_breaks, data), line):
        if command == b"$$LAYER":
            layers.layer(number(text, path, where, "$$LAYER"), where)
        elif command == b"$$POLYLINE":
            values = numbers(text.split(b","), path, where, "$$POLYLINE: a value")
            if len(values) < 3 or len(values) != 3 + 2 * values[2]:
                said = f"{values[2]:g} points" if len(values) > 2 else "too little"
                raise damaged(path, where, f"$$POLYLINE promises {said} and has {max(len(values) - 3, 0)} coordinates")
            layers.polyline(int(values[0]), int(values[1]), values[3:].reshape(-1, 2), where)
        elif command == b"$$HATCHES":
            if layers.ours:
                values = numbers(text.split(b","), path, where, "$$HATCHES: a value")
                if len(values) < 2 or len(values) != 2 + 4 * values[1]:
                    said = f"{values[1]:g} lines" if len(values) > 1 else "too little"
                    what = f"$$HATCHES promises {said} and has {max(len(values) - 2, 0)} coordinates"
                    raise damaged(path, where, what)
                layers.hatches(int(values[0]), values[2:].reshape(-1, 4), where)
        elif command == b"$$GEOMETRYEND":
            ended = True
        elif command not in (b"$$HEADEREND", b"$$GEOMETRYSTART"):
            raise damaged(path, where, f"unknown command {command[:30].decode('ascii', 'replace')}")
    if not ended:
        raise damaged(path, line + data.count(b"\n"), "the geometry does not end: no $$GEOMETRYEND")


def _binary(layers: _Layers, data: bytes, at: int) -> None:
    path = layers.path

    def take(size: int) -> int:
        """Return where the next bytes begin, when they are there."""
        nonlocal at
        if size < 0 or at + size > len(data):
            raise damaged(path, f"byte {at}", f"{size} bytes are promised and {len(data) - at} are left")
        at += size
        return at - size

    while len(data) - at >= 2:
        start = at
        (command,) = struct.unpack_from("<H", data, take(2))
        where = f"byte {start}"
        if command == 127:
            layers.layer(struct.unpack_from("<f", data, take(4))[0], where)
        elif command == 128:
            layers.layer(struct.unpack_from("<H", data, take(2))[0], where)
        elif command in (129, 130):
            form, size, dtype = ("<3H", 6, "<u2") if command == 129 else ("<3i", 12, "<f4")
            label, direction, n = struct.unpack_from(form, data, take(size))
            place = take(2 * n * np.dtype(dtype).itemsize)
            points = np.frombuffer(data, dtype, 2 * n, place).astype(np.float64).reshape(-1, 2)
            layers.polyline(label, direction, points, where)
        elif command in (131, 132):
            form, size, dtype = ("<2H", 4, "<u2") if command == 131 else ("<2i", 8, "<f4")
            label, n = struct.unpack_from(form, data, take(size))
            place = take(4 * n * np.dtype(dtype).itemsize)
            ends = np.frombuffer(data, dtype, 4 * n, place)
            layers.hatches(label, ends.astype(np.float64).reshape(-1, 4), where)
        elif data[start:].strip(b"\0\r\n ") in (b"", b"$$GEOMETRYEND"):
            return
        else:
            raise damaged(path, where, f"unknown command {command}")
