"""What would bring a part within a machine: moved, turned, laid on its side, made smaller, or fewer copies of it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..profile import Profile

Box = NDArray[np.float64]

#: Rotations, as in the parameter file, that bring axis ``order[i]`` of a part to axis ``i``.
ROTATIONS: dict[tuple[int, ...], str] = {
    (1, 0, 2): "0 0 90", (0, 2, 1): "90 0 0", (2, 1, 0): "0 90 0", (1, 2, 0): "90 0 90", (2, 0, 1): "0 90 90"
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Site:
    """Where the copies of a part stand, (C, 2) mm from the first, and the least x and y of the first, if known."""

    copies: Box = field(default_factory=lambda: np.zeros((1, 2)))
    low: tuple[float, float] | None = None


def advice(low: Box, high: Box, profile: Profile, site: Site) -> str:
    """Return what to change so that a box of part and scaffold fits.

    Parameters
    ----------
    low, high : (3,) float64
        Bounds of all deposits, mm, in the frame of the part.
    profile : Profile
    site : Site
    """
    size, room = high - low, np.array(profile.part.envelope)
    if (size <= room).all():
        return _moved(low, high, site)
    several = len(site.copies) > 1
    one = size - np.append(np.ptp(site.copies, axis=0), 0.0)
    if several and (one <= room).all():
        return _fewer(one, room, site)
    text = ("each copy is " if several else "it is ") + " x ".join(f"{s:.1f}" for s in one) + " mm"
    for order, turn in ROTATIONS.items():
        if (one[list(order)] <= room).all():
            how = "turn it by 90 degrees about z" if order[2] == 2 else "lay it on its side"
            return f"{text}: {how} (rotation 1 {turn}) with translation 1 cent cent 0"
    ways = {order: float((room / one[list(order)]).min()) for order in itertools.permutations(range(3))}
    order = max(ways, key=lambda order: ways[order])  # as it lies comes first
    turn = f"with rotation 1 {ROTATIONS[order]}" if order in ROTATIONS else "as it lies"
    return (f"{text} and the envelope {' x '.join(f'{r:g}' for r in room)} mm: {turn}, scale it by about "
            f"{np.floor(ways[order] * 100) / 100:.2f} (an estimate: beads do not shrink with it, "
            "and the scaffold is made anew; it may take another step)")  # fmt: skip


def _moved(low: Box, high: Box, site: Site) -> str:
    """Say where a part that is small enough must go."""
    middle = (low[:2] + high[:2]) / 2
    if np.abs(middle).max() > 1.0:
        way = f"brings its middle from ({middle[0]:.0f}, {middle[1]:.0f}) to (0, 0)"
        if len(site.copies) == 1:
            return f"move it: translation of 1 cent cent 0 in the parameter file {way}"
        if site.low is None:
            return f"move all copies: {-middle[0]:.1f} mm along x and {-middle[1]:.1f} mm along y {way}"
        x, y = (a - b for a, b in zip(site.low, middle.tolist(), strict=True))
        return f"move all copies: translation of 1 {x:.1f} {y:.1f} 0 in the parameter file {way}; cent is the first"
    text = " x ".join(f"{s:.1f}" for s in high - low)
    return f"it is {text} mm, within the envelope: check part.frame and nozzle offsets in the machine profile"


def _fewer(one: Box, room: Box, site: Site) -> str:
    """Say in which grid the copies fit, or how many do."""
    places = [np.unique(np.round(site.copies[:, axis], 6)) for axis in (0, 1)]
    gap = min(float(p[1] - p[0] - one[axis]) for axis, p in enumerate(places) if len(p) > 1)
    across, along = ((room[:2] + gap + 1e-6) // (one[:2] + gap)).astype(int).tolist()
    text, count = " x ".join(f"{s:.1f}" for s in one), len(site.copies)
    if count <= across * along:
        grid = f"use copies {across} {-(-count // across)} {count}"
    else:
        grid = f"use copies {across} {along} {across * along} or fewer"
    return (f"{count} copies of {text} mm do not fit the envelope of {room[0]:g} x {room[1]:g} mm like this: {grid}, "
            "then move them to the middle")  # fmt: skip
