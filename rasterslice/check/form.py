"""What a reader gives: the layers of another program, as areas or as beads, in millimetres."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import ModelError

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: What a bead is: the outermost of a wall, any other of a wall, inside, or a support. Anything else is not read.
OUTER, WALL, FILL, SUPPORT = range(4)
LIMIT_MM = 1e5  # farther out nothing is printed
UNITS = {25.4: "inches", 10.0: "centimetres", 1000.0: "metres"}
_ABOUT = 0.05  # how far off a length may be that a unit explains
LIMIT_BYTES = 1 << 30
UNSIZED = "the pictures do not say how large a pixel is: they are scaled to the part"
OURS = re.compile(r"(?:part|scaffold)_[0-9]{4,}")  # pictures of our own, counted from 0
_ODD = re.compile(rb"[^-+.0-9eE\s]")  # in no number
_DIVIDED = re.compile(rb"\b(ice_layers|slice_thickness|slice_position) = ([^\s;,]*)")


@dataclass(frozen=True, slots=True)
class Beads:
    """Centre lines of one layer.

    Attributes
    ----------
    points : (N, 2) float64
        mm.
    offsets : (P + 1,) int64
        Line ``i`` is ``points[offsets[i]:offsets[i + 1]]``; the first point of a ring comes again at its end.
    role : (P,) int64
        OUTER, WALL, FILL or SUPPORT.
    width : (P,) float64
        Width of each bead, mm; nan where the file does not say.
    fed : (P,) float64 or None
        Filament for one mm of each bead whose width the file does not say; nan of others.
    """

    points: Floats
    offsets: NDArray[np.int64]
    role: NDArray[np.int64]
    width: Floats
    fed: Floats | None = None


@dataclass(frozen=True, slots=True)
class TheirLayer:
    """One layer of another program.

    Attributes
    ----------
    z : float
        As the file gives it, mm; nan where it gives none.
    where : str
        Where in the file it begins: ``line 12``.
    loops, scaffold, supports : list of (N, 2) float64
        Closed contours of areas, the first point not repeated; supports follow a rule of their own.
    declared : list of int
        What the file calls each loop: 1 an outer one, -1 a hole, 0 nothing.
    beads : Beads or None
    middle : (3, 2) float64 or None
        Of a picture in black and white: the middles of a pixel, of the one right of it and of the one above it.
    """

    z: float
    where: str
    loops: list[Floats] = field(default_factory=list)
    scaffold: list[Floats] = field(default_factory=list)
    declared: list[int] = field(default_factory=list)
    beads: Beads | None = None
    supports: list[Floats] = field(default_factory=list)
    middle: Floats | None = None


@dataclass(frozen=True, slots=True)
class Theirs:
    """All layers of another program.

    Attributes
    ----------
    format : str
    layers : list of TheirLayer
        In the order of the file.
    z_is : {"top", "middle", "number", None}
        What heights mean in this format, when it says so; "number" counts layers.
    precision : float
        How far off the format itself may put a boundary, mm.
    scaffold : bool
        Whether the file tells scaffold from part, by our rule.
    props : list of TheirLayer
        Layers that hold nothing but support, which may lie at heights of their own.
    any_mirror : bool
        Whether writers of this format disagree about where y points.
    any_turn : bool
        Whether they turn and mirror as the printer needs it, and do not say so.
    turned : str
        How the format lies in our frame, in the words of `align.TURNS`.
    notes : list of str
    step : float
        Distance of layers whose heights are counted, mm; 0 where the file does not say it.
    unsaid : bool
        Whether beads bear no names, so that a skirt looks like a wall.
    filament : float
        Diameter of the filament, mm; nan where the file does not say.
    pitch : float
        Distance between the pixels of a run of ours, mm; 0 of anything else.
    pixel : float
        Size of the pixels of pictures in black and white, as the file gives it; 0 of anything else.
    grain : float
        Size of the pixels between which areas were traced, as the file gives it; nan: those of the parameter file; 0 of
        anything else, and of pictures in black and white.
    scale : float
        By which x, y, and what is measured along them, were multiplied because the file is in another unit than mm;
        not heights, nor ``precision``, ``pixel`` and ``grain``.
    unit : str
        Which unit that is, in words; empty where it is mm.
    unsized : bool
        Whether pictures do not say how large a pixel is; lengths are then pixels, and a note says `UNSIZED`.
    name : str
        Of the file or folder, for errors.
    """

    format: str
    layers: list[TheirLayer]
    z_is: str | None
    precision: float = 0.0
    scaffold: bool = False
    any_mirror: bool = False
    any_turn: bool = False
    turned: str = ""
    notes: list[str] = field(default_factory=list)
    props: list[TheirLayer] = field(default_factory=list)
    step: float = 0.0
    unsaid: bool = False
    filament: float = math.nan
    pitch: float = 0.0
    pixel: float = 0.0
    grain: float = 0.0
    scale: float = 1.0
    unit: str = ""
    unsized: bool = False
    name: str = ""


def damaged(path: Path, line: int | str, what: str, remedy: str = "write the file anew") -> ModelError:
    """Return the error of a file that cannot be read on; a number is a line."""
    return ModelError(f"{path}:{line}: {what}; {remedy}")


def load(path: Path) -> bytes:
    """Return the bytes of a file of bearable size."""
    try:
        size = path.stat().st_size
        if size > LIMIT_BYTES:
            limit = f"at most {LIMIT_BYTES / 1e9:.1f} GB are read"
            raise ModelError(f"{path}: {size / 1e9:.1f} GB; {limit}. Split the file")
        data = path.read_bytes()
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror or error}; check name and permissions") from error
    if not data.strip():
        raise ModelError(f"{path}: the file is empty; write it anew")
    return data


def strict(text: bytes | str) -> float:
    """Return the number that a text spells in ASCII; Python's own `float` also takes 1_0, and digits of any script."""
    if not text.isascii() or ("_" in text if isinstance(text, str) else b"_" in text):
        raise ValueError(text[:30])
    return float(text)


