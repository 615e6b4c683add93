"""What timed motions mean: where beads lie, how fast the wet tip is, how far the joints turn, and what must not be."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..paths import Paths
from ..profile import Nozzle, Profile
from ..runs import pick
from . import kinematics as kin
from .chains import Array, Timed


@dataclass(frozen=True, slots=True)
class Deposit:
    """Wet polylines of one material at one height, in order.

    Attributes
    ----------
    tool : int
        0 ice, 1 scaffold.
    z : float
        Height of the tip, mm.
    commanded, laid : Paths
        Open: where the signals belong, and where ticks, delays and rounded corners put the bead.
    """

    tool: int
    z: float
    commanded: Paths
    laid: Paths


@dataclass(slots=True)
class Result:
    """What a simulation found; lengths mm, times s, angles degrees. `faults` is empty when all is well."""

    seconds: float = 0.0
    wet: list[float] = field(default_factory=lambda: [0.0, 0.0])
    lead: float = 0.0
    travel: float = 0.0
    paths: int = 0
    points: int = 0
    changes: int = 0
    holds: int = 0
    brakes: int = 0
    valve_error: float = 0.0
    slowest: float = 1.0
    fastest: float = 1.0
    rounding: float = 0.0
    joints: dict[str, list[float]] = field(default_factory=dict)
    joint_speeds: dict[str, float] = field(default_factory=dict)
    messages: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)

    def fault(self, text: str) -> None:
        """Note something that must not be; the first twenty are kept."""
        if len(self.faults) < 20:
            self.faults.append(text)


def beads_of(
    t: Timed, pairs: NDArray[np.int64], tool: int, p: Profile, r: Result
) -> tuple[list[Deposit], Array]:
    """Find where the beads lie.

    Parameters
    ----------
    t : Timed
    pairs : (R, 3) int64
        Motion that opens a valve, motion that shuts it, nozzle.
    tool : int
        The nozzle in use.
    p : Profile
    r : Result
        Lengths, errors and faults are added.

    Returns
    -------
    deposits : list of Deposit
    wet : (R, 2) float64
        When each valve was open, s.
    """
    length = np.diff(t.arc)
    if not len(pairs):
        r.travel += float(length.sum())
        return [], np.empty((0, 2))
    up, down, chain = pairs[:, 0], pairs[:, 1], t.chain[pairs[:, 0]]
    if np.any(t.chain[down] != chain):
        r.fault("a valve is open while the arm travels")
    if np.any(pairs[:, 2] != tool):
        r.fault("the valve of the other nozzle opens")
    (due0, real0, wet0), (due1, real1, wet1) = _edges(t, up, down, p.nozzles[int(pairs[0, 2])], p, r)
    _speeds(t, up, down, p, r)
    straight = t.moves.points[:, :2]
    commanded = _cut(t, straight, due0, due1)
    laid = _cut(t, t.rounded()[:, :2], real0, real1)
    r.wet[tool] += float((real1 - real0).sum())
    runs = np.zeros(len(t.length), bool)
    runs[chain] = True
    r.lead += float(t.length[runs].sum() - (real1 - real0).sum())
    r.travel += float(length.sum() - t.length[runs].sum())
    r.paths += len(pairs)
    r.points += int(runs[t.chain].sum()) + len(pairs)
    return _grouped(t.moves.points[up, 2], tool, commanded, laid), np.stack([wet0, wet1], axis=1)


def _edges(
    t: Timed, up: NDArray[np.int64], down: NDArray[np.int64], nozzle: Nozzle, p: Profile, r: Result
) -> list[tuple[Array, Array, Array]]:
    """Return, for opening and shutting: where the wet ends belong and are, as ways along the motions, and when."""
    chain, speed = t.chain[up], t.moves.speed[up]
    out = []
    allowed = speed * p.path.tick * (1 + 1e-6) + 1e-9
    for motion, delay in ((up, nozzle.open_delay), (down, nozzle.close_delay)):
        due = t.arc[motion] + speed * delay
        fires = t.time_at(t.arc[motion], chain) - t.half[motion]
        fires = np.ceil(fires / p.path.tick - 1e-6) * p.path.tick
        real = t.arc_at(fires + delay, chain)
        error = np.abs(real - due)
        r.valve_error = max(r.valve_error, float(error.max()))
        bad = np.flatnonzero(error > allowed + t.half[motion] * speed)
        if len(bad):
            k = int(bad[0])
            r.fault(f"a valve is {error[k]:.3f} mm off at {speed[k]:g} mm/s, one tick is {allowed[k]:.3f} mm")
        r.slowest = min(r.slowest, float((t.speed_at(real, chain) / speed).min()))
        out.append((due, real, fires + delay))
    return out


def _speeds(t: Timed, up: NDArray[np.int64], down: NDArray[np.int64], p: Profile, r: Result) -> None:
    """Corners slow the tip down to v cos(turn / 2); they must not touch, nor leave the tolerance."""
    mark = np.zeros(len(t.bend) + 1)
    np.add.at(mark, up + 1, 1)
    np.add.at(mark, down + 1, -1)
    wet = np.cumsum(mark)[:-1] > 0
    if wet.any():
        turn = t.bend[wet]
        r.slowest = min(r.slowest, float(np.cos(turn / 2).min()))
        cut = t.moves.speed[wet] ** 2 * np.sin(turn / 2) ** 2 / (2 * t.accel)
        r.rounding = max(r.rounding, float(cut.max()))
    length = np.diff(t.arc)
    reach = t.half * t.moves.speed
    if np.any(reach[1:] > np.minimum(length[1:], length[:-1]) / 2 + 1e-9):
        r.fault("the blend of a corner does not fit its motions")
    if 1 - r.slowest > p.path.speed_tolerance:
        r.fault(f"the wet speed falls to {r.slowest:.3f} of what it should be")


def _grouped(z: Array, tool: int, commanded: Paths, laid: Paths) -> list[Deposit]:
    """Group runs by height."""
    out = []

    cuts = np.concatenate([[0], np.flatnonzero(np.abs(np.diff(z)) > 1e-6) + 1, [len(z)]])
    for a, b in zip(cuts[:-1], cuts[1:], strict=True):
        which = np.arange(a, b)
        out.append(Deposit(tool, float(z[a]), pick(commanded, which), pick(laid, which)))
    return out


def arm_of(t: Timed, tool: int, p: Profile, r: Result) -> None:
    """Note the extremes of every joint, and what is beyond its range."""
    robot = p.robot
    nozzle = p.nozzles[max(tool, 0)]
    xy = kin.wrist(t.moves.points[:, :2], nozzle, p)
    w, segment = kin.sample(xy[:-1], xy[1:], 10.0)
    angle = kin.joints(w, p)
    depth = kin.stroke(t.moves.points[:, 2], nozzle, p)
    if not np.isfinite(angle).all():
        r.fault("a motion is out of reach")
        return
    way = np.diff(xy, axis=0)
    length = np.maximum(np.hypot(way[:, 0], way[:, 1]), 1e-9)
    rate = np.abs(kin.joint_speeds(w, (way / length[:, None] * t.moves.speed[:, None])[segment], p))
    for j, values in enumerate((angle[:, 0], angle[:, 1], depth, angle[:, 2])):
        note_joint(j, values, p, r)
    for j, speeds in ((0, rate[:, 0]), (1, rate[:, 1]), (3, rate[:, 2])):
        name = f"J{j + 1}"
        r.joint_speeds[name] = max(r.joint_speeds.get(name, 0.0), float(speeds.max()))
        if r.joint_speeds[name] > robot.joint_speed[j]:
            r.fault(f"{name} is too fast: {r.joint_speeds[name]:.1f} degrees/s")


def note_joint(j: int, values: Array, p: Profile, r: Result) -> None:
    """Note the extremes of one joint, counted from 0, and whether it leaves its range."""
    name = f"J{j + 1}"
    low, high = r.joints.get(name, [math.inf, -math.inf])
    low, high = min(low, float(values.min())), max(high, float(values.max()))
    r.joints[name] = [low, high]
    turn = kin.whole_turns((low, high), p) if j == 3 else 0.0
    if low + turn < p.robot.joint_low[j] - 1e-6 or high + turn > p.robot.joint_high[j] + 1e-6:
        r.fault(f"{name} leaves its range: {low:.2f} to {high:.2f}")


def travels_of(t: Timed, pairs: NDArray[np.int64], tool: int, laid: float, p: Profile, r: Result) -> float:
    """Find travel on which a tip is not lifted; return the top of the highest layer so far, mm.

    Parameters
    ----------
    t : Timed
    pairs : (R, 3) int64
        As for `beads_of`.
    tool : int
        The nozzle in use.
    laid : float
        Top of the highest layer before these motions.
    """
    nozzle = p.nozzles[tool]
    height = np.full(len(t.length), -math.inf)
    height[t.chain[pairs[:, 0]]] = t.moves.points[pairs[:, 0], 2] - nozzle.standoff
    top = np.maximum.accumulate(np.maximum(height, laid))
    a, b = t.moves.points[:-1], t.moves.points[1:]
    flat = np.hypot(*(b - a)[:, :2].T) > 1e-6
    lowest = np.minimum(a[:, 2], b[:, 2])
    # Either tip stays as high above the layers as it is while one of the nozzles works, and lifted besides.
    above = min(n.standoff + n.offset[2] for n in p.nozzles) - nozzle.offset[2]
    least = top[t.chain] + above + max(min(p.motion.lift, p.motion.clearance), 0.0)
    low = flat & np.isinf(height[t.chain]) & (lowest < least - 1e-6)
    if low.any():
        k = int(low.argmax())
        r.fault(f"the tip travels at {lowest[k]:.3f} mm, where {least[k]:.3f} mm is the least: it is not lifted")
    return float(top[-1])


def _cut(t: Timed, points: Array, start: Array, end: Array) -> Paths:
    """Return the polylines between two ways along the motions."""
    first = np.searchsorted(t.arc, start, "right")
    last = np.maximum(np.searchsorted(t.arc, end, "left"), first)
    inner = last - first
    size = inner + 2
    ends = np.concatenate([[0], np.cumsum(size)])
    out = np.empty((ends[-1], 2))
    out[ends[:-1]], out[ends[1:] - 1] = t.place(start)[:, :2], t.place(end)[:, :2]
    total = np.concatenate([[0], np.cumsum(inner)])
    at = np.arange(total[-1]) - np.repeat(total[:-1], inner)
    out[np.repeat(ends[:-1] + 1, inner) + at] = points[np.repeat(first, inner) + at]
    return Paths(out, ends.astype(np.uint32), False)
