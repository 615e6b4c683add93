"""Runs ``RSPLAY.V2`` with its settings and records, and watches what the arm and the valves would do.

The program text is interpreted as it is (`vplus`); the motions it asks for are timed by a model (`chains`): one motion
is taken ahead, a signal goes out on the tick after its motion begins, the drop follows after the delay in the profile.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from ..profile import Profile
from .bundle import Bundle
from .chains import Array, Moves, Timed, time_moves
from .vplus import Program
from .watch import Deposit, Result, arm_of, beads_of

_CHUNK = 60_000  # motions that are timed together


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
        deposits, wet = beads_of(timed, self._pairs(), self._tool, self.profile, self.result)
        self.deposits += deposits
        arm_of(timed, self._tool, self.profile, self.result)
        if self._watch is not None:
            self._watch(timed, self._tool, wet)
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
