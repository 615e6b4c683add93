"""How long motions take: trapezoids of speed, and chains of straight motions with parabolic blends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..paths import Toolpath
from ..profile import Profile

Array = NDArray[np.float64]


def trapezoid(length: Array, speed: Array | float, accel: float) -> Array:
    """Return the time from rest to rest over lengths, s."""
    speed = np.minimum(speed, np.sqrt(length * accel))
    return np.asarray(np.where(length > 0, length / np.maximum(speed, 1e-12) + speed / accel, 0.0))


def blend_time(step: Array, speed: Array | float, accel: float) -> Array:
    """Return half the time of each parabolic blend between successive motions, s, (K - 1,) of (K, D) steps."""
    length = np.linalg.norm(step, axis=1)
    way = step / np.maximum(length, 1e-12)[:, None]
    change = np.linalg.norm(way[1:] - way[:-1], axis=1)
    return np.asarray(change * speed / accel / 2)


@dataclass(slots=True)
class Estimate:
    """Times and lengths of a job, s and mm, added up from its toolpaths; `wet` is by material."""

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
        settle, lift = p.motion.settle, np.array([p.motion.lift])
        seconds = float(trapezoid(run, path.speed, p.accel).sum())
        rise = 2 * float(trapezoid(lift, p.motion.travel_speed, p.accel)[0])
        start, leave = path.points[first], path.points[last]
        begin = start[0] if self._at is None else self._at
        if self._tool != path.material:
            begin = np.array(p.motion.purge_at)
            seconds += p.nozzles[path.material].purge + max(n.close_delay for n in p.nozzles) + 2 * settle
            seconds += float(trapezoid(np.array([p.motion.clearance]), p.motion.travel_speed, p.accel)[0])
            if self._at is not None:
                seconds += float(trapezoid(np.hypot(*(begin - self._at))[None], p.motion.travel_speed, p.accel)[0])
            self.changes += 1
        gap = start - np.concatenate([begin[None], leave[:-1]])
        way = np.hypot(gap[:, 0], gap[:, 1])
        seconds += float(trapezoid(way, p.motion.travel_speed, p.accel).sum()) + len(path) * (rise + 4 * settle)
        by = list(self.wet)
        by[path.material] += wet
        self.wet = (by[0], by[1])
        self.dry += inside - wet
        self.travel += float(way.sum()) + 2 * len(path) * p.motion.lift
        self.seconds += seconds
        self._tool, self._at = path.material, leave[-1]
