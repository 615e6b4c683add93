"""What to change when a check refuses a job: in the parameter file, or in the machine profile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..profile import Profile
from . import kinematics as kin
from .fit import Box, Site, advice
from .places import distance

_PLACES = ("purge_at", "park_at")


@dataclass(frozen=True, slots=True)
class Extent:
    """Where a job lies, mm in the frame of the part.

    Attributes
    ----------
    low, high : (3,) float64
        Bounds of the wet lines; in z the tops of the layers.
    bottom : float
        Where the lowest layer begins.
    width : float
        Of the widest bead.
    """

    low: Box
    high: Box
    bottom: float
    width: float


def remedy(code: str, slack: float, extent: Extent, profile: Profile, site: Site) -> str:
    """Return what would help against a failed check.

    Parameters
    ----------
    code : str
        Of the check.
    slack : float
        By how much it passes its limit, negative.
    extent : Extent
    profile : Profile
    site : Site
    """
    word = code.split()[0]
    if word in ("reach", "least", "J1", "J2", "J4") and "speed" not in code:
        return _astray(profile) or advice(extent.low, extent.high, profile, site)
    if word == "envelope":
        return advice(extent.low, extent.high, profile, site)
    if word in ("purge", "park"):
        return f"move motion.{word}_at {_free(f'{word}_at', extent, profile, site)}"
    if word == "J3":
        return _stroke(-slack, extent, profile)
    if word == "bed":
        return _down(extent)
    return {
        "segment": f"{profile.finer()} in the machine profile",
        "lead-in": "raise path.lead_time in the machine profile", "lead-out": "raise path.lead_time",
        "dip": "lower the smooth angle, or raise path.speed_tolerance",
        "blend": "lower nozzle.speed, or the smooth angle", "points": "raise path.max_points",
        "ascending": "slice again", "rise": f"lower motion.rise_to by {-slack:.1f} mm, or make the part less high",
    }.get(word, "lower motion.travel_speed or nozzle.speed in the machine profile")  # fmt: skip


def in_the_air(extent: Extent) -> str:
    """Say that nothing lies under the lowest layer."""
    above = f"the lowest layer begins {extent.bottom:.1f} mm above the bed (z = 0)"
    return f"{above}, nothing lies under it; {_down(extent)}"


def _down(extent: Extent) -> str:
    by = f"{abs(extent.bottom):.1f} mm"
    if extent.bottom < 0:
        return f"raise the part by {by}: translation with 0 as its third number in the parameter file"
    return (f"lower the part by {by}: translation with 0 as its third number in the parameter file, or a part fraction "
            "that begins with 0")  # fmt: skip


def _stroke(by: float, extent: Extent, profile: Profile) -> str:
    """Say how the stroke of J3 would do."""
    if abs(extent.bottom) > 1.0:
        return _down(extent)
    return (f"it is {by:.1f} mm beyond the stroke: check the height in part.frame, {profile.part.frame[2]:g} mm, "
            "z_zero and the nozzle offsets in the machine profile, or lay the part on its side")  # fmt: skip


def _astray(profile: Profile) -> str | None:
    """Name a place of the profile that the arm cannot reach, wherever the part is."""
    near, far = kin.radii(profile)
    for name in _PLACES:
        at = np.array([getattr(profile.motion, name)])
        for nozzle in profile.nozzles:
            w = kin.wrist(at, nozzle, profile)
            angle = kin.joints(w, profile)[0]
            low, high = np.array(profile.robot.joint_low[:2]), np.array(profile.robot.joint_high[:2])
            if not near <= float(np.hypot(*w[0])) <= far or ((angle[:2] < low) | (angle[:2] > high)).any():
                return (f"motion.{name} ({at[0, 0]:g}, {at[0, 1]:g}) is itself out of reach of the flange: move that "
                        "nearer to the middle of the part's frame, in the machine profile")  # fmt: skip
    return None


def _free(name: str, extent: Extent, profile: Profile, site: Site) -> str:
    """Say where a place is off the part, and whether moving the part would free it."""
    half, keep = extent.width / 2, profile.motion.keep_out
    low, high = extent.low[:2] - half, extent.high[:2] + half
    text = (f"out of x {low[0] - keep:.0f} to {high[0] + keep:.0f}, y {low[1] - keep:.0f} to {high[1] + keep:.0f} mm: "
            "what drops there would lie on the part, or under it")  # fmt: skip
    middle = (low + high) / 2
    small = (extent.high - extent.low <= profile.part.envelope).all()
    if not small or np.abs(middle).max() <= 1.0:
        return text
    if distance(getattr(profile.motion, name), low - middle, high - middle) < keep:
        return text
    return f"{text}; or {advice(extent.low, extent.high, profile, site)}"
