"""Runs ``RSPLAY.V2`` with its settings and records, and watches what the arm and the valves would do.

The program text is interpreted as it is (`vplus`); the motions it asks for are timed by a model (`chains`): one motion
is taken ahead, a signal goes out on the tick after its motion begins, the drop follows after the delay in the profile.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from ..paths import Paths
from ..profile import Profile
from . import kinematics as kin
from .bundle import Bundle
from .chains import Array, Moves, Timed, time_moves
from .vplus import Program

_CHUNK = 60_000  # motions that are timed together


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


Watch = Callable[[Timed, int, Array], None]


class Arm:
    """The host of the program: takes motions and signals, and gives `Deposit` objects to whoever asks."""

    def __init__(self, bundle: Bundle, watch: Watch | None = None) -> None:
        self.profile: Profile = bundle.profile
        self.result, self.deposits = Result(), list[Deposit]()
        self._bundle, self._watch = bundle, watch
        self._lines: Iterator[str] = iter(())
        self._status, self._speed, self._accel = 0, 0.0, bundle.profile.accel
        self._tool = -1
        self._valves = {n.valve: i for i, n in enumerate(bundle.profile.nozzles)}
        self._moves: list[tuple[float, float, float, float]] = []
        self._ends: list[int] = []
        self._rest: list[float] = []
        self._signals: list[tuple[int, bool, int, bool]] = []  # motion, after its end, nozzle, open
        self._at: Array | None = None
        self._time = 0.0
        self._open: int | None = None
        self._wet_times: Array = np.empty((0, 2))

    # What the program calls

    def moves(self, base: tuple[float, ...], to: tuple[float, ...]) -> None:
        """Take a straight motion."""
        if to[3:5] != (0, 180) or any(base[3:]) or self._speed <= 0:
            raise UsageError(f"a motion turns the tool or has no speed: {to}")
        self._moves.append((to[0], to[1], to[2], self._speed))

    def speed(self, value: float) -> None:
        """Set the speed of the motions that follow."""
        self._speed = value

    def accel(self, up: float, down: float) -> None:
        """Set the share of the largest acceleration."""
        if up != down:
            raise UsageError("accelerations up and down differ; the simulator has no model of that")
        self._accel = self.profile.motion.accel * up / 100

    def signal(self, *outputs: float) -> None:
        """Switch valves, as the last motion begins, or at once when the arm stands."""
        n = len(self._moves)
        standing = not n or (bool(self._ends) and self._ends[-1] == n - 1)
        for output in outputs:
            nozzle = self._valves.get(abs(int(output)))
            if nozzle is None:
                raise UsageError(f"signal {output} is no valve of the profile")
            self._signals.append((n - 1, standing, nozzle, output > 0))

    def brk(self) -> None:
        """Wait for the end of the motion."""
        n = len(self._moves)
        if n and (not self._ends or self._ends[-1] != n - 1):
            self._ends.append(n - 1)
            self._rest.append(self.profile.motion.settle)
        if n > _CHUNK and self._open is None:
            self._flush()

    def delay(self, seconds: float) -> None:
        """Stand for a while."""
        self.brk()
        if self._rest:
            self._rest[-1] += seconds

    def tool(self, offset: tuple[float, ...]) -> None:
        """Change the nozzle."""
        self._flush()
        known = [n.offset for n in self.profile.nozzles]
        self._tool = next((i for i, o in enumerate(known) if np.allclose(o, offset[:3], atol=1e-4)), -1)
        if self._tool < 0:
            raise UsageError(f"tool {offset} is no nozzle of the profile")
        self.result.changes += 1

    def wait(self, value: float) -> float:
        """Stand for the operator, who comes at once."""
        self.result.holds += 1
        return -1.0

    def say(self, *items: Any) -> None:
        """Take a message to the operator."""
        text = "".join(str(i) for i in items)
        self.result.messages.append(text)
        if "hold" not in text:
            self.result.fault(f"the program says: {text}")

    def attach(self, device: str) -> int:
        """Give a unit."""
        return 5

    def detach(self, unit: int) -> None:
        """Take a unit back."""

    def open(self, unit: int, name: str, write: bool) -> None:
        """Open the records."""
        path = self._bundle.folder / name
        self._status = 0 if path.is_file() and not write else -1
        if not self._status:
            self._lines = iter(path.read_bytes().decode("ascii", "replace").split("\r\n"))

    def close(self, unit: int) -> None:
        """Close the records."""

    def read(self, unit: int) -> str:
        """Return the next record."""
        line = next(self._lines, None)
        self._status = 0 if line is not None else -504
        if line is not None and len(line) > self.profile.files.max_record:
            self.result.fault(f"a record of {len(line)} characters: {line[:30]}")
        return line or ""

    def write(self, unit: int, text: str) -> None:
        """Refuse: the player writes nothing."""
        raise UsageError("the player writes to a file")

    def iostat(self, unit: int) -> int:
        """Return the status of the last reading."""
        return self._status

    # What comes of it

    def finish(self) -> Result:
        """Time what is left and return the result."""
        self._flush()
        if self._open is not None:
            self.result.fault("a valve is open at the end")
        self.result.seconds = self._time
        return self.result

    def _flush(self) -> None:
        """Time the motions so far, which end with a rest."""
        if not self._moves:
            self._signals.clear()
            return
        self.brk_now()
        data = np.array(self._moves)
        before = data[:1, :3] if self._at is None else self._at[None]
        moves = Moves(np.concatenate([before, data[:, :3]]), data[:, 3], np.array(self._ends), np.array(self._rest),
                      self._time)  # fmt: skip
        timed = time_moves(moves, self._accel, self.profile.path.tick)
        self._valve_runs(timed)
        self._arm(timed)
        if self._watch is not None:
            self._watch(timed, self._tool, self._wet_times)
        self._at, self._time = moves.points[-1], timed.end
        for items in (self._moves, self._ends, self._rest, self._signals):
            items.clear()

    def brk_now(self) -> None:
        """End the chain that is open, without a flush."""
        if not self._ends or self._ends[-1] != len(self._moves) - 1:
            self._ends.append(len(self._moves) - 1)
            self._rest.append(self.profile.motion.settle)

    def _pairs(self) -> NDArray[np.int64]:
        """Return (motion that opens, motion that shuts, nozzle) of each time that a valve is open in motion."""
        out, opened, since = [], -1, -1
        for motion, standing, nozzle, is_open in self._signals:
            if is_open:
                if self._open is not None:
                    self.result.fault(f"motion {motion}: a valve opens while one is open")
                self._open, opened, since = nozzle, -1 if standing else motion, motion
            elif self._open == nozzle:
                if opened >= 0:
                    out.append((opened, motion, nozzle))
                    if standing:
                        self.result.fault(f"motion {motion}: the valve is still open where the path ends")
                elif motion != since:
                    self.result.fault(f"motion {motion}: the valve opened before the arm moved")
                self._open = None
        return np.array(out, np.int64).reshape(-1, 3)

    def _valve_runs(self, t: Timed) -> None:
        """Find where the beads lie."""
        pairs = self._pairs()
        r, p = self.result, self.profile
        length = np.diff(t.arc)
        if not len(pairs):
            r.travel += float(length.sum())
            self._wet_times = np.empty((0, 2))
            return
        up, down, chain = pairs[:, 0], pairs[:, 1], t.chain[pairs[:, 0]]
        if np.any(t.chain[down] != chain):
            r.fault("a valve is open while the arm travels")
        nozzle = p.nozzles[int(pairs[0, 2])]
        if np.any(pairs[:, 2] != self._tool):
            r.fault("the valve of the other nozzle opens")
        speed = t.moves.speed[up]
        ends, edges = [], []
        for motion, delay in ((up, nozzle.open_delay), (down, nozzle.close_delay)):
            due = t.arc[motion] + speed * delay
            fires = t.time_at(t.arc[motion], chain) - t.half[motion]
            fires = np.ceil(fires / p.path.tick - 1e-6) * p.path.tick
            real = t.arc_at(fires + delay, chain)
            r.valve_error = max(r.valve_error, float(np.abs(real - due).max()))
            r.slowest = min(r.slowest, float((t.speed_at(real, chain) / speed).min()))
            ends.append((due, real))
            edges.append(fires + delay)
        self._wet_times = np.stack(edges, axis=1)
        allowed = float(speed.max()) * p.path.tick
        if r.valve_error > allowed * (1 + 1e-6) + float((t.half * t.moves.speed).max()):
            r.fault(f"a valve is {r.valve_error:.3f} mm off, one tick is {allowed:.3f} mm")
        (due0, real0), (due1, real1) = ends
        self._speeds(t, up, down)
        straight = t.moves.points[:, :2]
        commanded = _cut(t, straight, due0, due1, up, down)
        laid = _cut(t, t.rounded()[:, :2], real0, real1, up, down)
        r.wet[self._tool] += float((real1 - real0).sum())
        runs = np.zeros(len(t.length), bool)
        runs[chain] = True
        r.lead += float(t.length[runs].sum() - (real1 - real0).sum())
        r.travel += float(length.sum() - t.length[runs].sum())
        r.paths += len(pairs)
        r.points += int(runs[t.chain].sum()) + len(pairs)
        self._keep(t.moves.points[up, 2], commanded, laid)

    def _speeds(self, t: Timed, up: NDArray[np.int64], down: NDArray[np.int64]) -> None:
        """Corners slow the tip down to v cos(turn / 2); they must not touch, nor leave the tolerance."""
        r = self.result
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
        if 1 - r.slowest > self.profile.path.speed_tolerance:
            r.fault(f"the wet speed falls to {r.slowest:.3f} of what it should be")

    def _keep(self, z: Array, commanded: Paths, laid: Paths) -> None:
        """Group runs by height; a group may go on from the chunk before."""
        from ..runs import pick

        cuts = np.concatenate([[0], np.flatnonzero(np.abs(np.diff(z)) > 1e-6) + 1, [len(z)]])
        for a, b in zip(cuts[:-1], cuts[1:], strict=True):
            which = np.arange(a, b)
            self.deposits.append(Deposit(self._tool, float(z[a]), pick(commanded, which), pick(laid, which)))

    def _arm(self, t: Timed) -> None:
        """Note the extremes of every joint, and what is beyond its range."""
        p, r, robot = self.profile, self.result, self.profile.robot
        nozzle = p.nozzles[max(self._tool, 0)]
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
        for name, values, speeds, j in (("J1", angle[:, 0], rate[:, 0], 0), ("J2", angle[:, 1], rate[:, 1], 1),
                                        ("J3", depth, None, 2), ("J4", angle[:, 2], rate[:, 2], 3)):  # fmt: skip
            low, high = r.joints.get(name, [math.inf, -math.inf])
            low, high = min(low, float(values.min())), max(high, float(values.max()))
            r.joints[name] = [low, high]
            turn = kin.whole_turns((low, high), p) if j == 3 else 0.0
            if low + turn < robot.joint_low[j] - 1e-6 or high + turn > robot.joint_high[j] + 1e-6:
                r.fault(f"{name} leaves its range: {low:.2f} to {high:.2f}")
            if speeds is not None:
                r.joint_speeds[name] = max(r.joint_speeds.get(name, 0.0), float(speeds.max()))
                if r.joint_speeds[name] > robot.joint_speed[j]:
                    r.fault(f"{name} is too fast: {r.joint_speeds[name]:.1f} degrees/s")


def _cut(t: Timed, points: Array, start: Array, end: Array, up: NDArray[np.int64], down: NDArray[np.int64]) -> Paths:
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


def simulate(
    bundle: Bundle, take: Callable[[Deposit], None] | None = None, watch: Watch | None = None
) -> Result:
    """Play a bundle.

    Parameters
    ----------
    bundle : Bundle
    take : callable, optional
        Given every deposit in order.
    watch : callable, optional
        Given motions with their times, the tool, and when its valve was open, (R, 2) s.

    Raises
    ------
    UsageError
        When the program holds what the interpreter does not know, or asks for what the model has not.
    """
    arm = Arm(bundle, watch)
    names = ("RSPLAY.V2", "RSCFG.V2")
    try:
        files = {name: (bundle.folder / name).read_bytes().decode("ascii", "replace") for name in names}
    except OSError as error:
        raise UsageError(f"{error.filename}: {error.strerror}; export again") from None
    Program(files, arm).call("rs.run")
    result = arm.finish()
    if take is not None:
        for deposit in arm.deposits:
            take(deposit)
    return result
