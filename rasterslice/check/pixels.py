"""What pixels explain when two runs of ours are held against each other.

A pixel has the right sign, and a contour between two pixels is right where the part is as wide as some pixels. What
no pixel lies in is lost, and where walls meet within a pixel or two the contour is bent. So a difference of two runs
counts where a disc that must hold a pixel of either fits into it, or where both boundaries run straight beside each
other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .findings import Limits
from .form import Floats
from .loops import Ints
from .ours import Samples, Slices

DISC = 0.75  # coarser pixels: the radius of a disc that must hold one is 0.71
STRAIGHT = 2.0  # coarser pixels along the normal, to either side
_BEND = 0.1  # how far off a distance may be there, relative
_DEPTHS = (1.05, 1.5, 2.2, 3.3, 5.0)  # where the middles of discs are looked for, radii


def unproven(held: Slices, other: Slices, samples: Samples, off: Floats, limits: Limits) -> NDArray[np.bool_]:
    """Return which samples of one boundary differ from the other by no more than pixels explain.

    Parameters
    ----------
    held, other : Boundary
        Whose samples they are, and what they are held against.
    samples : Samples
    off : (N,) float64
        Signed distance of the samples from the other, mm.
    limits : Limits
    """
    found = np.zeros(len(off), bool)
    far = np.flatnonzero(np.abs(off) > limits.tolerance)
    points, layer, normal = samples.points[far], samples.layer[far], samples.normal[far]
    away = np.where(off[far] > 0, -1.0, 1.0)[:, None] * normal  # into what only one of them has
    sure = _runs_straight(held, points, layer, normal, limits) & _runs_straight(other, points, layer, normal, limits)
    for depth in _DEPTHS:
        ask = np.flatnonzero(~sure)
        at = points[ask] + depth * limits.thin * away[ask]
        a, b = held.distance(at, layer[ask]), other.distance(at, layer[ask])
        sure[ask] = (a * b < 0) & (np.minimum(np.abs(a), np.abs(b)) > limits.thin)
    found[far] = ~sure
    return found


def _runs_straight(held: Slices, points: Floats, layer: Ints, normal: Floats, limits: Limits) -> NDArray[np.bool_]:
    """Whether the distance from a boundary grows as the way does, along the normal through points beside it."""
    way = STRAIGHT * limits.pitch
    here = held.distance(points, layer)
    there = [held.distance(points + sign * way * normal, layer) - here for sign in (-1.0, 1.0)]
    return np.asarray((np.abs(there[0] + way) < _BEND * way) & (np.abs(there[1] - way) < _BEND * way))
