"""The valves of an interpreted program: which motions they are open on, and how long they purge and drip."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from ..profile import Nozzle

if TYPE_CHECKING:
    from .watch import Result


class Valves:
    """Takes signals one after the other.

    Parameters
    ----------
    nozzles : (Nozzle, Nozzle)
    tick : float
        By how much a purge may miss its time, s.
    result : Result
        Faults are added.
    """

    def __init__(self, nozzles: tuple[Nozzle, Nozzle], tick: float, result: Result) -> None:
        self._nozzles, self._tick, self._result = nozzles, tick, result
        self._outputs: dict[float, int] = {n.valve: i for i, n in enumerate(nozzles)}
        self._signals: list[tuple[int, bool, int, bool]] = []  # motion, after its end, nozzle, open
        self._pouring: int | None = None  # at the signals so far
        self._open: int | None = None  # at the pairs so far
        self._tool, self._purged = -1, False
        self._since = self._shut_at = 0.0
        self._drips: int | None = None

    @property
    def shut(self) -> bool:
        """Whether no valve is open."""
        return self._pouring is None

    def change(self, tool: int) -> None:
        """Take another nozzle, which must be purged before it is used."""
        if not self.shut:
            self._result.fault("the tool changes while a valve is open")
        self._tool, self._purged = tool, self._nozzles[tool].purge <= 0

    def switch(self, output: float, motion: int, standing: bool, stood: float) -> None:
        """Take a signal.

        Parameters
        ----------
        output : float
            Number, negative to shut.
        motion : int
            The last motion.
        standing : bool
            Whether it has ended.
        stood : float
            Time that the arm has waited so far, s.
        """
        nozzle = self._outputs.get(abs(output))
        if nozzle is None:
            raise UsageError(f"signal {output} is no valve of RSCFG.V2")
        self._signals.append((motion, standing, nozzle, output > 0))
        if output > 0:
            self._pouring, self._since = nozzle, stood
            if not standing and not self._purged:
                self._result.fault(f"nozzle {nozzle + 1} is used before it is purged")
                self._purged = True
        elif self._pouring == nozzle:
            self._pouring = None
            if standing:
                self._end_of_purge(nozzle, stood)

    def _end_of_purge(self, nozzle: int, stood: float) -> None:
        lasted, wanted = stood - self._since, self._nozzles[nozzle].purge
        if abs(lasted - wanted) > self._tick:
            self._result.fault(f"the purge of nozzle {nozzle + 1} lasts {lasted:.3f} s, it should be {wanted:g} s")
        elif nozzle == self._tool:
            self._purged = True
        self._drips, self._shut_at = nozzle, stood

    def leave(self, stood: float) -> None:
        """Note that the arm moves: it must not drip any more."""
        if self._drips is not None:
            waited, wanted = stood - self._shut_at, self._nozzles[self._drips].close_delay
            if waited < wanted - 1e-9:
                self._result.fault(f"nozzle {self._drips + 1} moves {waited:g} s after its purge, it drips {wanted:g}")
            self._drips = None

    def forget(self) -> None:
        """Drop signals that belong to no motion."""
        self._open = self._pouring
        self._signals.clear()

    def pairs(self) -> NDArray[np.int64]:
        """Return (motion that opens, motion that shuts, nozzle) of each time that a valve was open in motion."""
        out, opened, since = [], -1, -1
        for motion, standing, nozzle, is_open in self._signals:
            if is_open:
                if self._open is not None:
                    self._result.fault(f"motion {motion}: a valve opens while one is open")
                self._open, opened, since = nozzle, -1 if standing else motion, motion
            elif self._open == nozzle:
                if opened >= 0:
                    out.append((opened, motion, nozzle))
                    if standing:
                        self._result.fault(f"motion {motion}: the valve is still open where the path ends")
                elif motion != since:
                    self._result.fault(f"motion {motion}: the valve opened before the arm moved")
                self._open = None
        self._signals.clear()
        return np.array(out, np.int64).reshape(-1, 3)
