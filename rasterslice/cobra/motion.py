"""How long motions take: trapezoids of speed, and chains of straight motions with parabolic blends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..paths import Toolpath
from ..profile import Nozzle, Profile
from .kinematics import wrist_offset

Array = NDArray[np.float64]


def trapezoid(length: Array, speed: Array | float, accel: float) -> Array:
    """Return the time from rest to rest over lengths, s."""
    speed = np.minimum(speed, np.sqrt(length * accel))
    return np.asarray(np.where(length > 0, length / np.maximum(speed, 1e-12) + speed / accel, 0.0))


@dataclass(slots=True)
class Estimate:
    """Times and lengths of a job, s and mm, added up from its toolpaths.

    Attributes
    ----------
    seconds : float
    wet : (float, float)
        Valve open, by material.
    dry : float
        Valve shut within the runs: leads.
    travel : float
        All other straight motions: between the runs, lifts, by way of the places to purge and to park.
    changes : int
        Of the tool, the first included.
    """

    seconds: float = 0.0
    wet: tuple[float, float] = (0.0, 0.0)
    dry: float = 0.0
    travel: float = 0.0
    changes: int = 0
    _tool: int = -1
    _at: Array | None = None

    def add(self, path: Toolpath, p: Profile) -> None:
        """Add the next toolpath."""
        first, last = path.offsets[:-1].astype(np.int64), path.offsets[1:].astype(np.int64) - 1
        step = np.diff(path.points, axis=0)
        length = np.hypot(step[:, 0], step[:, 1])
        total = np.concatenate([[0.0], np.cumsum(length)])
        run = total[last] - total[first]
        wet = float((run - length[first]).sum() - length[last - 1].sum())
        wet += len(path) * (path.close_distance - path.open_distance)
        inside = float(run.sum())
        self._go_to(path, p)
        settle, lift = p.motion.settle, np.array([p.motion.lift])
        gap = path.points[first[1:]] - path.points[last[:-1]]
        way = np.hypot(gap[:, 0], gap[:, 1])
        rise = 2 * float(trapezoid(lift, p.motion.travel_speed, p.accel)[0])
        self.seconds += float(trapezoid(run, path.speed, p.accel).sum()) + len(path) * (rise + 4 * settle)
        self.seconds += float(trapezoid(way, p.motion.travel_speed, p.accel).sum())
        self.travel += float(way.sum()) + 2 * len(path) * p.motion.lift
        by = list(self.wet)
        by[path.material] += wet
        self.wet = (by[0], by[1])
        self.dry += inside - wet
        height = path.top + p.nozzles[path.material].standoff
        self._tool, self._at = path.material, np.append(path.points[-1], height + p.motion.lift)

    def _go_to(self, path: Toolpath, p: Profile) -> None:
        """Add the way from the last toolpath to this one, as the player goes it."""
        m, nozzle = p.motion, p.nozzles[path.material]
        height = path.top + nozzle.standoff
        stops = [] if self._at is None else [self._at]
        change = self._tool != path.material
        if self._at is not None and (change or path.hold):
            up = self._at[2] - m.lift + m.clearance
            stops.append(np.append(self._at[:2], up))
            if path.hold:
                stops.append(np.array([*m.park_at, up]))
        if change:
            self._walk(stops, p)
            purge = np.array([*m.purge_at, height + m.clearance])
            stops = [self._swapped(stops[-1], p, nozzle) if stops else purge, purge]
            if self._at is None:
                stops[0] = np.array([*m.purge_at, p.robot.z_zero - p.part.frame[2] - nozzle.offset[2] - m.rise_to])
            self.seconds += nozzle.purge + max(n.close_delay for n in p.nozzles)
            self.changes += 1
        self._walk([*stops, np.append(path.points[0], height + m.lift)], p)
        self.seconds -= m.settle  # which is that of the first run

    def _swapped(self, tip: Array, p: Profile, nozzle: Nozzle) -> Array:
        """Return where the tip of a nozzle is when that of the one in use is somewhere."""
        old, new = wrist_offset(p.nozzles[self._tool], p), wrist_offset(nozzle, p)
        return np.asarray(tip + np.array(old) - new)

    def _walk(self, stops: list[Array], p: Profile) -> None:
        """Add straight motions from rest to rest."""
        legs = np.linalg.norm(np.diff(np.array(stops).reshape(-1, 3), axis=0), axis=1)
        self.travel += float(legs.sum())
        self.seconds += float(trapezoid(legs, p.motion.travel_speed, p.accel).sum()) + len(legs) * p.motion.settle
