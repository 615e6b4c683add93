"""What pixels explain when two runs of ours are held against each other, or what was traced from an image to the mesh.

A pixel has the right sign or share, and a contour between two pixels is right where the part is as wide as some pixels.
What no pixel lies in, or covers none by half, is lost, and where walls meet within a pixel or two the contour is bent.
So a difference counts where a disc that must hold a pixel of either fits into it, or where both boundaries run straight
beside each other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .findings import Limits
from .form import Floats
from .loops import Ints
from .ours import Samples, Slices

DISC = 0.75  # coarser pixels: the radius of a disc that must hold one is 0.71
#: Pixels: the radius of a disc of which a pixel is half covered, also where shares were made of regions that lost some.
COVERED = 1.0
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
    found, disc = np.zeros(len(off), bool), limits.thin or limits.lost
    far = np.flatnonzero(np.abs(off) > limits.tolerance)
    points, layer, normal = samples.points[far], samples.layer[far], samples.normal[far]
    away = np.where(off[far] > 0, -1.0, 1.0)[:, None] * normal  # into what only one of them has
    sure = _runs_straight(held, points, layer, normal, limits) & _runs_straight(other, points, layer, normal, limits)
    for depth in _DEPTHS:
        ask = np.flatnonzero(~sure)
        at = points[ask] + depth * disc * away[ask]
        a, b = held.distance(at, layer[ask]), other.distance(at, layer[ask])
        sure[ask] = (a * b < 0) & (np.minimum(np.abs(a), np.abs(b)) > disc)
    found[far] = ~sure
    return found


def knotted(held: Slices, places: Floats, layer: Ints, limits: Limits) -> NDArray[np.bool_]:
    """Return where pixels may have tied a knot: in tongues and clefts of ours that are too thin for a disc.

    Parameters
    ----------
    held : Boundary
    places : (N, 2) float64
        Where contours of the other cross, mm.
    layer : (N,) int64
    limits : Limits
    """
    if limits.thin or not (limits.lost and len(places)):
        return np.full(len(places), limits.thin > 0)
    turn = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1) * (STRAIGHT * limits.lost / COVERED)
    beside = np.concatenate([share * ring for share in (0.25, 0.5, 0.75, 1.0)])
    depth = held.distance((places[:, None] + beside).reshape(-1, 2), np.repeat(layer, len(beside)))
    depth = depth.reshape(len(places), -1)
    return np.asarray((depth.min(axis=1) > -limits.lost) | (depth.max(axis=1) < limits.lost))


def _runs_straight(held: Slices, points: Floats, layer: Ints, normal: Floats, limits: Limits) -> NDArray[np.bool_]:
    """Whether the distance from a boundary grows as the way does, along the normal through points beside it."""
    way = STRAIGHT * (limits.thin / DISC or limits.lost / COVERED)
    here = held.distance(points, layer)
    there = [held.distance(points + sign * way * normal, layer) - here for sign in (-1.0, 1.0)]
    return np.asarray((np.abs(there[0] + way) < _BEND * way) & (np.abs(there[1] - way) < _BEND * way))
