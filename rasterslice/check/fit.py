"""How well outlines at some heights fit theirs, and by how much all heights are to be raised."""

from __future__ import annotations

import numpy as np

from .form import Floats
from .frame import sizes
from .reference import Side

_FAR = 5.0  # mm: a layer that misses by more, or where we have none, counts as this
_LIKE = 0.3  # a shift of all heights is believed when it leaves no more of the misfit, or of that of most layers
_MOST = 0.65  # of the layers that tell anything must fit better then: walls of some may be laid otherwise
_TELLS = 0.01  # mm: a layer that fits better or worse by less tells nothing
_WITHIN = 0.6  # of the layers must lie within the part
_PROFILE = 4000  # heights at which the part is cut for the first, coarse search
_SAME = 0.003  # mm: shifts that fit as well do not differ
_STEP = 0.01  # mm: shifts are found as multiples of this, unless the layers then lie at our heights


class Fit:
    """Outlines of ours that are held against boxes and areas of some of their layers.

    Parameters
    ----------
    ref : Reference or Run
    boxes, areas : (P, 4), (P,) float64
        Of their layers, in mm; an area of 0 is not known.
    """

    def __init__(self, ref: Side, boxes: Floats, areas: Floats) -> None:
        self.ref, self._boxes, self._areas = ref, boxes, areas

    def off(self, guesses: list[Floats]) -> list[Floats]:
        """Return by how much the boundary of each layer misses, on its average, mm; all guesses are cut together."""
        cut = np.concatenate(guesses)
        order = np.argsort(cut, kind="stable")
        area, box = np.empty(len(cut)), np.empty((len(cut), 4))
        area[order], box[order] = self.ref.outline(cut[order])
        return [self._off(a, b) for a, b in zip(np.split(area, len(guesses)), np.split(box, len(guesses)), strict=True)]

    def _off(self, area: Floats, box: Floats) -> Floats:
        off = np.sort(np.abs(sizes(box) - sizes(self._boxes)), axis=1).max(axis=1)
        if self._areas.any():
            lost = np.isnan(box[:, 0])
            off = np.where(lost, np.nan, np.abs(area - self._areas) / np.sqrt(area + self._areas + 1e-9))
        return np.asarray(np.minimum(np.nan_to_num(off, nan=_FAR), _FAR))

    def misfit(self, guesses: list[Floats]) -> list[float]:
        """Return how far outlines at some heights miss theirs, as a mean, mm; the few worst do not count."""
        return [_mean(off) for off in self.off(guesses)]

    def shift(self, middle: Floats, thickness: float) -> float:
        """Return by how much to raise all heights so that most layers fit far better; 0 when nothing does so.

        The whole height of the part is searched, in a profile that is cut once; the likeliest places are then searched
        finely. What is found lies in between, never at the end of what was searched.
        """
        places = [self._fine(middle, d, step) for d, step in self._coarse(middle, thickness)]
        found = [(_score(self.off([middle + d])[0]), d) for d in places]
        if not found:
            return 0.0
        left, best = min(found)
        best = self._snapped(middle, thickness, best, left)
        before, after = self.off([middle, middle + best])
        telling = np.abs(before - after) > _TELLS
        better = telling.any() and float(np.mean((after < before)[telling])) >= _MOST
        mended = any(kind(after) < _LIKE * kind(before) for kind in (_mean, np.median))
        return best if better and mended else 0.0

    def _coarse(self, middle: Floats, thickness: float) -> list[tuple[float, float]]:
        """Return the three likeliest shifts, and by how much each may be off."""
        low, high = float(self.ref.low[2]), float(self.ref.high[2])
        step = max(thickness / 4, (high - low) / _PROFILE)
        heights = np.arange(low + step / 2, high, step)
        area, box = self.ref.outline(heights)
        reach = max(high - float(middle.min()), float(middle.max()) - low)
        tried = step * np.arange(-np.ceil(reach / step), np.ceil(reach / step) + 1)
        scores = np.full(len(tried), np.inf)
        for i, d in enumerate(tried.tolist()):
            inside = (middle + d > low) & (middle + d < high)
            if inside.mean() >= _WITHIN:
                near = np.round((middle + d - heights[0]) / step).astype(int).clip(0, len(heights) - 1)
                off = np.where(inside, self._off(area[near], box[near]), _FAR)
                scores[i] = _score(off)
        before, after = np.append(np.inf, scores[:-1]), np.append(scores[1:], np.inf)
        lowest = np.flatnonzero((scores <= before) & (scores <= after) & np.isfinite(scores))
        lowest = lowest[np.argsort(scores[lowest], kind="stable")][:3]
        return [(float(tried[i]), step) for i in lowest]

    def _fine(self, middle: Floats, best: float, step: float) -> float:
        while step > _STEP / 5:
            tried = best + step * np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
            best = float(tried[np.argmin([_score(off) for off in self.off([middle + d for d in tried])])])
            step /= 2
        return best

    def _snapped(self, middle: Floats, thickness: float, best: float, left: float) -> float:
        """Return the shift by which layers lie at our heights, when they fit as well there, else a round number."""
        ours = self.ref.heights
        off = ours[:, None] - (middle + best)[None, :]
        nearest = off[np.abs(off).argmin(axis=0), np.arange(len(middle))]
        landed = best + float(np.median(nearest))
        close = _score(self.off([middle + landed])[0]) < 1.5 * left + _SAME
        if close and abs(landed - best) < max(2 * _STEP, thickness / 20):
            return round(landed, 6)
        return round(round(best / _STEP) * _STEP, 6)


def _mean(off: Floats) -> float:
    return float(np.mean(np.sort(off)[: max(1, round(0.9 * len(off)))]))


def _score(off: Floats) -> float:
    """Return what a shift is searched by: few layers may tell it, and many may be laid otherwise for other reasons."""
    return _mean(off) + float(np.median(off))
