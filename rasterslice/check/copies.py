"""Several copies of a part in one file: where they stand, seen from above, and what belongs to which."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .align import TURNS
from .form import Floats, TheirLayer, Theirs
from .frame import box, pick, returning, walls
from .outlines import string
from .picture import Canvas, Mask, canvas
from .reference import Reference
from .shares import share_of
from .unit import factors, scaled

_SLACK = 1.05, 0.5  # of the part's size, and mm: what is no larger is one copy
_SMALL = 0.5  # of the part's size: what is no larger is not a whole one
_FINE = 120  # pixels along the longer side of the part
_COARSE = 15  # with fewer nothing is told
_ALIKE = 0.7  # of the part's outline seen from above that a copy must cover
_BESIDE = 0.5  # of a rim around it that may be covered
_RIM = 3  # pixels
_FOREIGN = 0.1  # of the part's outline: what is smaller belongs to the nearest copy
_MOST = 1000  # copies


@dataclass(frozen=True, slots=True)
class Plate:
    """What a file holds, seen from above.

    Attributes
    ----------
    copies : list of Theirs
        The file, cut up; empty when it was not seen to be several copies.
    foreign : list of tuple of float
        Boxes of what is no copy, x0, y0, x1, y1, mm in the file.
    larger : bool
        Whether the file spans more than one part.
    size : tuple of float
        What the file spans, mm.
    """

    copies: list[Theirs]
    foreign: list[tuple[float, ...]]
    larger: bool
    size: tuple[float, float]


def split(side: Reference, theirs: Theirs) -> Plate:
    """Find copies of the part in a file, and cut it up; one copy by itself is left as it is."""
    layers = [theirs.layers[i] for i in pick(theirs.layers)]
    boxes = np.array([box(k, 0.0) for k in layers])
    span = boxes[:, 2:].max(axis=0) - boxes[:, :2].min(axis=0)
    part = (side.high - side.low)[:2]
    larger = bool(np.any(np.sort(span) > _SLACK[0] * np.sort(part) + _SLACK[1]))
    size = (float(span[0]), float(span[1]))
    smaller = bool(np.all(np.sort(span) < _SMALL * np.sort(part)))  # in another unit they may be copies
    if not (larger or smaller) or theirs.unsized:
        return Plate([], [], larger, size)
    slices = _slices(side)
    first: Plate | None = None
    for factor in (1.0, *factors()):
        if np.any(factor * span > part) and np.all(factor * span < 2 * np.sqrt(_MOST) * part.max()):
            found = _explained(layers, slices, part, factor)
            if found is not None:
                ids, sheet, count, foreign = found
                if count == 1 and not foreign:
                    break
                if smaller and (count == 1 or foreign):
                    continue
                copies = [share_of(theirs, ids, sheet, k) for k in range(1, count + 1)]
                copies = copies if factor == 1.0 else [scaled(side, one, factor) for one in copies]
                plate = Plate(copies, foreign, True, size)
                if not foreign:
                    return plate
                first = first or plate  # what another unit explains as a whole is no foreign thing
    return first or Plate([], [], larger, size)


def _slices(side: Reference) -> list[list[Floats]]:
    """Return loops of some of our slices."""
    some = np.unique(np.linspace(0, len(side.heights) - 1, 40).astype(int))
    found: list[list[Floats]] = []
    for boundary in side.boundaries(side.heights[some]):
        strung = string(*boundary.pieces())
        loops = np.split(side.grid.to_mm(strung.pieces[:, :2]), strung.starts[1:-1])
        edges = np.searchsorted(strung.layer, np.arange(boundary.last - boundary.first + 1)).tolist()
        found += [loops[a:b] for a, b in itertools.pairwise(edges)]
    return found


def _explained(
    layers: list[TheirLayer], slices: list[list[Floats]], part: Floats, factor: float
) -> tuple[NDArray[np.int32], Canvas, int, list[tuple[float, ...]]] | None:
    """Return which copy each place belongs to, the picture of it, the number of copies, and what is none."""
    most = float(_SLACK[0] * part.max() + _SLACK[1]) / factor
    points = [p for k in layers for p in (*k.loops, *([k.beads.points] if k.beads is not None else [])) if len(p)]
    sheet = canvas(points, float(part.max()) / factor / _FINE, 8 * float(part.max()) / factor / _FINE)
    if part.max() / factor / sheet.pixel < _COARSE:
        return None
    theirs = np.zeros(sheet.size, np.uint8)
    for k in layers:
        theirs |= _drawn(sheet, k, most)
    best: tuple[NDArray[np.int32], int, list[tuple[float, ...]]] | None = None
    for turn in TURNS.values():
        turned = [[p @ np.linalg.inv(np.array(turn, float)).T / factor for p in loops] for loops in slices]
        ids, count, rest = _placed(theirs, _outline(turned, sheet.pixel), sheet)
        if count and (best is None or (count, -len(rest)) > (best[1], -len(best[2]))):
            best = ids, count, rest
        if count and not rest:
            break
    return (best[0], sheet, best[1], best[2]) if best else None


def _drawn(sheet: Canvas, layer: TheirLayer, most: float) -> Mask:
    """Draw a layer seen from above; what is larger than the part, as a skirt is, tells nothing."""
    image = sheet.filled([p for p in layer.loops if np.ptp(p, axis=0).max() <= most])
    beads, chosen = layer.beads, walls(layer.beads)
    if beads is not None and chosen is not None:
        lines = [beads.points[a:b] for a, b in zip(beads.offsets[:-1], beads.offsets[1:], strict=True)]
        small = np.array([float(np.ptp(p, axis=0).max()) <= most for p in lines])
        rings = np.flatnonzero(chosen & small & returning(beads, 4 * sheet.pixel))
        image |= sheet.wound([lines[i] for i in rings.tolist()])
        image |= sheet.strokes([lines[i] for i in np.flatnonzero(chosen & small).tolist()], np.full(
            int((chosen & small).sum()), 2 * sheet.pixel))  # fmt: skip
    return image


def _outline(slices: Sequence[Sequence[Floats]], pixel: float) -> Mask:
    """Draw our slices, one over the other, as small as they are."""
    sheet = canvas([p for loops in slices for p in loops], pixel, pixel)
    sheet = replace(sheet, pixel=pixel)
    image = np.zeros(sheet.size, np.uint8)
    for loops in slices:
        image |= sheet.filled(loops)
    return image


def _placed(theirs: Mask, part: Mask, sheet: Canvas) -> tuple[NDArray[np.int32], int, list[tuple[float, ...]]]:
    """Lay the outline of the part where it fits, again and again; return whose each pixel is, how many, the rest."""
    import cv2

    ids, (h, w) = np.zeros(theirs.shape, np.int32), part.shape
    if theirs.shape[0] < h or theirs.shape[1] < w:
        return ids, 0, []
    free, area, framed = theirs.astype(np.float32), float(part.sum()), np.pad(theirs, _RIM)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _RIM + 1, 2 * _RIM + 1))
    wide = np.asarray(cv2.dilate(np.pad(part, _RIM), disc)) > 0
    rim = wide & (np.asarray(cv2.dilate(np.pad(part, _RIM), np.ones((3, 3), np.uint8))) == 0)
    places: list[tuple[int, int]] = []
    while len(places) < _MOST:
        fit = np.asarray(cv2.matchTemplate(free, part.astype(np.float32), cv2.TM_CCORR), np.float32)
        y, x = divmod(int(fit.argmax()), fit.shape[1])
        around = framed[y : y + h + 2 * _RIM, x : x + w + 2 * _RIM] > 0
        if fit[y, x] < _ALIKE * area or np.count_nonzero(around & rim) > _BESIDE * np.count_nonzero(rim):
            break
        places.append((x, y))
        cleared = np.pad(free, _RIM)
        cleared[y : y + h + 2 * _RIM, x : x + w + 2 * _RIM][wide] = 0
        free = cleared[_RIM:-_RIM, _RIM:-_RIM]
    for k, (x, y) in enumerate(places, 1):
        ids[y : y + h, x : x + w][part > 0] = k
    foreign = _rest(ids, free, sheet, _FOREIGN * area) if places else []
    return _nearest(ids), len(places), foreign


def _rest(ids: NDArray[np.int32], free: NDArray[np.float32], sheet: Canvas, least: float) -> list[tuple[float, ...]]:
    """Give numbers to what is left of a picture after the copies; return the box of each piece."""
    import cv2

    found: list[tuple[float, ...]] = []
    first = int(ids.max()) + 1
    _, label, stats, _ = cv2.connectedComponentsWithStats((free > 0).astype(np.uint8), connectivity=8)
    for i, (x, y, wide, high, size) in enumerate(stats[1:].tolist(), 1):
        if size > least:
            ids[label == i] = first + len(found)
            low, high_ = (sheet.low + sheet.pixel * np.array(at) for at in ((x, y), (x + wide, y + high)))
            found.append((*low.tolist(), *high_.tolist()))
    return found


def _nearest(ids: NDArray[np.int32]) -> NDArray[np.int32]:
    """Give every pixel the number of the nearest one that has a number."""
    import cv2

    if not ids.any():
        return ids
    free = (ids == 0).astype(np.uint8)
    _, label = cv2.distanceTransformWithLabels(free, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    number = np.zeros(int(label.max()) + 1, np.int32)
    number[label[free == 0]] = ids[free == 0]
    return np.asarray(number[label])
