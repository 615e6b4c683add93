"""How wide outer beads are, where the file does not say it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .align import Alignment, align, seen_width
from .form import Theirs
from .frame import says_width, width_of
from .reference import Side

FILAMENTS = (1.75, 2.85)  # mm: the diameters on sale
_ABOUT = 0.1  # how far off a width from filament or parameter file may be
_THIN, _THICK = 0.5, 4.0  # least and largest width of a bead, thicknesses of its layer


@dataclass(frozen=True, slots=True)
class Width:
    """Width of outer beads.

    Attributes
    ----------
    value : float
        mm.
    doubt : str
        Why walls that are all too deep could not be told; empty when they could.
    """

    value: float
    doubt: str = ""


def align_and_width(
    side: Side, theirs: Theirs, width: float | None, shift: tuple[float, float] | str
) -> tuple[Alignment, Width]:
    """Return the alignment, and the width of outer beads: as asked, as the file says, or as seen.

    What is seen, twice the depth of most outer beads, says nothing about that depth. It is believed when the filament
    that is fed, or the parameter file, bears it out.
    """
    wide = width or width_of(theirs.layers, side.params.part_width)
    found = align(side, theirs, wide, shift)
    if width is not None or says_width(theirs.layers) or "rasterslice" in theirs.format:
        return found, Width(wide)
    seen = seen_width(side, found)
    low, high = _THIN * found.thickness, _THICK * found.thickness
    fed = _from_filament(theirs, found.thickness, seen) if low <= seen <= high else ""
    borne_out = fed or _from_parameters(side, seen)
    used = seen if borne_out else float(np.clip(seen, low, high))
    found = align(side, theirs, used, shift)
    text = f"the file says no width: most outer beads lie {seen / 2:.3f} mm deep, half of {seen:.3f} mm"
    if borne_out:
        found.notes.append(f"{text}, which {borne_out} bears out")
        return found, Width(used)
    found.notes.append(f"{text}, and nothing bears that out: whether all are too deep cannot be told without --width")
    return found, Width(used, "how deep its walls should lie is not known: the file says no width; give --width")


def _from_filament(theirs: Theirs, thickness: float, seen: float) -> str:
    """Return what bears a width out, when the filament that is fed for a length of bead does."""
    if not theirs.fed > 0:
        return ""
    for diameter in (theirs.filament,) if theirs.filament > 0 else FILAMENTS:
        square = theirs.fed * math.pi / 4 * diameter**2 / thickness  # a bead with square edges
        rounded = square + (1 - math.pi / 4) * thickness
        if (1 - _ABOUT) * square < seen < (1 + _ABOUT) * rounded:
            return f"its filament of {diameter:g} mm"
    return ""


def _from_parameters(side: Side, seen: float) -> str:
    wanted = side.params.part_width
    return "the parameter file" if abs(seen / wanted - 1) < _ABOUT / 2 else ""