def numbers(words: Sequence[bytes] | Sequence[str], path: Path, line: int | str, what: str) -> Floats:
    """Return finite numbers, as strict as `number`, or name the line and the first that is none."""
    try:
        text = b" ".join(w if isinstance(w, bytes) else w.encode("ascii") for w in words)
        if _ODD.search(text):
            raise ValueError
        values = np.array(words, np.float64)
        if not np.isfinite(values).all():
            raise ValueError
        return values
    except ValueError:  # an encoding, or what NumPy cannot convert
        for word in words:
            number(word, path, line, what, math.inf)
        raise


def number(text: bytes | str, path: Path, line: int | str, what: str, limit: float = LIMIT_MM) -> float:
    """Return a finite number within bounds, or name the line."""
    try:
        value = strict(text)
    except ValueError:
        raise damaged(path, line, f"{what} must be a number, got {shown(text)}") from None
    if not math.isfinite(value) or abs(value) > limit:
        within = "be finite" if math.isinf(limit) else f"lie within {limit:g} mm"
        raise damaged(path, line, f"{what} must {within}, got {value:g}")
    return value


def shown(text: bytes | str) -> str:
    """Return the beginning of what a file holds, fit to be printed."""
    return repr((text.decode("ascii", "replace") if isinstance(text, bytes) else text)[:30])


def bounded(points: Floats, path: Path, line: int | str) -> Floats:
    """Return points that are finite and within bounds, or name the line."""
    if points.size and not bool(np.all(np.abs(points) <= LIMIT_MM)):
        bad = points[~(np.abs(points) <= LIMIT_MM)].flat[0]
        raise damaged(path, line, f"a coordinate must lie within {LIMIT_MM:g} mm, got {bad:g}")
    return points


def ring(points: Floats) -> Floats:
    """Return a closed contour without the first point repeated at its end."""
    return points[:-1] if len(points) > 1 and bool(np.all(points[0] == points[-1])) else points


def pack_beads(lines: Iterable[Floats], roles: Iterable[int], widths: Iterable[float]) -> Beads:
    """Return beads of separate lines."""
    lines = list(lines)
    ends = np.cumsum([0, *(len(line) for line in lines)]).astype(np.int64)
    points = np.concatenate(lines) if lines else np.empty((0, 2))
    return Beads(points, ends, np.array(list(roles), np.int64), np.array(list(widths), np.float64))


