"""Whether a job can be run, before a byte of it is written: each check with its worst place, value and limit."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from ..paths import CLOSE, MOVE, OPEN, TRAVEL, Toolpath
from ..profile import Profile
from . import kinematics as kin
from .fit import Site
from .places import NAMES, check_profile, distance, idle_gaps
from .remedies import Extent, in_the_air, remedy

Array = NDArray[np.float64]
_STEP = 5.0  # between samples of a long motion, mm
_BED = 0.05  # by which a layer may begin below the bed, mm
_NEAR = 1e-6  # by which a value may pass its limit: numbers are rounded


@dataclass(slots=True)
class Check:
    """The worst that one check has seen: `slack` is how far inside its limit, negative beyond it."""

    code: str
    limit: float
    unit: str
    slack: float = math.inf
    value: float | None = None
    where: str = ""

    @property
    def ok(self) -> bool:
        """Whether nothing passed the limit."""
        return self.slack >= -_NEAR


@dataclass(slots=True)
class Checker:
    """Checks toolpaths one after the other; `finish` says what is wrong.

    Attributes
    ----------
    profile : Profile
    smooth_angle : float
        Degrees.
    width : float
        Of the widest bead, mm.
    site : Site
        Where the copies of the part stand.
    heights : (float, float)
        Of a layer of ice and of scaffold, mm.
    bottom : float
        Where the lowest layer begins, mm.
    """

    profile: Profile
    smooth_angle: float = 45.0
    width: float = 0.0
    site: Site = field(default_factory=Site)
    heights: tuple[float, float] = (0.0, 0.0)
    bottom: float = math.inf
    checks: dict[str, Check] = field(default_factory=dict)
    low: Array = field(default_factory=lambda: np.full(3, np.inf))
    high: Array = field(default_factory=lambda: np.full(3, -np.inf))
    _four: list[float] = field(default_factory=lambda: [math.inf, -math.inf])
    _top: float = -math.inf
    _last: tuple[int, Array] | None = None

    def __post_init__(self) -> None:
        check_profile(self.profile)
        limit = self.profile.motion.idle_gap
        for name, gap in zip(NAMES, idle_gaps(self.profile), strict=True):
            self._keep("idle nozzle", gap, limit, gap - limit, "mm", f"while nozzle.{name} works")

    def add(self, path: Toolpath) -> None:
        """Check one more toolpath, in the order of laying."""
        bad = np.flatnonzero(~np.isfinite(path.points).all(axis=1))
        if len(bad) or not math.isfinite(path.top):
            at = self._place(path, int(bad[0]) if len(bad) else 0)
            raise UsageError(f"{at}: a coordinate is not a finite number; slice again")
        self._structure(path)
        self._motion(path)
        self._arm(path)
        wet = path.wet().points
        box = np.concatenate([wet.min(axis=0), [path.top]]), np.concatenate([wet.max(axis=0), [path.top]])
        self.low, self.high = np.minimum(self.low, box[0]), np.maximum(self.high, box[1])
        self._note("ascending", path, 0, path.top - self._top, 0.0, "mm", above=True)
        self._top = max(path.top, self._top)
        begin = path.top - self.heights[path.material]
        self._note("bed", path, 0, begin, -_BED, "mm", above=True)
        self.bottom = min(self.bottom, begin)
        for name in ("purge_at", "park_at"):
            place, limit = getattr(self.profile.motion, name), self.profile.motion.keep_out
            away = distance(place, box[0] - self.width / 2, box[1] + self.width / 2)
            where = f"{self._name(path)}, motion.{name} ({place[0]:g}, {place[1]:g})"
            self._keep(f"{name[:-3]} place", away, limit, away - limit, "mm", where)

    def finish(self) -> dict[str, dict[str, float | str | bool | None]]:
        """Return all results for the manifest.

        Raises
        ------
        UsageError
            When a check failed: place, value, limit and what would help.
        """
        size = self.high - self.low
        if np.isfinite(size).all():
            for axis, have, limit in zip("xyz", size.tolist(), self.profile.part.envelope, strict=True):
                self._keep(f"envelope {axis}", have, limit, limit - have, "mm", f"the part with its scaffold, {axis}")
        if self._four[0] <= self._four[1]:
            turn = kin.whole_turns((self._four[0], self._four[1]), self.profile)
            r = self.profile.robot
            for value, limit, slack in ((self._four[1] + turn, r.joint_high[3], r.joint_high[3] - self._four[1] - turn),
                                        (self._four[0] + turn, r.joint_low[3], self._four[0] + turn - r.joint_low[3])):
                self._keep("J4 range", value, limit, slack, "degrees", "the whole job")  # fmt: skip
        self._rise()
        failed = [c for c in self.checks.values() if not c.ok]
        if failed:
            worst = next((c for word in ("bed", "envelope") for c in failed if c.code.startswith(word)), failed[0])
            others = ", ".join(c.code for c in failed if c is not worst)
            others = f" (beyond their limits, too: {others})" if others else ""
            raise UsageError(
                f"{worst.where}: {worst.code} is {worst.value:.4g} {worst.unit}, the limit is {worst.limit:.4g}; "
                f"{remedy(worst.code, worst.slack, self._extent(), self.profile, self.site)}{others}"
            )
        return {
            c.code: {"ok": c.ok, "value": c.value, "limit": c.limit, "unit": c.unit, "where": c.where}
            for c in self.checks.values()
        }

    def warnings(self) -> list[str]:
        """Return what may be meant, but hardly is."""
        return [in_the_air(self._extent())] if max(self.heights) < self.bottom < math.inf else []

    def _extent(self) -> Extent:
        return Extent(self.low, self.high, self.bottom, self.width)

    def _rise(self) -> None:
        """Both tips pass over the part where the arm swings after it has risen."""
        p = self.profile
        if math.isfinite(self._top):
            tips = [p.robot.z_zero - p.motion.rise_to - p.part.frame[2] - n.offset[2] for n in p.nozzles]
            over, least = min(tips) - self._top, min(p.motion.lift, p.motion.clearance)
            self._keep("rise", over, least, over - least, "mm", "the whole job, the lower tip above the top")

    def _structure(self, path: Toolpath) -> None:
        """Every run: TRAVEL MOVE OPEN ... CLOSE, shut on every travel, and short enough for the player."""
        first, last = path.offsets[:-1].astype(np.int64), path.offsets[1:].astype(np.int64) - 1
        size = last - first + 1
        want = np.full(len(path.points), MOVE, np.uint8)
        sound = size >= 4
        if sound.all():
            want[first], want[first + 2], want[last] = TRAVEL, OPEN, CLOSE
            sound = np.logical_and.reduceat(path.ops == want, first)
        if not sound.all():
            at = self._place(path, int(first[np.flatnonzero(~sound)[0]]))
            raise UsageError(f"{at}: the valve does not open once and shut once within the run; report this")
        k = int(size.argmax())
        self._note("points of a path", path, int(first[k]), float(size[k]), self.profile.path.max_points + 8, "points")

    def _motion(self, path: Toolpath) -> None:
        """Segment time, leads, valve window, turns and blends."""
        p, v = self.profile, path.speed
        step = np.diff(path.points, axis=0)
        length = np.hypot(step[:, 0], step[:, 1])
        run = path.ops[1:] != TRAVEL
        first = path.offsets[:-1].astype(np.int64)
        last = path.offsets[1:].astype(np.int64) - 1
        inside = np.where(run, length, np.inf)
        k = int(inside.argmin())
        self._note("segment time", path, k + 1, float(inside[k]) / v, p.spacing(v) / v, "s", above=True)
        k = int(length[first].argmin())
        self._note("lead-in", path, int(first[k]), float(length[first[k]]), p.lead(v), "mm", above=True)
        out = length[last - 1] - path.close_distance
        k = int(out.argmin())
        self._note("lead-out", path, int(last[k]), float(out[k]), p.lead(v), "mm", above=True)
        turn_at = np.flatnonzero(run[1:] & run[:-1]) + 1
        a, b = step[turn_at - 1], step[turn_at]
        turn = np.abs(np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1)))
        k = int(turn.argmax())
        dip = 1 - math.cos(float(turn[k]) / 2)
        self._note("dip of the wet speed", path, int(turn_at[k]), dip, p.path.speed_tolerance, "of the speed")
        blend = v * v * np.sin(turn / 2) / p.accel
        room = np.minimum(length[turn_at - 1], length[turn_at]) / 2
        k = int((room - blend).argmin())
        self._note("blend", path, int(turn_at[k]), float(blend[k]), float(room[k]), "mm")

    def _arm(self, path: Toolpath) -> None:
        """Reach, joint ranges and speeds along every motion, lifts and the ways to purge and park included."""
        p, nozzle = self.profile, self.profile.nozzles[path.material]
        robot, points = p.robot, path.points
        speed = np.where(path.ops[1:] == TRAVEL, p.motion.travel_speed, path.speed)
        ends = [*self._detours(path), points]
        a = np.concatenate([e[:-1] for e in ends])
        b = np.concatenate([e[1:] for e in ends])
        speed = np.concatenate([np.full(len(a) - len(speed), p.motion.travel_speed), speed])
        first = len(a) - len(points) + 1
        wa, wb = kin.wrist(a, nozzle, p), kin.wrist(b, nozzle, p)
        near, far = kin.radii(p)
        out, into = np.maximum(np.hypot(wa[:, 0], wa[:, 1]), np.hypot(wb[:, 0], wb[:, 1])), kin.least_radii(wa, wb)
        k = int(out.argmax())
        self._note("reach", path, max(k - first + 1, 0), float(out[k]), far, "mm")
        k = int(into.argmin())
        self._note("least radius", path, max(k - first + 1, 0), float(into[k]), near, "mm", above=True)
        w, segment = kin.sample(wa, wb, _STEP)
        where = np.clip(segment - first + 1, 0, None)
        angle = kin.joints(w, p)
        if not np.isfinite(angle).all():
            return  # out of reach, which is noted
        for n, j in ((0, 0), (1, 1)):
            for k, limit, above in ((int(angle[:, n].argmax()), robot.joint_high[j], False),
                                    (int(angle[:, n].argmin()), robot.joint_low[j], True)):  # fmt: skip
                self._note(f"J{j + 1} range", path, int(where[k]), float(angle[k, n]), limit, "degrees", above=above)
        self._four = [min(self._four[0], float(angle[:, 2].min())), max(self._four[1], float(angle[:, 2].max()))]
        way = b - a
        length = np.maximum(np.hypot(way[:, 0], way[:, 1]), 1e-9)
        rate = np.abs(kin.joint_speeds(w, (way / length[:, None] * speed[:, None])[segment], p))
        for n, j in ((0, 0), (1, 1), (2, 3)):
            k = int(rate[:, n].argmax())
            self._note(f"J{j + 1} speed", path, int(where[k]), float(rate[k, n]), robot.joint_speed[j], "degrees/s")
        tip = path.top + nozzle.standoff
        for height in (tip, tip + max(p.motion.lift, p.motion.clearance)):
            depth = float(kin.stroke(np.array([height]), nozzle, p)[0])
            self._note("J3 range", path, 0, depth, robot.joint_high[2], "mm")
            self._note("J3 range", path, 0, depth, robot.joint_low[2], "mm", above=True)
        self._last = (path.material, points[-1])

    def _detours(self, path: Toolpath) -> list[Array]:
        """Return the ways before this toolpath: from the last one, by way of purge and park places."""
        stops = [] if self._last is None else [self._last[1]]
        if path.hold:
            stops.append(np.array(self.profile.motion.park_at))
        if self._last is None or self._last[0] != path.material:
            stops.append(np.array(self.profile.motion.purge_at))
        return [np.array([*stops, path.points[0]])]

    def _note(
        self, code: str, path: Toolpath, point: int, value: float, limit: float, unit: str, above: bool = False
    ) -> None:
        slack = value - limit if above else limit - value
        known = self.checks.get(code)
        if known is None or slack < known.slack:
            self._keep(code, value, limit, slack, unit, self._place(path, point))

    def _keep(self, code: str, value: float, limit: float, slack: float, unit: str, where: str) -> None:
        known = self.checks.get(code)
        if known is None or slack < known.slack:
            self.checks[code] = Check(code, limit, unit, slack, value if math.isfinite(value) else None, where)

    def _place(self, path: Toolpath, point: int) -> str:
        run = int(np.searchsorted(path.offsets, point, "right")) - 1
        run = min(max(run, 0), len(path) - 1)
        return f"{self._name(path)}, path {run}, point {point - int(path.offsets[run])}"

    @staticmethod
    def _name(path: Toolpath) -> str:
        return f"layer {path.layer}, {NAMES[path.material]} {path.pass_}"
