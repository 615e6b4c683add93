"""Which boxes lie within others: a grid for each size of box, so that many thousands are not all compared.

Based on: the hierarchical grid of M. Teschner et al., Optimized spatial hashing for collision detection of deformable
objects (2003), and of C. Ericson, Real-Time Collision Detection (2005), ch. 7.
Differs in: boxes of each size class are sorted by the hash of their cells, and all questions are asked at once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .weld import hashed

Points = NDArray[np.float64]

_MOST_TESTS = 300_000_000  # of pairs of boxes, about 20 s; only boxes heaped on each other by thousands need as many


def within_any(low: Points, high: Points, outer_low: Points, outer_high: Points) -> NDArray[np.bool_]:
    """Return which boxes lie within at least one of some other boxes.

    Parameters
    ----------
    low, high : (N, 3) float64
        Corners of the boxes.
    outer_low, outer_high : (M, 3) float64
        Corners of the others.

    Returns
    -------
    (N,) bool
        True also where it was not found out: where some 10^4 boxes of one size overlap each other, and as many are
        asked about, the search is given up.
    """
    found = np.zeros(len(low), bool)
    extent = outer_high - outer_low
    size = np.frexp(extent.max(axis=1, initial=0.0))[1]  # a box is not larger than a cell of 2^size
    order = np.argsort(-extent.prod(axis=1), kind="stable")  # large ones first: they hold the most
    tests = _MOST_TESTS
    for level in np.unique(size)[::-1]:
        which = order[size[order] == level]
        keys, member = _entries(outer_low[which], outer_high[which], level)
        ask = np.flatnonzero(~found)
        wanted = _key(_cells(low[ask], level))
        at, stop = np.searchsorted(keys, wanted, "left"), np.searchsorted(keys, wanted, "right")
        while len(ask := ask[some := at < stop]):
            at, stop = at[some], stop[some]
            outer = which[member[at]]
            inside = ((outer_low[outer] <= low[ask]) & (outer_high[outer] >= high[ask])).all(axis=1)
            found[ask[inside]] = True
            tests -= len(ask)
            if tests < 0:
                found[ask] = True
                break
            ask, at, stop = ask[~inside], at[~inside] + 1, stop[~inside]
    return found


def _entries(low: Points, high: Points, level: int) -> tuple[NDArray[np.uint64], NDArray[np.int64]]:
    """Return the sorted keys of the cells that boxes touch, at most eight each, and the box of each."""
    first, last = _cells(low, level), _cells(high, level)
    keys = np.stack([_key(np.where(side, last, first)) for side in np.ndindex(2, 2, 2)])
    member = np.broadcast_to(np.arange(len(low)), keys.shape)
    order = np.argsort(keys.ravel("F"), kind="stable")  # of one cell in the order of the boxes
    return keys.ravel("F")[order], member.ravel("F")[order]


def _cells(points: Points, level: int) -> Points:
    return np.floor(np.ldexp(points, -level)) + 0.0  # -0 becomes 0


def _key(cells: Points) -> NDArray[np.uint64]:
    return hashed(np.ascontiguousarray(cells).view(np.int64))
