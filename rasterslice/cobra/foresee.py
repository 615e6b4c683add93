"""What can be told of a job before it is sliced: that it cannot fit the machine, whatever its layers hold."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from ..profile import Profile
from . import kinematics as kin
from .checks import Check, Checker
from .fit import Site

Box = NDArray[np.float64]


def foresee(low: Box, high: Box, reach: float, profile: Profile, site: Site) -> None:
    """Refuse a part that is larger than the machine's envelope or higher than its stroke.

    `checks` says so too, but only when every path is known.

    Parameters
    ----------
    low, high : (3,) float64
        Bounds of the middle lines of one copy's beads, without scaffold, mm.
    reach : float
        How far scaffold may lie beyond that, mm: advice leaves room for it.
    profile : Profile
    site : Site

    Raises
    ------
    UsageError
        With the value, the limit and what would help.
    """
    try:
        _checker(low, high, profile, site).finish()
    except UsageError:
        _checker(low - (reach, reach, 0), high + (reach, reach, 0), profile, site).finish()
        raise


def _checker(low: Box, high: Box, profile: Profile, site: Site) -> Checker:
    checker = Checker(profile, site=site)
    checker.low = low + np.append(site.copies.min(axis=0), 0.0)
    checker.high = high + np.append(site.copies.max(axis=0), 0.0)
    nozzle = profile.nozzles[0]
    raised = high[2] + nozzle.standoff + max(profile.motion.lift, profile.motion.clearance)
    depth, limit = float(kin.stroke(np.array([raised]), nozzle, profile)[0]), profile.robot.joint_low[2]
    checker.checks["J3 range"] = Check("J3 range", limit, "mm", depth - limit, depth, "the last layer of the part")
    return checker
