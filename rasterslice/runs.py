"""Deposition paths -> runs that one motion at constant speed can lay, and from ordered runs to motions.

A *run* is an open polyline that is wet from end to end. Closed paths without a corner stay whole, as *loops*, whose
start is chosen later; the others are split at their corners.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .errors import UsageError
from .paths import CLOSE, MOVE, OPEN, TRAVEL, Paths
from .profile import Nozzle, Profile
from .thin import neighbours

Points = NDArray[np.float64]


def split(paths: Paths, smooth: float, longest: int) -> tuple[Paths, Paths, NDArray[np.int64], NDArray[np.int64]]:
    """Split closed paths at their corners.

    Parameters
    ----------
    paths : Paths
        Closed.
    smooth : float
        Largest turn that is no corner, radians.
    longest : int
        Points that a run may have; longer ones are split evenly.

    Returns
    -------
    loops : Paths
        Closed, without corners.
    pieces : Paths
        Open, both ends included.
    loop_owner, piece_owner : (.,) int64
        Which path each came from.
    """
    count = np.diff(paths.offsets).astype(np.int64)
    owner = np.repeat(np.arange(len(paths)), count)
    mark = turns(paths.points, owner) > smooth
    many = np.flatnonzero(count > longest)
    for path in many.tolist():
        parts = -(-int(count[path]) // (longest - 1)) + 1
        mark[int(paths.offsets[path]) + np.linspace(0, count[path], parts, endpoint=False).astype(np.int64)] = True
    marks = np.bincount(owner[mark], minlength=len(paths))
    loop = np.flatnonzero((marks == 0) & (count > 0))
    at = np.flatnonzero(mark)
    base, size = paths.offsets[owner[at]].astype(np.int64), count[owner[at]]
    _, following = neighbours(owner[at], True)
    length = (at[following] - at - 1) % np.maximum(size, 1) + 2 if len(at) else np.empty(0, np.int64)
    ends = np.concatenate([[0], np.cumsum(length)])
    t = np.arange(ends[-1]) - np.repeat(ends[:-1], length)
    index = np.repeat(base, length) + (np.repeat(at - base, length) + t) % np.repeat(size, length)
    pieces = Paths(paths.points[index], ends.astype(np.uint32), False)
    return pick(paths, loop), pieces, loop, owner[at]


def turns(points: Points, owner: NDArray[np.int64]) -> Points:
    """Return by how much closed paths turn at each point, radians, 0 to pi."""
    before, after = neighbours(owner, True)
    a, b = points - points[before], points[after] - points
    cross, dot = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1)
    return np.asarray(np.abs(np.arctan2(cross, dot)))


def pick(paths: Paths, which: NDArray[np.int64]) -> Paths:
    """Return some of the paths."""
    size = np.diff(paths.offsets).astype(np.int64)[which]
    ends = np.concatenate([[0], np.cumsum(size)])
    first = paths.offsets[:-1].astype(np.int64)[which]
    index = np.repeat(first - ends[:-1], size) + np.arange(ends[-1])
    return Paths(paths.points[index], ends.astype(np.uint32), paths.closed)


def unit(a: Points) -> Points:
    """Return vectors (., 2) at length 1."""
    return np.asarray(a / np.maximum(np.hypot(a[:, 0], a[:, 1]), 1e-300)[:, None])


@dataclass(frozen=True, slots=True)
class Leads:
    """Lengths of a run's dry ends, mm: before the wet start, after the wet end, and from the signals to the drops."""

    before: float
    after: float
    open_distance: float
    close_distance: float
    spacing: float


def motions(
    points: Points, offsets: NDArray[np.int64], leads: Leads
) -> tuple[Points, NDArray[np.uint8], NDArray[np.int64]]:
    """Give ordered runs their leads and their valve signals.

    The signal to shut belongs `close_distance` before the wet end. Where that is too near to the point before it, the
    wet end moves along its own tangent, by half a spacing at most: a run never bends for a signal.

    Parameters
    ----------
    points, offsets
        Wet polylines, open, of at least two points each, in order and direction of laying; no segment is shorter than
        the spacing, which is no shorter than `close_distance`.
    leads : Leads

    Returns
    -------
    points : (N, 2) float64
    ops : (N,) uint8
    offsets : (P + 1,) int64
        As in `Toolpath`.
    """
    first, last = offsets[:-1], offsets[1:] - 1
    owner = np.repeat(np.arange(len(first)), np.diff(offsets))
    start, end = unit(points[first + 1] - points[first]), unit(points[last] - points[last - 1])
    gap = points[last] - points[last - 1]
    room = np.hypot(gap[:, 0], gap[:, 1]) - leads.close_distance
    tight = (room < leads.spacing * (1 - 1e-9)) & (last - first > 1)
    snapped = tight & (room <= leads.spacing / 2)  # shut at the last corner but one, else a spacing after it
    room = np.where(snapped, 0.0, np.where(tight, leads.spacing, room))
    shut = points[last - 1] + end * room[:, None]

    inner = np.ones(len(points), bool)
    inner[first] = inner[last] = False
    inner[last[snapped] - 1] = False
    size = np.add.reduceat(inner, first) + 4
    made = np.concatenate([[0], np.cumsum(size)])
    out = np.empty((made[-1], 2))
    ops = np.full(made[-1], MOVE, np.uint8)
    head, tail = made[:-1], made[1:] - 1
    picked = np.flatnonzero(inner)
    before = np.concatenate([[0], np.cumsum(size - 4)])[:-1]
    out[head[owner[picked]] + 2 + np.arange(len(picked)) - before[owner[picked]]] = points[picked]
    out[head] = points[first] - start * leads.before
    out[head + 1] = points[first] - start * leads.open_distance
    out[tail - 1] = shut
    out[tail] = shut + end * (leads.close_distance + leads.after)
    ops[head], ops[head + 2], ops[tail] = TRAVEL, OPEN, CLOSE
    return out, ops, made


def leads_of(nozzle: Nozzle, profile: Profile) -> Leads:
    """Return the leads of a nozzle: long enough to accelerate and settle, no motion below the spacing, mm."""
    spacing = profile.spacing(nozzle.speed)
    lead = max(profile.lead(nozzle.speed), spacing)
    opened, shut = nozzle.speed * nozzle.open_delay, nozzle.speed * nozzle.close_delay
    return Leads(lead + opened, lead, opened, shut, spacing)


def overlap_of(leads: Leads, profile: Profile) -> float:
    """Return by how much a loop overlaps its start: no point may come too near to the signal to shut, mm."""
    wanted = profile.path.overlap
    if wanted <= leads.close_distance:
        return leads.close_distance
    return max(wanted, leads.close_distance + leads.spacing)


def check_delays(name: str, nozzle: Nozzle, profile: Profile) -> None:
    """Refuse a delay to shut that is longer than the shortest motion: the signal must lie on the last one."""
    shortest = profile.spacing(nozzle.speed)
    if nozzle.close_delay * nozzle.speed > shortest * (1 + 1e-9):
        raise UsageError(
            f"machine profile: nozzle.{name}.close_delay {nozzle.close_delay:g} s is longer than the shortest motion, "
            f"{shortest / nozzle.speed:.4g} s; raise path.segment_time to {nozzle.close_delay:g}"
        )
