"""The arm that an interpreted program moves, and its two valves. It notes what must not be."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from ..profile import Profile
from . import kinematics as kin
from .chains import Array, Moves, Timed, time_moves
from .desk import Desk
from .places import on_beads
from .valves import Valves
from .watch import Deposit, Result, arm_of, beads_of, note_joint, travels_of

_CHUNK = 60_000  # motions that are timed together

#: Given motions with their times, the tool, and when its valve was open, (R, 2) s.
Watch = Callable[[Timed, int, Array], None]


class Arm:
    """The host of a program: takes motions and signals, and gives `Deposit` objects.

    Parameters
    ----------
    profile : Profile
        With the settings that the program has.
    desk : Desk
        Knows the records, against which motions are held.
    result : Result
        Of the desk, too.
    start : sequence of float
        J1, J2, J3 and J4 where the arm stands at first.
    fail_at : int, optional
        The straight motion, counted from 0, at which an error of the robot is feigned.

    Attributes
    ----------
    watch : callable or None
        Given all motions, in parts.
    """

    def __init__(
        self, profile: Profile, desk: Desk, result: Result, start: tuple[float, ...] | None = None,
        fail_at: int | None = None,
    ) -> None:  # fmt: skip
        self.profile, self.desk, self.result, self.deposits = profile, desk, result, list[Deposit]()
        self.valves = Valves(profile.nozzles, profile.path.tick, self.result)
        self.watch: Watch | None = None
        self._speed, self._percent, self._accel, self._fail_at = 0.0, 0.0, profile.accel, fail_at
        self._tool, self._count, self._laid = -1, 0, -np.inf
        self._moves: list[tuple[float, float, float, float]] = []
        self._ends: list[int] = []
        self._rest: list[float] = []
        self._joints = np.array(start if start is not None else (20.0, 60.0 * profile.robot.elbow, 150.0, 0.0))
        self._at: Array | None = None
        self._time = self._wait = self._stood = 0.0  # stood: in delays that are over
        self._lifted = self._above = bool(self._joints[2] <= profile.motion.rise_to)
        self._reaction: Callable[[], None] | None = None
        self._frame, self._turned = (*profile.part.frame, 0, 0, 0), (0, 180, profile.part.roll)

    # Motions

    def moves(self, base: tuple[float, ...], to: tuple[float, ...]) -> None:
        """Take a straight motion."""
        self._target(base, to)
        if self._speed <= 0:
            raise UsageError(f"a straight motion has no speed in mm/s: {to}")
        if self._tool < 0 or self._at is None:
            raise UsageError("a straight motion without a tool")
        if not self._above:
            self.result.fault("the first straight motion does not go down from where the arm was lifted to")
            self._above = True
        if self._count == self._fail_at:
            self._error()
        self._count += 1
        self._pass()
        self.valves.leave(self._stood)
        self._moves.append((to[0], to[1], to[2], self._speed))

    def move(self, base: tuple[float, ...], to: tuple[float, ...]) -> None:
        """Take a motion joint by joint to a place of the tip."""
        self._target(base, to)
        if self._tool < 0:
            raise UsageError("a motion to a place without a tool")
        self._swing(self._joints_at(np.array(to[:3])))
        for j in range(4):
            note_joint(j, self._joints[j : j + 1], self.profile, self.result)
        self._at, self._above = np.array(to[:3]), self._lifted

    def move_joints(self, to: tuple[float, ...]) -> None:
        """Take a motion joint by joint to J1, J2, J3 and J4."""
        self._swing(np.array(to, float))
        self._at = None if self._tool < 0 else kin.tip(self._joints, self.profile.nozzles[self._tool], self.profile)

    def _swing(self, to: Array) -> None:
        """Move joint by joint: straight up, or level at the top."""
        if self._percent <= 0:
            raise UsageError("a motion joint by joint has no speed in percent")
        self._flush()
        way = np.abs(to - self._joints)
        if (way[[0, 1, 3]] > 1e-6).any() and max(to[2], self._joints[2]) > self.profile.motion.rise_to + 1e-3:
            self.result.fault(f"the arm swings at J3 {max(to[2], self._joints[2]):.1f} mm: it is not lifted")
        self._pass()
        self.valves.leave(self._stood)
        self._time += float((way / np.array(self.profile.robot.joint_speed)).max()) * 100 / self._percent
        self._rests(self.profile.motion.settle)
        self._joints = to
        self._lifted = self._lifted or bool(to[2] <= self.profile.motion.rise_to + 1e-3)

    def _target(self, base: tuple[float, ...], to: tuple[float, ...]) -> None:
        if base != self._frame or to[3:] != self._turned or len(to) != 6:
            raise UsageError(f"a motion turns the tool, or leaves the frame of the part: {base}, {to}")

    def side(self) -> None:
        """Take a request for one side of the elbow: the model knows only that of the profile."""

    def here(self) -> tuple[float, ...]:
        """Return where the tip is, in the robot's frame."""
        self._flush()
        if self._tool < 0 or self._at is None:
            raise UsageError("HERE without a tool, or before the arm is lifted")
        return (*(self._at + self.profile.part.frame).tolist(), 0.0, 180.0, self.profile.part.roll)

    def joints(self) -> tuple[float, ...]:
        """Return J1, J2, J3 and J4 where the arm stands."""
        self._flush()
        return tuple(self._joints.tolist())

    def speed(self, value: float) -> None:
        """Set the speed of straight motions, mm/s."""
        self._speed, self._percent = value, 0.0

    def percent(self, value: float) -> None:
        """Set the speed of motions joint by joint, percent."""
        self._speed, self._percent = 0.0, value

    def accel(self, up: float, down: float) -> None:
        """Set the share of the largest acceleration."""
        if up != down or not 0 < up <= 100:
            raise UsageError(f"ACCEL {up:g}, {down:g}: both must be the same, above 0 and at most 100 percent")
        self._accel = self.profile.motion.accel * up / 100

    def tool(self, offset: tuple[float, ...]) -> None:
        """Change the nozzle."""
        self._flush()
        new = next((i for i, n in enumerate(self.profile.nozzles) if n.offset == tuple(offset[:3])), -1)
        if new < 0:
            raise UsageError(f"tool {offset} is no nozzle of the profile")
        self._tool = new
        self._at = kin.tip(self._joints, self.profile.nozzles[new], self.profile)
        self.valves.change(new)
        self.result.changes += 1

    # Waiting, valves, errors, tasks

    def signal(self, *outputs: float) -> None:
        """Switch valves, as the last motion begins, or at once when the arm stands."""
        n = len(self._moves)
        standing = not n or (bool(self._ends) and self._ends[-1] == n - 1)
        for output in outputs:
            self.valves.switch(output, n - 1, standing, self._stood)

    def brk(self) -> None:
        """Wait for the end of the motion."""
        n = len(self._moves)
        self._end_chain()
        self._pass()
        if n > _CHUNK and self.valves.shut:
            self._flush()

    def delay(self, seconds: float) -> None:
        """Stand for a while after the motion; what follows does not wait for it, but for a BREAK."""
        self._end_chain()
        self._wait += seconds

    def _end_chain(self) -> None:
        n = len(self._moves)
        if n and (not self._ends or self._ends[-1] != n - 1):
            self._ends.append(n - 1)
            self._rest.append(self.profile.motion.settle)

    def _pass(self) -> None:
        """Let the delays so far go by."""
        self._rests(self._wait)
        self._stood += self._wait
        self._wait = 0.0

    def _rests(self, seconds: float) -> None:
        if self._ends and self._ends[-1] == len(self._moves) - 1:
            self._rest[-1] += seconds
        elif not self._moves:
            self._time += seconds

    def reacte(self, program: Callable[[], None]) -> None:
        """Keep the reaction to errors."""
        self._reaction = program

    def brake(self) -> None:
        """Stop where the arm is."""
        self._end_chain()
        self.result.brakes += 1

    def _error(self) -> None:
        if self._reaction is None:
            raise UsageError("an error of the robot, and no reaction to it")
        self._fail_at = None
        self._reaction()
        self.result.fault("the program goes on after an error")

    # What comes of it

    def finish(self) -> Result:
        """Time what is left and return the result."""
        self._flush()
        if not self.valves.shut:
            self.result.fault("a valve is open at the end")
        ledger = self.desk.ledger
        for fault in ledger.faults:
            self.result.fault(fault)
        if near := on_beads(self.profile, max(self.desk.widths), self._bounds()):
            self.result.fault(near)
        if ledger.done < len(ledger.points) and not self.result.faults:
            self.result.fault(f"{len(ledger.points) - ledger.done} points of the records are not played")
        self.result.seconds = self._time
        return self.result

    def _bounds(self) -> dict[tuple[int, int], tuple[Array, Array]]:
        """Return the bounds of the beads by material and height."""
        out: dict[tuple[int, int], tuple[Array, Array]] = {}
        for d in self.deposits:
            key, points = (d.tool, round(d.z * 500)), d.commanded.points
            low, high = out.get(key, (points[0], points[0]))
            out[key] = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
        return out

    def _flush(self) -> None:
        """Time the motions so far, which end with a rest."""
        if not self._moves:
            self.valves.forget()
            return
        self._end_chain()
        data = np.array(self._moves)
        assert self._at is not None
        moves = Moves(np.concatenate([self._at[None], data[:, :3]]), data[:, 3], np.array(self._ends),
                      np.array(self._rest), self._time)  # fmt: skip
        timed = time_moves(moves, self._accel, self.profile.path.tick)
        self._judge(timed, self.valves.pairs())
        self._at, self._time = moves.points[-1], timed.end
        if self._tool >= 0:
            self._joints = self._joints_at(self._at)
        for items in (self._moves, self._ends, self._rest):
            items.clear()

    def _judge(self, timed: Timed, pairs: NDArray[np.int64]) -> None:
        p, r = self.profile, self.result
        deposits, wet = beads_of(timed, pairs, self._tool, p, r)
        self.deposits += deposits
        arm_of(timed, self._tool, p, r)
        self._laid = travels_of(timed, pairs, self._tool, self._laid, p, r)
        ledger = self.desk.ledger
        if len(ledger.points) and (difference := ledger.match(timed, pairs, self._tool)):
            r.fault(difference)
        if self.watch is not None:
            self.watch(timed, self._tool, wet)

    def _joints_at(self, at: Array) -> Array:
        nozzle = self.profile.nozzles[self._tool]
        angle = kin.joints(kin.wrist(at[None, :2], nozzle, self.profile), self.profile)[0]
        if not np.isfinite(angle).all():
            raise UsageError(f"the arm is out of reach at {at[0]:.1f}, {at[1]:.1f} mm of the part's frame")
        depth = float(kin.stroke(at[2:], nozzle, self.profile)[0])
        return np.array([angle[0], angle[1], depth, angle[2] + kin.whole_turns((angle[2],) * 2, self.profile)])
