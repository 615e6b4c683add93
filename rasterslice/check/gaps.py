"""Which layers are not there, and which lie beside their place, by the heights of the others."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from .form import Flags, Floats
from .reference import Side

OTHER = "another thickness"  # how the note begins that must not be overlooked
ROUND = 0.025  # mm: of thicknesses that people ask for
_WHOLE = 0.05  # thicknesses: by how much a step of regular layers may be off
_ROUNDED = 0.006  # mm: what a file that writes two decimals is off
GAP = 1.5  # a step is a gap when it is that many times what the layers beside it are apart
_BESIDE = 3  # steps to either side that are looked at
_RUN = 3  # layers in a row that may lie beside their place
_ASTRAY = 0.05  # of the layers may do so; when more do, heights vary
_FEW = 8  # of fewer layers nobody says that one lies beside its place
_FINEST = 10  # rows of missing layers for each layer that was asked for, at most


@dataclass(slots=True)
class Spacing:
    """How far apart layers lie.

    Attributes
    ----------
    local : (N - 1,) float64
        Between each two neighbours, where nothing is missing, mm.
    regular : bool
        Whether all layers but the first and those astray are a thickness apart, or several.
    astray : dict of int to float
        Layers that lie beside their place, and where they are due.
    """

    local: Floats
    regular: bool
    astray: dict[int, float]


@dataclass(slots=True)
class Gaps:
    """What is not where it should be.

    Attributes
    ----------
    lost : (M,) float64
        Heights at which a layer is missing.
    astray : dict of int to str
        What is to be said of layers that lie beside their place.
    notes : list of str
    """

    lost: Floats
    astray: dict[int, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def spacing(z: Floats, thickness: float) -> Spacing:
    """Tell regular layers from those whose heights vary.

    Parameters
    ----------
    z : (N,) float64
        Ascending, top, middle or bottom of layers, mm.
    thickness : float
        Of most layers, mm.
    """
    steps = np.diff(z)
    alike = np.full(len(steps), thickness)
    whole = _whole(steps, thickness)
    astray = _astray(z, thickness, whole)
    if astray is not None:
        return Spacing(alike, True, astray)
    beside = np.pad(steps, _BESIDE)
    median = np.median(sliding_window_view(beside, _BESIDE), axis=1)
    left, right = median[: len(steps)], median[_BESIDE + 1 :][: len(steps)]
    local = np.maximum(left, right)
    for near in (beside[_BESIDE - 1 :][: len(steps)], beside[_BESIDE + 1 :][: len(steps)]):
        local = np.where(near <= GAP * local, np.maximum(local, near), local)
    return Spacing(np.where(local > 1e-6, local, thickness), False, {})


def _whole(steps: Floats, thickness: float) -> Flags:
    off = np.abs(steps / thickness - np.round(steps / thickness)) * thickness
    return np.asarray(off <= max(_WHOLE * thickness, _ROUNDED))


def _astray(z: Floats, thickness: float, whole: Flags) -> dict[int, float] | None:
    """Return the layers that lie beside their place and where they are due; None when heights vary.

    A few layers are astray when those below and above them are as far apart as they are to be. The first layer may be
    of another height, and the last.
    """
    found: dict[int, float] = {}
    last = len(whole) - 1
    reached = 0
    for a in np.flatnonzero(~whole).tolist():
        if a < reached:
            continue
        for b in range(a + 2, min(a + _RUN + 2, len(z))):
            if _whole(np.array([z[b] - z[a]]), thickness)[0] and round((z[b] - z[a]) / thickness) == b - a:
                found |= {i: float(z[a] + thickness * (i - a)) for i in range(a + 1, b)}
                reached = b
                break
        else:
            if a not in (0, last):
                return None
    few = not found or (len(z) >= _FEW and len(found) <= max(1, _ASTRAY * len(z)))
    return found if few else None


def counted(ref: Side, numbers: Floats) -> list[str]:
    """Return what is to be said of pictures without heights, when another thickness makes as many of them."""
    count, due = round(float(np.ptp(numbers))) + 1, len(ref.heights)
    if abs(count - due) <= 1:
        return []
    p, tall = ref.params, float(ref.high[2] - ref.low[2])
    for thickness in (np.arange(1, 80) * ROUND).round(3).tolist():
        if int(np.ceil(tall / thickness - p.slice_position - 1e-9)) == count:
            text = f"{OTHER}: {count} pictures, {due} are due; layers of {thickness:g} mm make as many, and"
            return [f"{text} {p.thickness:g} mm are asked for"]
    return []


def missing(ref: Side, z: Floats, heights: Floats, thickness: float) -> Gaps:
    """Return at which heights theirs has no layer, which layers lie beside their place, and notes.

    Heights are held against each other, and against the part's bottom and top: where the first layer is thinner or
    thicker than the others, all others lie beside the heights that we would cut. Where heights vary, a layer is missing
    where two lie farther apart than the layers beside them.

    Parameters
    ----------
    ref : Reference or Run
    z, heights : (N,) float64
        As the file gives them, in mm, and where they are cut; ascending.
    thickness : float
        Of most layers, mm.
    """
    due, found = ref.params.thickness, Gaps(np.empty(0))
    low, high = float(ref.low[2]), float(ref.high[2])
    apart, steps = spacing(z, thickness), np.diff(z)
    first, last = (float(k) for k in apart.local[[0, -1]]) if len(steps) else (thickness, thickness)
    if abs(thickness / due - 1) > 0.01:
        what = f"{OTHER}: layers of {thickness:.4g} mm, and {due:g} mm are asked for"
        found.notes.append(f"{what}; each is compared at its own height, and how many there should be is not asked")
    if apart.regular:
        near = np.abs(ref.heights[None, :] - heights[len(heights) // 2]).min(initial=np.inf)
        if abs(thickness / due - 1) <= 0.01 and near > 0.01 * thickness:
            found.notes.append(f"their layers lie {near:.3f} mm beside ours: compared at their heights")
        below = int(np.floor((heights[0] - low) / thickness - 0.25))
        if near <= 0.01 * thickness:
            below = int((ref.heights < heights[0] - thickness / 4).sum())
        above = int(np.ceil((high - heights[-1]) / thickness - 0.02)) - 1
        between = np.round(steps / thickness).astype(int) - 1
    else:
        found.notes.append("layer heights vary: one is missing where two lie farther apart than the layers beside them")
        below = int(np.floor((heights[0] - low) / max(first, due) - 0.4))
        above = int(np.ceil((high - heights[-1]) / last - 0.25)) - 1
        between = np.where(steps > GAP * apart.local, np.round(steps / apart.local), 1).astype(int) - 1
    if above > 1:
        found.notes.append(f"the file ends {above} layers below the top of the part: it may have been cut short")
    least = due / _FINEST
    lost = [_rows(heights[0] - (below + 1) * first, heights[0], below, low, high, least)]
    lost.append(_rows(heights[-1], heights[-1] + (above + 1) * last, above, low, high, least))
    for i in np.flatnonzero(between > 0).tolist():
        lost.append(_rows(heights[i], heights[i + 1], between[i], low, high, least))
    found.lost = np.concatenate(lost)
    for i, place in apart.astray.items():
        found.astray[i] = f"the layer lies at z {z[i]:g}, where {place:g} is due"
    return found


def _rows(a: float, b: float, count: int, low: float, high: float, least: float) -> Floats:
    """Return so many heights between two, those within the part alone: a number in a file makes no rows by itself."""
    if count <= 0:
        return np.empty(0)
    step = max((b - a) / (count + 1), least)
    start = max(1, int(np.floor((low - a) / step)))
    end = int(np.ceil((min(b, high) - a) / step))
    rows = a + step * np.arange(start, end + 1)
    return np.asarray(rows[(rows > low) & (rows < high) & (rows < b - step / 2)])
