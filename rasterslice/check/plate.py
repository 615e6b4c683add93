"""The copies of a file together: whether they stand where they should, and one report of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..part import copy_offsets
from .copies import Plate
from .findings import Limits
from .form import Floats
from .reference import Reference
from .verdict import FAIL, PASS, UNKNOWN, LayerResult, Report, overall

_NEAR = 0.02  # mm: how exactly the place of a copy is known, besides the limits
_MOST_ROWS = 64  # copies of which rows are looked for
_ANCHORS, _TRIED = 4, 8  # copies that may stand right, and spacings that are tried
_BESIDE = 1 / 3  # of a spacing, by which one of the copies may have moved
_RANK = {PASS: 0, UNKNOWN: 1, FAIL: 2}


def merged(side: Reference, plate: Plate, reports: Sequence[Report]) -> Report:
    """Return one report of all copies: of each layer the worst copy, and what is wrong with each by its number."""
    row = float(side.high[1] - side.low[1])
    first = min(-r.alignment.dy for r in reports)
    reports = sorted(reports, key=lambda r: (round((-r.alignment.dy - first) / row), -r.alignment.dx))  # as ours stand
    report, count = reports[0], len(reports)
    places = [(-r.alignment.dx, -r.alignment.dy) for r in reports]
    layers = _layers(reports)
    faults = _said([r.faults for r in reports])
    notes = _said([r.notes for r in reports])
    found, more = layout(side, np.array(places), report.limits)
    faults += found
    for x0, y0, x1, y1 in plate.foreign:
        what = f"what stands at ({x0:.1f}, {y0:.1f}) to ({x1:.1f}, {y1:.1f}) is no copy of the part and was left out"
        faults.append(f"{what}: write the file without it, or check it against its own parameter file")
    notes = [*more, *notes]
    return replace(
        report, layers=layers, faults=faults, notes=notes, verdict=overall(faults, layers),
        copies=[(x, y) for x, y in places] if count > 1 else [],
    )  # fmt: skip


def alone(side: Reference, plate: Plate, report: Report) -> Report:
    """Return the report of a file that was taken for one copy, with what that leaves to say."""
    asked = len(copy_offsets(side.params, side.low[:2], side.high[:2]))
    faults, notes = list(report.faults), list(report.notes)
    if asked > 1 and not plate.larger:
        what = f"the file holds 1 copy of the part, the parameter file asks for {asked}"
        faults.append(f"{what}: write all, or ask for 1")
    failed = sum(k.verdict == FAIL for k in report.layers)
    if plate.larger and failed > len(report.layers) / 2:
        part, size = (side.high - side.low)[:2], plate.size
        notes.append(
            f"the file spans {size[0]:.1f} x {size[1]:.1f} mm and the part {part[0]:.1f} x {part[1]:.1f}, and no "
            "copies of the part explain that: write the part alone, or copies that are only moved and do not touch, "
            "or name the parameter file of what is in the file; pictures of several copies must say how large a pixel "
            "is"
        )
    return replace(report, faults=faults, notes=notes, verdict=overall(faults, report.layers))


def _said(texts: Sequence[Sequence[str]]) -> list[str]:
    """Return what is said of all copies once, and of some with their numbers."""
    every = [t for t in texts[0] if all(t in other for other in texts)]
    some = [f"copy {k}: {t}" for k, own in enumerate(texts, 1) for t in own if t not in every]
    return every + some


def _layers(reports: Sequence[Report]) -> list[LayerResult]:
    """Return each layer once, as the worst copy has it, with the reasons of all."""
    together: dict[tuple[int, int], list[tuple[int, LayerResult]]] = {}
    for number, report in enumerate(reports, 1):
        times: dict[int, int] = {}
        for layer in report.layers:
            z = round(1000 * layer.z)
            times[z] = times.get(z, 0) + 1  # a height may come twice
            together.setdefault((z, times[z]), []).append((number, layer))
    found = []
    for key in sorted(together):
        own = together[key]
        worst = max((layer for _, layer in own), key=lambda k: _RANK[k.verdict])
        reasons = _said([k.reasons for _, k in own]) if len(own) == len(reports) else [
            f"copy {number}: {text}" for number, k in own for text in k.reasons
        ]  # fmt: skip
        copy = next(number for number, layer in own if layer is worst)
        found.append(replace(worst, reasons=reasons, copy=copy if len(reports) > 1 else 0))
    return found


def layout(side: Reference, places: Floats, limits: Limits) -> tuple[list[str], list[str]]:
    """Hold the places of copies against those that the parameter file asks for; return faults and notes.

    Parameters
    ----------
    side : Reference
    places : (C, 2) float64
        Where each copy stands, mm from where the part stands.
    limits : Limits
    """
    due = copy_offsets(side.params, side.low[:2], side.high[:2])
    count, asked = len(places), len(due)
    listed = ", ".join(f"({x:.2f}, {y:.2f})" for x, y in np.round(places[:12], 2) + 0.0)
    listed += ", ..." if count > 12 else ""
    text = f"the file holds {count} cop{'ies' if count > 1 else 'y'} of the part, moved by {listed} mm"
    if asked == 1:
        return [], [f"{text}; the parameter file asks for 1: each was compared"] if count > 1 else []
    notes = [f"{text}; the parameter file asks for {asked}"]
    off = places[:, None] - due[None]  # by which all would be moved
    near = limits.tolerance + limits.uncertainty + _NEAR
    tried = off.reshape(-1, 2)[: 10 * asked]
    met = [(np.hypot(*(off - t).transpose(2, 0, 1)) < near).any(axis=1).sum() for t in tried]
    apart = np.hypot(*(off - tried[int(np.argmax(met))]).transpose(2, 0, 1))
    beside = np.flatnonzero(apart.min(axis=1) >= near).tolist()
    gap = side.params.copy_gap or side.params.part_width
    other = _at_another_spacing(places, due, near, gap, int(max(met)))
    if other is not None:
        notes.append("they do not stand as far apart as the parameter file puts them")
        return [*other, *([f"the file holds {count} of {asked} copies"] if count < asked else [])], notes
    if count > 1 and max(met) == 1 and all(apart[k].min() > gap for k in beside):
        notes.append("they do not stand where the parameter file puts them, beside each other")
        faults = [f"the file holds {count} of {asked} copies"] if count < asked else []
        return faults, notes
    faults = [f"copy {k + 1} stands {apart[k].min():.3f} mm beside its place" for k in beside]
    taken = set(apart.argmin(axis=1).tolist())
    if count < asked:
        for j in sorted(set(range(asked)) - taken):
            faults.append(f"copy {j + 1} of the parameter file, {due[j][0]:g} and {due[j][1]:g} mm from the first, "
                          "is not in the file")  # fmt: skip
    return faults, notes


def _at_another_spacing(places: Floats, due: Floats, near: float, gap: float, agreed: int) -> list[str] | None:
    """Return what is wrong with copies that mostly stand in rows as asked for, but at another spacing; else None.

    Parameters
    ----------
    places, due : (C, 2), (A, 2) float64
        Where copies stand, and where they should, mm.
    near, gap : float
        How exactly places are known; by which a spacing must differ to be another, mm.
    agreed : int
        How many copies stand as far from each other as asked for.
    """
    if not 2 < len(places) <= _MOST_ROWS or len(due) > _MOST_ROWS:
        return None
    found: dict[tuple[int, ...], Floats] = {}
    steps = [np.diff(np.unique(np.round(due[:, i], 6))) for i in range(2)]
    step = np.array([s.min() if len(s) else 0.0 for s in steps])
    most = max(agreed, len(places) // 2) + 1
    for scale in _scales(places, step, gap):
        off, size = places[:, None] - (due * scale)[None], step * scale
        for moved in off[:_ANCHORS].reshape(-1, 2):
            apart = np.hypot(*(off - moved).transpose(2, 0, 1)).min(axis=1)
            met = tuple(np.flatnonzero(apart < near).tolist())
            if len(met) < most or apart.max() > _BESIDE * float(size[size > 0].min()):
                continue  # in no rows at all
            found = found if len(met) == most else {}
            most = len(met)
            found[met] = np.minimum(found.get(met, apart), apart)
    if not found:
        return None
    beside = {met: [k for k in range(len(places)) if k not in met] for met in found}
    if len(found) > 1:
        names = ", ".join(str(k + 1) for k in sorted({k for own in beside.values() for k in own}))
        return [f"the copies stand not equally far apart: one of {names} was moved, which one cannot be told"]
    met, apart = next(iter(found.items()))
    said = "mm beside its place at the spacing of the others"
    return [f"copy {k + 1} stands {apart[k]:.3f} {said}" for k in beside[met]]


def _scales(places: Floats, step: Floats, gap: float) -> list[Floats]:
    """Return by which factors the spacing of rows and columns may differ from what is asked for, by neighbours."""
    tried = []
    for i in range(2):
        off = np.abs(places[:, None, i] - places[None, :, i]).ravel()
        ratio = np.round(off[off > gap] / step[i], 4) if step[i] > 0 else np.empty(0)
        value, times = np.unique(ratio, return_counts=True)
        tried.append([1.0, *value[np.argsort(-times, kind="stable")][:_TRIED].tolist()])
    scales = [np.array([x, y]) for x in tried[0] for y in tried[1]]
    return [s for s in scales if bool(np.any(np.abs(s - 1) * step > gap))]
