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
