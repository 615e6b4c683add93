"""Arcs of G-code -> chords."""

from __future__ import annotations

import math

import numpy as np

from .form import Flags, Floats
from .loops import Ints

_SAGITTA, _MOST_STEPS = 0.005, 4096  # mm that an arc may be cut; steps of one arc


def with_chords(
    centre: dict[int, tuple[float, float]], clockwise: Flags, x: Floats, y: Floats, advance: Floats
) -> tuple[Floats, Floats, Floats, Ints]:
    """Return places and advances with chords for every arc, and the row that each belongs to.

    Parameters
    ----------
    centre : dict
        I and J of the rows that are arcs.
    clockwise : (N,) bool
        Of all rows.
    x, y, advance : (N,) float64
        Where each row leads, mm, and the filament that it feeds.
    """
    parts, feeds, sources, done = [], [], [], 0
    places = np.column_stack([x, y])
    for row in sorted(centre):
        start = places[row - 1] if row else np.zeros(2)
        chords = _chords(start, places[row], np.array(centre[row]), bool(clockwise[row]))
        parts += [places[done:row], chords]
        feeds += [advance[done:row], np.full(len(chords), advance[row] / len(chords))]
        sources += [np.arange(done, row), np.full(len(chords), row)]
        done = row + 1
    places = np.concatenate([*parts, places[done:]])
    source = np.concatenate([*sources, np.arange(done, len(x))])
    return places[:, 0], places[:, 1], np.concatenate([*feeds, advance[done:]]), source


def _chords(start: Floats, end: Floats, offset: Floats, clockwise: bool) -> Floats:
    """Return the ends of the chords of an arc about a centre; a whole turn where it ends where it starts."""
    centre, radius = start + offset, float(np.hypot(*offset))
    first, last = (math.atan2(*(p - centre)[::-1]) for p in (start, end))
    sweep = (last - first) % (2 * math.pi) or 2 * math.pi
    if clockwise:
        sweep = sweep - 2 * math.pi if sweep < 2 * math.pi else -sweep
    step = 2 * math.acos(max(0.0, 1 - _SAGITTA / radius)) if radius > _SAGITTA else math.pi
    count = min(_MOST_STEPS, max(1, math.ceil(abs(sweep) / step)))
    turn = first + sweep * np.arange(1, count + 1) / count
    points = centre + radius * np.column_stack([np.cos(turn), np.sin(turn)])
    points[-1] = end
    return points
