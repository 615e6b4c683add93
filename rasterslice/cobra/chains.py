"""Motions that V+ blends into one another: when the tip is where, and when valves really open and shut.

A *chain* is what lies between two BREAKs: from rest to rest at one speed. Times follow a trapezoid over its length;
at its corners the tip is on a parabola, which takes no time and cuts the corner by v^2 sin^2(turn / 2) / 2a.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Moves:
    """Some whole chains of MOVES, one after the other.

    Attributes
    ----------
    points : (K + 1, 3) float64
        Where the tip was before, and where each motion ends; part frame, mm.
    speed : (K,) float64
        mm/s.
    ends : (C,) int64
        The last motion of each chain.
    rest : (C,) float64
        How long the arm stands after each chain, s: settling and delays.
    start : float
        Time at which the first chain begins, s.
    """

    points: Array
    speed: Array
    ends: Index
    rest: Array
    start: float


@dataclass(frozen=True, slots=True)
class Timed:
    """When the motions of `Moves` happen.

    Attributes
    ----------
    moves : Moves
    chain : (K,) int64
        The chain of each motion.
    arc : (K + 1,) float64
        Way from the beginning of the first chain to the end of each motion, mm.
    peak, length, begin : (C,) float64
        Largest speed, length and beginning of each chain: mm/s, mm, s.
    half : (K,) float64
        Half the time of the blend where each motion begins, s; 0 at the beginning of a chain.
    bend : (K,) float64
        Turn there, radians.
    accel : float
    end : float
        Time at which the last rest ends, s.
    """

    moves: Moves
    chain: Index
    arc: Array
    peak: Array
    length: Array
    begin: Array
    half: Array
    bend: Array
    accel: float
    end: float

    def time_at(self, arc: Array, chain: Index) -> Array:
        """Return when the tip has gone some way along its chain, s."""
        s, peak, a = arc - self._base(chain), self.peak[chain], self.accel
        ramp, left = peak**2 / (2 * a), self.length[chain] - s
        total = self.length[chain] / np.maximum(peak, 1e-12) + peak / a
        rising = np.sqrt(2 * np.maximum(s, 0) / a)
        falling = total - np.sqrt(2 * np.maximum(left, 0) / a)
        even = s / np.maximum(peak, 1e-12) + peak / (2 * a)
        return np.asarray(self.begin[chain] + np.where(s < ramp, rising, np.where(left < ramp, falling, even)))

    def arc_at(self, time: Array, chain: Index) -> Array:
        """Return how far the tip has gone along its chain at some times, mm."""
        peak, a = self.peak[chain], self.accel
        total = self.length[chain] / np.maximum(peak, 1e-12) + peak / a
        t = np.clip(time - self.begin[chain], 0.0, total)
        up, left = peak / a, total - t
        even = peak * t - peak**2 / (2 * a)
        way = np.where(t < up, a * t * t / 2, np.where(left < up, self.length[chain] - a * left * left / 2, even))
        return np.asarray(self._base(chain) + way)

    def speed_at(self, arc: Array, chain: Index) -> Array:
        """Return the speed of the trapezoid at some ways along a chain, mm/s."""
        s = arc - self._base(chain)
        near = np.minimum(s, self.length[chain] - s)
        return np.asarray(np.minimum(self.peak[chain], np.sqrt(2 * self.accel * np.maximum(near, 0))))

    def place(self, arc: Array) -> Array:
        """Return positions (N, 3) along the straight motions."""
        k = np.clip(np.searchsorted(self.arc, arc, "right") - 1, 0, len(self.arc) - 2)
        step = self.arc[k + 1] - self.arc[k]
        share = np.where(step > 0, (arc - self.arc[k]) / np.where(step > 0, step, 1), 0.0)
        p = self.moves.points
        return np.asarray(p[k] + np.clip(share, 0, 1)[:, None] * (p[k + 1] - p[k]))

    def rounded(self) -> Array:
        """Return the points (K + 1, 3) where the parabolas pass them."""
        p = self.moves.points.copy()
        step = np.diff(self.moves.points, axis=0)
        way = step / np.maximum(np.linalg.norm(step, axis=1), 1e-12)[:, None]
        shift = (way[1:] - way[:-1]) * (self.moves.speed[1:] * self.half[1:] / 4)[:, None]
        p[1:-1] += shift
        return p

    def _base(self, chain: Index) -> Array:
        first = np.concatenate([[0], self.moves.ends[:-1] + 1])
        return np.asarray(self.arc[first[chain]])


def spans(begin: Index, end: Index) -> Index:
    """Return begin[0], ..., end[0] - 1, begin[1], ..., end[1] - 1, and so on."""
    size = end - begin
    first = np.concatenate([[0], np.cumsum(size)])
    return np.asarray(np.arange(first[-1]) + np.repeat(begin - first[:-1], size))


def time_moves(moves: Moves, accel: float, tick: float) -> Timed:
    """Work out when motions happen.

    Raises
    ------
    UsageError
        When the speed changes within a chain: the player never does that.
    """
    step = np.diff(moves.points, axis=0)
    length = np.sqrt((step * step).sum(axis=1))
    count = np.diff(np.concatenate([[-1], moves.ends]))
    chain = np.repeat(np.arange(len(moves.ends)), count)
    arc = np.concatenate([[0.0], np.cumsum(length)])
    first = moves.ends - count + 1
    whole = arc[moves.ends + 1] - arc[first]
    speed = moves.speed[moves.ends]
    if np.any(moves.speed != speed[chain]):
        raise UsageError("the program changes its speed without a BREAK; the simulator has no model of that")
    peak = np.minimum(speed, np.sqrt(whole * accel))
    lasts = whole / np.maximum(peak, 1e-12) + peak / accel + moves.rest
    lasts = np.ceil(lasts / tick - 1e-9) * tick
    begin = moves.start + np.concatenate([[0.0], np.cumsum(lasts)[:-1]])
    half, bend = np.zeros(len(step)), np.zeros(len(step))
    way = step / np.maximum(length, 1e-12)[:, None]
    dot = np.clip((way[1:] * way[:-1]).sum(axis=1), -1, 1)
    inside = (chain[1:] == chain[:-1]) & (length[1:] > 0) & (length[:-1] > 0)
    bend[1:] = np.where(inside, np.arccos(dot), 0.0)
    half[1:] = np.sin(bend[1:] / 2) * moves.speed[1:] / accel
    return Timed(moves, chain, arc, peak, whole, begin, half, bend, accel, float(moves.start + lasts.sum()))
