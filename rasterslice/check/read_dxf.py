"""DXF in text, R12 or later: polylines and lines as contours; of our own export the beads."""

from __future__ import annotations

import math
import re
from array import array
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import ModelError
from .dxf_contours import Polyline, as_areas
from .dxf_text import Vertices, groups
from .form import FILL, OUTER, SUPPORT, TheirLayer, Theirs, bounded, damaged, load, number, one_per_slice, pack_beads

#: Names of the layers of our own export, whose polylines are the middle lines of beads.
OURS = {"PART_BOUNDARY": OUTER, "PART_FILL": FILL, "SCAFFOLD_BOUNDARY": SUPPORT, "SCAFFOLD_FILL": SUPPORT}
_UNITS = {0: 1.0, 1: 25.4, 2: 304.8, 4: 1.0, 5: 10.0, 6: 1000.0, 13: 0.001, 14: 100.0}  # $INSUNITS in mm
_WRITING = {"TEXT", "MTEXT", "ATTDEF", "POINT", "DIMENSION", "LEADER", "MLEADER", "VIEWPORT", "TOLERANCE"}
_BASE = re.compile(rb"\bslice_base = (-?[0-9]{1,6}(?:\.[0-9]{1,9})?)\s")
_CLOSED, _CURVED, _SOLID, _MESH = 1, 2 | 4, 8, 16 | 64  # flags of a polyline
_FITTED = 1 | 2 | 8 | 16  # flags of a vertex that a curve was fitted to


@dataclass(slots=True)
class _Entity:
    """What is known of the entity that is being read, and of the polyline whose vertices follow it."""

    kind: str = ""
    line: int = 1
    name: str = "0"
    flags: int = 0
    elevation: float = 0.0
    hidden: bool = False
    x: array[float] = field(default_factory=lambda: array("d"))
    y: array[float] = field(default_factory=lambda: array("d"))
    z: array[float] = field(default_factory=lambda: array("d"))