def numbered(files: list[Path]) -> list[float]:
    """Return the number of the layer of each file: the last one in its name, else its place."""
    found = [re.findall(r"[0-9]+", path.stem) for path in files]
    numbers = [float(f[-1]) if f and len(f[-1]) < 9 else math.nan for f in found]
    if len(set(numbers)) < len(files) or any(math.isnan(n) for n in numbers):
        return [float(i) for i in range(len(files))]
    ours = all(OURS.fullmatch(path.stem) for path in files)
    return [n - (0.0 if ours else min(1.0, min(numbers))) for n in numbers]  # counted from 0, or from 0 or 1


def one_per_slice(layers: list[TheirLayer], head: bytes, path: Path, base: float) -> tuple[list[TheirLayer], str]:
    """Return the slices of an export of ours that tells how they are divided into ice layers, and what heights mean.

    Ice layers of a slice share the boundary: the first stands for all that have the same one, with the scaffold of
    the last. One with another boundary stays, and is then found to come twice. Other files stay as they are.

    Parameters
    ----------
    layers : list of TheirLayer
        Upwards; heights are those of upper surfaces.
    head : bytes
        Where the file says how slices are divided.
    path : Path
        For errors.
    base : float
        Height of the bottom of the first slice, mm.
    """
    said = {}
    for match in _DIVIDED.finditer(head):
        line = head.count(b"\n", 0, match.start()) + 1
        said[match[1]] = number(match[2], path, line, match[1].decode())
    n, step = said.get(b"ice_layers", 1.0), said.get(b"slice_thickness", 0.0)
    if n < 1 or step <= 0:
        return layers, "top"
    position = said.get(b"slice_position", 0.5)
    step *= _unit_of_heights(layers, step / n)
    numbers = (math.ceil((k.z - base) / step - 0.25 / n) - 1 if math.isfinite(k.z) else math.nan for k in layers)
    cut = [replace(k, z=base + (i + position) * step) for k, i in zip(layers, numbers, strict=True)]
    return (fold(cut) if n > 1 else cut), "middle"


def _unit_of_heights(layers: list[TheirLayer], ice: float) -> float:
    """Return in which unit heights are written that should lie an ice layer apart, mm: 1 unless it is another."""
    steps = np.diff(np.unique([k.z for k in layers if math.isfinite(k.z)]))
    ratio = float(np.median(steps)) / ice if len(steps) else 1.0
    return next((f for u in UNITS for f in (u, 1 / u) if abs(ratio / f - 1) < _ABOUT), 1.0)


def fold(layers: list[TheirLayer]) -> list[TheirLayer]:
    """Return layers of which those that follow each other at one height with the same walls are one."""
    found: list[TheirLayer] = []
    for layer in layers:
        if not (found and found[-1].z == layer.z and _same_walls(found[-1], layer)):
            found.append(layer)
            continue
        last = found[-1]
        last.scaffold.extend(layer.scaffold)
        last.supports.extend(layer.supports)
        if last.beads and layer.beads:
            found[-1] = replace(last, beads=_with_props(last.beads, layer.beads))
    return found


def _with_props(beads: Beads, more: Beads) -> Beads:
    """Return beads with the supports of others."""
    held = [(beads, i) for i in range(len(beads.role))] + [(more, i) for i in np.flatnonzero(more.role == SUPPORT)]
    lines = [b.points[b.offsets[i] : b.offsets[i + 1]] for b, i in held]
    return pack_beads(lines, [int(b.role[i]) for b, i in held], [float(b.width[i]) for b, i in held])


def _same_walls(a: TheirLayer, b: TheirLayer) -> bool:
    """Whether two layers have the same contours and perimeters."""
    first, second = (
        [*k.loops, *((k.beads.points[np.repeat(k.beads.role <= WALL, np.diff(k.beads.offsets))],) if k.beads else ())]
        for k in (a, b)
    )
    return len(first) == len(second) and all(np.array_equal(p, q) for p, q in zip(first, second, strict=True))
