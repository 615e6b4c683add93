"""Where tip, joints and valve are on every tick of one slice."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ..errors import UsageError
from ..profile import Profile
from . import kinematics as kin
from .chains import Array, Timed

_MOST = 2_000_000  # ticks


class Tracer:
    """Keeps samples of the motions at the heights of one slice.

    Parameters
    ----------
    profile : Profile
    records : Path
        The trajectory file.
    layer : int
        Number of the slice.
    """

    def __init__(self, profile: Profile, records: Path, layer: int) -> None:
        self._profile = profile
        self._rows: list[Array] = []
        self._count = 0
        heads = [r.split() for r in records.read_bytes().split(b"\r\n") if r.startswith(b"L ")]
        self._tips = {(int(h[3]) - 1, round(float(h[2]) * 1000)) for h in heads if int(h[1]) == layer}
        if not self._tips:
            raise UsageError(f"slice {layer} has no records; name another with --trace-layer")

    def __call__(self, t: Timed, tool: int, wet: Array) -> None:
        """Sample motions; `wet` holds when the valve was open, (R, 2) s."""
        p, tick = self._profile, self._profile.path.tick
        z = t.moves.points[t.moves.ends + 1, 2]
        heights = [h for k, h in self._tips if k == tool]
        mine = np.flatnonzero(np.isin(np.rint(z * 1000).astype(int), heights))
        if not len(mine) or self._count > _MOST:
            return
        lasts = t.length[mine] / np.maximum(t.peak[mine], 1e-12) + t.peak[mine] / t.accel
        count = np.ceil(lasts / tick).astype(int) + 1
        chain = np.repeat(mine, count)
        step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        time = t.begin[chain] + step * tick
        tip = t.place(t.arc_at(time, chain))
        nozzle = p.nozzles[tool]
        angle = kin.joints(kin.wrist(tip[:, :2], nozzle, p), p)
        depth = kin.stroke(tip[:, 2], nozzle, p)
        k = np.searchsorted(wet[:, 0], time, "right") - 1
        is_open = (k >= 0) & (time < wet[np.maximum(k, 0), 1]) if len(wet) else np.zeros(len(time), bool)
        valve = np.where(is_open, tool + 1, 0)
        self._rows.append(np.column_stack([time, tip, angle[:, :2], depth, angle[:, 2], valve]))
        self._count += len(time)

    def write(self, path: Path) -> None:
        """Write a CSV file.

        Raises
        ------
        UsageError
            When it cannot be written.
        """
        rows = np.concatenate(self._rows) if self._rows else np.empty((0, 9))
        scratch = path.with_name(f".{path.name}.part-{os.getpid()}")
        try:
            np.savetxt(scratch, rows, "%.3f,%.3f,%.3f,%.3f,%.4f,%.4f,%.3f,%.4f,%d", header="t,x,y,z,J1,J2,J3,J4,valve",
                       comments="")  # fmt: skip
            scratch.replace(path)
        except OSError as error:
            raise UsageError(f"{path}: cannot be written: {error.strerror}; name another with --trace") from None
        finally:
            scratch.unlink(missing_ok=True)