class _Reader:
    """Collects polylines, one group of code and value after the other."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.section, self.variable, self.unit = "", "", 1.0
        self.open = _Entity()
        self.inside = ""  # VERTEX, while the vertices of a polyline come
        self.polylines: list[Polyline] = []
        self.skipped: Counter[str] = Counter()
        self.ended = False

    def group(self, code: int, value: str, line: int) -> None:
        if code == 0:
            self.begin(value.upper(), line)
        elif self.section == "" and code == 2 and self.open.kind == "SECTION":
            self.section = value.upper()
        elif self.section == "HEADER":
            self.header(code, value, line)
        elif self.section == "ENTITIES" and self.open.kind in ("POLYLINE", "LWPOLYLINE", "LINE"):
            self.value(code, value, line)

    def begin(self, kind: str, line: int) -> None:
        """Start the next entity, or vertex of a polyline."""
        if self.open.kind == "POLYLINE" and self.section == "ENTITIES":
            if kind in ("VERTEX", "SEQEND"):
                self.whole(line)
                self.inside = kind
                return
            if self.inside != "SEQEND":
                raise damaged(self.path, line, f"a polyline ends with {kind[:30]} and not with SEQEND")
        self.close(line)
        self.inside, self.open = "", _Entity(kind, line)
        self.ended |= kind == "EOF"
        if kind in ("ENDSEC", "SECTION"):
            self.section = ""
        elif self.section == "ENTITIES" and kind in _WRITING:
            self.skipped[kind] += 1
        elif self.section == "ENTITIES" and kind not in ("POLYLINE", "LWPOLYLINE", "LINE", "SEQEND"):
            raise damaged(self.path, line, f"entity {kind[:30]} is not built yet", "write polylines of straight lines")

    def header(self, code: int, value: str, line: int) -> None:
        if code == 9:
            self.variable = value.upper()
        elif self.variable == "$INSUNITS" and code == 70:
            unit = self.whole_number(value, line)
            if unit not in _UNITS:
                raise damaged(self.path, line, f"$INSUNITS {unit} is not built yet", "write 4, millimetres")
            self.unit = _UNITS[unit]

    def value(self, code: int, value: str, line: int) -> None:
        """Take one value of a polyline, of its vertex, or of a line."""
        e, head = self.open, self.open.kind == "POLYLINE" and not self.inside
        if self.inside == "SEQEND":
            return
        if code in (10, 11, 20, 21, 30, 31) and not head:
            self.coordinate(code, number(value, self.path, line, "a coordinate"), line)
        elif code in (30, 38) and (head or code == 38):
            e.elevation = number(value, self.path, line, "an elevation")
        elif code == 8 and not self.inside:
            e.name = value[:80]
        elif code == 70:
            self.flags(self.whole_number(value, line), line)
        elif code == 42 and number(value, self.path, line, "a bulge") != 0:
            raise damaged(self.path, line, "an arc (bulge) is not built yet", "write straight lines")
        elif code in (60, 67) and not self.inside:
            e.hidden |= self.whole_number(value, line) != 0  # not shown, or on the sheet of paper
        elif code == 230 and number(value, self.path, line, "an extrusion") <= 0.999999:
            raise damaged(self.path, line, "a polyline that does not lie flat is not built yet", "write flat ones")

    def flags(self, flags: int, line: int) -> None:
        if self.inside:
            if flags & _FITTED:
                raise damaged(self.path, line, "a curve fitted to a polyline is not built yet", "write straight lines")
            return
        self.open.flags = flags
        if self.open.kind == "POLYLINE" and flags & (_CURVED | _MESH):
            raise damaged(self.path, line, "a curve or a mesh is not built yet", "write polylines of straight lines")

    def vertices(self, places: Vertices, line: int) -> bool:
        """Take plain vertices together, where a polyline that says no height of its own wants them."""
        e = self.open
        wanted = self.section == "ENTITIES" and e.kind == "POLYLINE" and self.inside != "SEQEND"
        if not wanted or (e.elevation != 0 and not e.flags & _SOLID):
            return False
        self.whole(line)
        self.inside = "VERTEX"
        for values, more in zip((e.x, e.y, e.z), places, strict=True):
            values.extend(more)
        return True

    def coordinate(self, code: int, value: float, line: int) -> None:
        e, axis = self.open, code // 10
        values, due = (e.x, len(e.y)) if axis == 1 else (e.y, len(e.x) - 1) if axis == 2 else (e.z, len(e.x) - 1)
        if len(values) != due:
            raise damaged(self.path, line, f"{'xyz'[axis - 1]} of a point comes where it is not due")
        values.append(value)

    def whole_number(self, value: str, line: int) -> int:
        return int(number(value, self.path, line, "a flag"))

    def whole(self, line: int) -> None:
        """Refuse a point without y; give one without z the elevation."""
        e = self.open
        if len(e.y) != len(e.x):
            raise damaged(self.path, line, "a point has no y")
        flat = e.kind == "POLYLINE" and not e.flags & _SOLID and e.elevation != 0
        e.z.extend([e.elevation] * (len(e.x) - len(e.z)))
        if flat and len(e.z):
            e.z[-1] = e.elevation

    def close(self, line: int) -> None:
        """Keep the entity that ends here, if it is one that is read."""
        e = self.open
        if self.section != "ENTITIES" or e.kind not in ("POLYLINE", "LWPOLYLINE", "LINE"):
            return
        self.whole(line)
        if e.hidden:
            self.skipped["hidden " + e.kind] += 1
            return
        if e.kind == "LINE" and len(e.x) != 2:
            raise damaged(self.path, e.line, f"a line needs 2 points, got {len(e.x)}")
        points = np.array((e.x, e.y, e.z)).T * self.unit
        if len(points) < 2:
            raise damaged(self.path, e.line, f"a polyline of {len(points)} points")
        low, high = float(points[:, 2].min()), float(points[:, 2].max())
        if high - low > 1e-6:
            what = f"z changes from {low:g} to {high:g} mm within a polyline"
            raise damaged(self.path, e.line, f"{what}, which is not built yet", "write flat polylines")
        if self.unit > 1:  # each number lies within bounds
            bounded(points, self.path, e.line)
        closed = e.kind != "LINE" and bool(e.flags & _CLOSED)
        self.polylines.append(Polyline(float(points[0, 2]), e.name, e.line, points[:, :2], closed))


def read(path: Path) -> Theirs:
    """Read a DXF in text.

    Raises
    ------
    ModelError
        ``file:line: message``: no groups of code and value, arcs, curves, blocks, polylines that are not flat, numbers
        out of bounds, a file that is cut short.
    """
    data = load(path)
    if data.startswith(b"AutoCAD Binary DXF"):
        raise ModelError(f"{path}: DXF in its binary form is not built yet; write it as text")
    reader, line = _Reader(path), 0
    for code, value, line in groups(data, path, reader.vertices):
        reader.group(code, value, line)
        if reader.ended:
            break
    if not reader.ended:
        raise damaged(path, line, "the file ends before its EOF")
    if not reader.polylines:
        raise ModelError(f"{path}: no polyline was found; name a file that holds contours")
    notes = [f"{count} of {kind} were skipped" for kind, count in sorted(reader.skipped.items())]
    if {p.name for p in reader.polylines} <= OURS.keys():
        return _ours(path, reader.polylines, data[:2000], notes)
    return as_areas(reader.polylines, 0.0005 * reader.unit, notes)


def _ours(path: Path, polylines: list[Polyline], head: bytes, notes: list[str]) -> Theirs:
    """Return beads, those of the scaffold as support; a new height is a layer."""
    found: list[list[Polyline]] = []
    for p in polylines:
        if not found or found[-1][-1].z != p.z:
            found.append([])
        found[-1].append(p)
    layers = []
    for k in found:
        lines = [np.vstack([p.points, p.points[:1]]) if p.closed else p.points for p in k]
        beads = pack_beads(lines, [OURS[p.name] for p in k], [math.nan] * len(k))
        layers.append(TheirLayer(k[0].z, f"line {k[0].line}", beads=beads))
    base = _BASE.search(head)
    layers, z_is = one_per_slice(layers, head if base else b"", path, float(base[1]) if base else 0.0)
    parts = [k for k in layers if k.beads is not None and (k.beads.role != SUPPORT).any()]
    props = [k for k in layers if k.beads is not None and (k.beads.role == SUPPORT).all()]
    return Theirs("DXF of rasterslice", parts, z_is, precision=0.0001, props=props, notes=notes)
