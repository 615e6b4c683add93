"""Joint angles of a SCARA arm whose tool keeps its orientation, and their speeds.

The tool points down, ``TRANS(x, y, z, 0, 180, roll)``; J3 is mm, positive down; J2 has one sign for the whole job.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..profile import Nozzle, Profile

Array = NDArray[np.float64]


def wrist_offset(nozzle: Nozzle, profile: Profile) -> tuple[float, float, float]:
    """Return the flange minus the tip, mm, in the robot's frame."""
    x, y, z = nozzle.offset
    c, s = math.cos(math.radians(profile.part.roll)), math.sin(math.radians(profile.part.roll))
    return c * x - s * y, -(s * x + c * y), z


def wrist(points: Array, nozzle: Nozzle, profile: Profile) -> Array:
    """Return where the flange's axis stands, (N, 2) mm in the robot's frame, for tips (N, 2) in the part's frame."""
    dx, dy, _ = wrist_offset(nozzle, profile)
    return np.asarray(points + (profile.part.frame[0] + dx, profile.part.frame[1] + dy))


def stroke(height: Array, nozzle: Nozzle, profile: Profile) -> Array:
    """Return J3, mm, for heights of the tip in the part's frame."""
    return np.asarray(profile.robot.z_zero - (height + profile.part.frame[2] + nozzle.offset[2]))


def radii(profile: Profile) -> tuple[float, float]:
    """Return the least and the largest distance of the flange's axis from the robot's, mm, by the range of J2."""
    a, b = profile.robot.links
    low, high = profile.robot.joint_low[1], profile.robot.joint_high[1]
    folded, straight = (high, max(low, 0.0)) if profile.robot.elbow > 0 else (-low, max(-high, 0.0))

    def radius(angle: float) -> float:
        return math.sqrt(a * a + b * b + 2 * a * b * math.cos(math.radians(min(angle, 180.0))))

    return radius(folded), radius(straight)


def joints(w: Array, profile: Profile) -> Array:
    """Return J1, J2 and J4, degrees, (N, 3), for flange positions (N, 2); NaN where there are none.

    J4 is given without the whole turns that the controller may add.
    """
    a, b = profile.robot.links
    square = (w * w).sum(axis=1)
    cosine = (square - a * a - b * b) / (2 * a * b)
    with np.errstate(invalid="ignore"):
        two = profile.robot.elbow * np.arccos(cosine)
    one = np.arctan2(w[:, 1], w[:, 0]) - np.arctan2(b * np.sin(two), a + b * np.cos(two))
    one = (one + np.pi) % (2 * np.pi) - np.pi
    tool = 180.0 - profile.part.roll
    four = profile.robot.j4_sign * (tool - profile.robot.j4_zero - np.degrees(one + two))
    return np.stack([np.degrees(one), np.degrees(two), four], axis=1)


def tip(angle: Array, nozzle: Nozzle, profile: Profile) -> Array:
    """Return where the tip is, (3,) mm in the part's frame, for J1, J2, J3 and J4 in degrees and mm."""
    one, both = math.radians(angle[0]), math.radians(angle[0] + angle[1])
    a, b = profile.robot.links
    flange = np.array([a * math.cos(one) + b * math.cos(both), a * math.sin(one) + b * math.sin(both)])
    flat = flange - wrist(np.zeros((1, 2)), nozzle, profile)[0]
    return np.append(flat, stroke(np.zeros(1), nozzle, profile) - angle[2])


def joint_speeds(w: Array, velocity: Array, profile: Profile) -> Array:
    """Return the speeds of J1, J2 and J4, degrees/s, (N, 3), at flange positions and velocities (N, 2), mm/s."""
    a, b = profile.robot.links
    angle = np.radians(joints(w, profile))
    one, both = angle[:, 0], angle[:, 0] + angle[:, 1]
    det = a * b * np.sin(angle[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        d1 = b * (np.cos(both) * velocity[:, 0] + np.sin(both) * velocity[:, 1]) / det
        x, y = a * np.cos(one) + b * np.cos(both), a * np.sin(one) + b * np.sin(both)
        d2 = -(x * velocity[:, 0] + y * velocity[:, 1]) / det
    return np.asarray(np.degrees(np.stack([d1, d2, d1 + d2], axis=1)))


def whole_turns(four: tuple[float, float], profile: Profile) -> float:
    """Return the multiple of 360 degrees that brings a range of J4 nearest to the middle of its limits."""
    middle = (profile.robot.joint_low[3] + profile.robot.joint_high[3]) / 2
    return 360.0 * round((middle - (four[0] + four[1]) / 2) / 360.0)


def sample(a: Array, b: Array, step: float) -> tuple[Array, NDArray[np.int64]]:
    """Return points on segments a to b, no farther apart than a step; the end of each only where it is long, or last.

    Returns
    -------
    points : (M, 2) float64
    segment : (M,) int64
        The segment of each.
    """
    way = b - a
    length = np.hypot(way[:, 0], way[:, 1])
    count = np.maximum(np.ceil(length / step).astype(np.int64), 1)
    count[(count > 1) | (np.arange(len(a)) == len(a) - 1)] += 1
    segment = np.repeat(np.arange(len(a)), count)
    ends = np.cumsum(count)
    t = (np.arange(len(segment)) - np.repeat(ends - count, count)) / np.maximum(count - 1, 1)[segment]
    return a[segment] + t[:, None] * way[segment], segment


def least_radii(a: Array, b: Array) -> Array:
    """Return how near segments a to b come to the robot's axis, mm."""
    way = b - a
    t = np.clip(-(a * way).sum(axis=1) / np.maximum((way * way).sum(axis=1), 1e-30), 0.0, 1.0)
    near = a + t[:, None] * way
    return np.asarray(np.hypot(near[:, 0], near[:, 1]))
