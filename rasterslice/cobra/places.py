"""What a machine profile must leave free: room under the idle nozzle, and the places to purge and to park."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from ..profile import Profile

_NEAR = 0.01  # mm, by which a bead may lie elsewhere than was planned
NAMES = ("part", "scaffold")
Box = NDArray[np.float64]


def idle_gaps(profile: Profile) -> tuple[float, float]:
    """Return how high the idle tip is above the top of the layer, mm, while nozzle 0 and while nozzle 1 lays it.

    Offsets point from the flange to the tip, down: the longer nozzle is the lower one.
    """
    a, b = profile.nozzles
    return a.standoff + a.offset[2] - b.offset[2], b.standoff + b.offset[2] - a.offset[2]


def check_profile(profile: Profile) -> None:
    """Refuse nozzles of which the idle one would plough through what the other lays.

    Raises
    ------
    UsageError
        With both nozzles, the height, the least height and the remedy.
    """
    for k, gap in enumerate(idle_gaps(profile)):
        if gap < profile.motion.idle_gap - 1e-9:
            work, idle = NAMES[k], NAMES[1 - k]
            low, high = (profile.nozzles[i].offset[2] for i in (1 - k, k))
            raise UsageError(
                f"machine profile: while nozzle.{work} works, the tip of idle nozzle.{idle} is {gap:.4g} mm above the "
                f"layer, the least is motion.idle_gap {profile.motion.idle_gap:g} mm (offsets {high:g} and {low:g} mm "
                f"down, standoff {profile.nozzles[k].standoff:g} mm); mount nozzle.{idle} "
                f"{profile.motion.idle_gap - gap:.4g} mm higher, or raise nozzle.{work}.standoff"
            )


def on_beads(profile: Profile, width: float, beads: dict[tuple[int, int], tuple[Box, Box]]) -> str | None:
    """Say which place to purge or park is too near to beads that were laid; None when both are free.

    Parameters
    ----------
    profile : Profile
    width : float
        Of the widest bead, mm.
    beads : dict
        Bounds of the wet lines of a material at a height, (2,) mm each, by any key.
    """
    for name in ("purge_at", "park_at"):
        place, limit = getattr(profile.motion, name), profile.motion.keep_out
        away = [distance(place, low - width / 2, high + width / 2) for low, high in beads.values()]
        if away and min(away) < limit - _NEAR:
            return (f"motion.{name} ({place[0]:g}, {place[1]:g}) is {min(away):.3f} mm from beads, the least is "
                    f"motion.keep_out {limit:g} mm: what drops there would lie on the part, or under it")  # fmt: skip
    return None


def distance(place: tuple[float, float], low: Box, high: Box) -> float:
    """Return how far a place lies outside of a box, mm; negative inside of it."""
    at = np.array(place)
    beyond = np.maximum(low[:2] - at, at - high[:2])
    outside = np.hypot(*np.maximum(beyond, 0.0))
    return float(outside) if outside > 0 else float(beyond.max())
