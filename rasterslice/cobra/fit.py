"""What would bring a part within a machine: moved, turned, laid on its side, or made smaller."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from ..profile import Profile


def advice(low: NDArray[np.float64], high: NDArray[np.float64], profile: Profile) -> str:
    """Return what to change so that a box of part and scaffold fits.

    Parameters
    ----------
    low, high : (3,) float64
        Bounds of all deposits, mm, in the frame of the part.
    """
    size, room = high - low, np.array(profile.part.envelope)
    middle = (low[:2] + high[:2]) / 2
    text = " x ".join(f"{s:.1f}" for s in size)
    if (size <= room).all():
        if np.abs(middle).max() > 1.0:
            return (f"move it: translation of 1 cent cent 0 in the parameter file brings its middle from "
                    f"({middle[0]:.0f}, {middle[1]:.0f}) to (0, 0)")  # fmt: skip
        if low[2] > 1.0 or low[2] < -1.0:
            return f"move it: its lowest deposit is at {low[2]:.1f} mm; translate it to z = 0"
        return f"it is {text} mm, within the envelope: check part.frame and nozzle offsets in the machine profile"
    if (size[[1, 0, 2]] <= room).all():
        return f"it is {text} mm: turn it by 90 degrees about z (rotation 1 0 0 90)"
    for axes in itertools.permutations(range(3)):
        if (size[list(axes)] <= room).all():
            about = "1 90 0 0" if axes[2] == 1 else "1 0 90 0"
            return f"it is {text} mm: lay it on its side (rotation {about}) with translation 1 cent cent 0"
    scale = max(
        float((room / size[list(axes)]).min()) for axes in itertools.permutations(range(3))
    )  # the best way to lay it
    return (f"it is {text} mm and the envelope {' x '.join(f'{r:g}' for r in room)} mm: lay its longest side flat and "
            f"scale it by {np.floor(scale * 100) / 100:.2f} or less")  # fmt: skip
