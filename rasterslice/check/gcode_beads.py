"""Moves of G-code -> beads: where the head goes, where it lays something down, and in which layer."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .form import LIMIT_MM, Floats, damaged
from .gcode_arcs import with_chords
from .loops import Ints

IGNORED = -1  # role of skirt, brim, wipe and prime towers, custom code
STRAIGHT, SET, CLOCKWISE, COUNTER = range(4)  # kinds of rows: a move, an E that is only set, arcs
AWAY = 8  # another kind, and 1, 2 and 4 for X, Y and Z: the head goes where the file does not say
_ROUNDED, _SWELLS = 0.1, 0.04  # mm: shorter moves are too rounded to tell; by how much a bead may swell


@dataclass(slots=True)
class Moves:
    """All moves of a file, in its order.

    Attributes
    ----------
    line : (N,) int64
    given : (N, 4) float64
        What each gives for X, Y, Z and E; nan where it gives nothing.
    kind : (N,) uint8
        STRAIGHT, SET, CLOCKWISE, COUNTER or AWAY with axes.
    centre : dict
        I and J of the rows that are arcs.
    unit : (N,) float64
        mm.
    relative, relative_e : (N,) bool
        Whether X, Y and Z, and E, count from where the head is.
    unsure_e : (N,) bool
        Whether printers disagree about E: some take G90 and G91 to mean it, too, and some do not.
    role, layer, piece : (N,) int64
        What a bead would be, in which layer as the file marks them, and a number that changes wherever a bead ends.
    width : (N,) float64
        mm; nan where the file does not say.
    """

    line: Ints
    given: Floats
    kind: NDArray[np.uint8]
    centre: dict[int, tuple[float, float]]
    unit: Floats
    relative: NDArray[np.bool_]
    relative_e: NDArray[np.bool_]
    unsure_e: NDArray[np.bool_]
    role: Ints
    layer: Ints
    piece: Ints
    width: Floats


@dataclass(slots=True)
class Laid:
    """Beads of a whole file; those of one layer follow each other.

    Attributes
    ----------
    points : (N, 2) float64
        mm.
    starts : (P + 1,) int64
        Bead ``i`` is ``points[starts[i]:starts[i + 1]]``.
    role, layer : (P,) int64
    width : (P,) float64
    fed : (P,) float64
        Filament fed, mm; 0 where the width is said.
    heights : (L,) float64
        z of each layer that holds a bead; nan where none is said, or nothing is laid.
    lines : (L,) int64
        Where each layer begins; of files that do not mark them, where its first bead does.
    """

    points: Floats
    starts: Ints
    role: Ints
    layer: Ints
    width: Floats
    fed: Floats
    heights: Floats
    lines: Ints


def lay(m: Moves, layer_lines: Ints | None, path: Path) -> Laid | None:
    """Return the beads that moves lay down; None where they lay none.

    Parameters
    ----------
    m : Moves
    layer_lines : (L,) int64, optional
        Where the file marks its layers; without, each height is a layer.
    path : Path
        For errors.

    Raises
    ------
    ModelError
        ``file:line: message``: a place out of bounds, a height that changes within a layer.
    """
    x, y, z = (_track(m.given[:, i] * m.unit, m.relative, 0.0 if i < 2 else math.nan) for i in range(3))
    advance = _advance(m)
    source: Ints | slice = slice(None)
    if m.centre:
        x, y, advance, source = with_chords(m.centre, m.kind == CLOCKWISE, x, y, advance)
    line, z, role, in_layer = m.line[source], z[source], m.role[source], m.layer[source]
    _within((x, y, z), line, path)
    step = np.flatnonzero((np.diff(x, prepend=0.0) != 0) | (np.diff(y, prepend=0.0) != 0))
    bead = (advance[step] > 0) & (role[step] != IGNORED) & ((in_layer[step] >= 0) | (layer_lines is None))
    _certain(m, np.arange(len(x)) if isinstance(source, slice) else source, step, bead, path)
    laid, goes_on = step[bead], np.concatenate([[False], bead[:-1]])[bead]
    if not len(laid):
        return None
    layer, lines = (in_layer[laid], layer_lines) if layer_lines is not None else _by_height(z[laid], line[laid])
    heights = _heights(z[laid], layer, len(lines), line[laid], path)
    piece = m.piece[source][laid]
    goes_on[1:] &= (piece[1:] == piece[:-1]) & (layer[1:] == layer[:-1])
    unsaid = np.isnan(m.width[source][laid])
    if unsaid.any():
        length = np.hypot(x[laid] - np.append(x, 0.0)[laid - 1], y[laid] - np.append(y, 0.0)[laid - 1])
        told = unsaid & (length >= _ROUNDED)
        goes_on &= ~_swellings(goes_on, np.where(told, advance[laid] / np.where(told, length, 1.0), np.nan))
    first = np.flatnonzero(~goes_on)
    end = np.arange(len(laid)) + np.cumsum(~goes_on)
    points = np.empty((len(laid) + len(first), 2))
    for i, places in enumerate((x, y)):
        points[end, i] = places[laid]
        points[end[first] - 1, i] = np.append(places, 0.0)[laid[first] - 1]  # before the first row: 0
    begun = laid[first]
    width = m.width[source][begun]
    fed = np.where(np.isnan(width), np.add.reduceat(advance[laid], first), 0.0)
    return Laid(points, np.append(end[first] - 1, len(points)), role[begun], layer[first], width, fed, heights, lines)


def _certain(m: Moves, source: Ints, step: Ints, bead: NDArray[np.bool_], path: Path) -> None:
    """Refuse beads that begin at a place which the file does not say, and those that not all printers would lay."""
    rows = np.arange(len(m.line))
    lost = np.zeros(len(rows), bool)  # after each row
    for axis in range(3):
        gone = np.where((m.kind >= AWAY) & (m.kind >> axis & 1 > 0), rows, -1)
        told = np.where(~np.isnan(m.given[:, axis]) & ~m.relative, rows, -1)
        lost |= np.maximum.accumulate(gone) > np.maximum.accumulate(told)
    begun = source[step[bead]]
    for i in begun[lost[begun - 1] & (begun > 0)][:1]:
        what = "a bead begins where homing, probing or parking left the head, which the file does not say"
        raise damaged(path, int(m.line[i]), what, "give X, Y and Z before it")
    e = m.given[:, 3]
    before = np.concatenate([[0.0], _filled(e, 0.0)[:-1]])
    wrong = np.isin(rows, source[step]) & m.unsure_e & (m.role != IGNORED) & ((e > 0) != (e > before))
    for i in np.flatnonzero(wrong)[:1]:
        what = "printers disagree whether G90 and G91 are about E, too"
        raise damaged(path, int(m.line[i]), what, "write M82 or M83 after each of them")


def _swellings(goes_on: NDArray[np.bool_], rate: Floats) -> NDArray[np.bool_]:
    """Return where a bead whose width is not said grows wider or thinner, by what each mm is fed: another one begins.

    Parameters
    ----------
    goes_on : (N,) bool
        Whether a step goes on with the bead of the one before.
    rate : (N,) float64
        Filament for one mm of each step; nan where it cannot be told, or the width is said.
    """
    new, begun = [], 0.0
    for on, now in zip(goes_on.tolist(), rate.tolist(), strict=True):
        begun = begun if on else 0.0
        swells = begun > 0 and abs(now / begun - 1) > _SWELLS  # False for nan
        new.append(swells)
        if now == now and (swells or not begun):
            begun = now
    return np.array(new, bool)


def _within(places: tuple[Floats, Floats, Floats], line: Ints, path: Path) -> None:
    """Refuse places that are too far out; a height may not be known yet."""
    if max(float(np.fmax.reduce(np.abs(p), initial=0.0)) for p in places) <= LIMIT_MM:
        return
    i = int(np.flatnonzero(np.any([np.abs(p) > LIMIT_MM for p in places], axis=0))[0])
    got = " ".join(f"{name}{p[i]:g}" for name, p in zip("XYZ", places, strict=True)).replace(" Znan", "")
    raise damaged(path, int(line[i]), f"a place must lie within {LIMIT_MM:g} mm, got {got}")


def _by_height(z: Floats, line: Ints) -> tuple[Ints, Ints]:
    """Return the layer of each step, where each height is a layer, and the lines where they begin."""
    new = np.concatenate([[True], z[1:] != z[:-1]])
    return np.cumsum(new) - 1, line[new]


def _heights(z: Floats, layer: Ints, layers: int, line: Ints, path: Path) -> Floats:
    """Return the height of each layer: that of its first step which has one; all others must have it, too."""
    heights = np.full(layers, np.nan)
    known = np.flatnonzero(~np.isnan(z))[::-1]
    heights[layer[known]] = z[known]  # the last that is written is the first of its layer
    wrong = np.flatnonzero(np.abs(z - heights[layer]) > 1e-6)
    if len(wrong):
        i = int(wrong[0])
        what = f"z changes from {heights[layer[i]]:g} to {z[i]:g} mm within a layer"
        raise damaged(path, int(line[i]), f"{what}, which is not built yet", "write the file without vase mode")
    return heights


def _track(given: Floats, relative: NDArray[np.bool_], start: float) -> Floats:
    """Return where each row leads: what is given, or the place before it, or both added."""
    said = ~np.isnan(given)
    gone = np.cumsum(np.where(said & relative, given, 0.0))
    return np.asarray(_filled(np.where(said & ~relative, given - gone, np.nan), start) + gone)


def _filled(values: Floats, start: float) -> Floats:
    """Return values with the one before in the place of each nan."""
    at = np.maximum.accumulate(np.where(np.isnan(values), -1, np.arange(len(values))))
    return np.where(at < 0, start, values[at])


def _advance(m: Moves) -> Floats:
    """Return how much filament each row feeds."""
    e = m.given[:, 3]
    before = np.concatenate([[0.0], _track(e, m.relative_e & (m.kind != SET), 0.0)[:-1]])
    fed = np.where(m.relative_e, e, e - before)
    return np.where(np.isnan(e) | (m.kind == SET), 0.0, fed)
