"""Judge: pass, fail or cannot tell, layer by layer, with reasons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .align import Alignment
from .findings import Finding, Limits, Measures
from .form import TheirLayer, Theirs, pack_beads
from .gaps import missing
from .measure import HEIGHT_SLACK, measure, measure_softly, winding
from .picture import draw
from .pixels import COVERED, DISC
from .reference import Run, Side
from .width import Width

PASS, FAIL, UNKNOWN = "pass", "fail", "cannot tell"
ENOUGH = 0.5  # of the layers must pass for a file to pass
LOST = "not in the file"  # where a layer of ours stands that they lack


@dataclass(slots=True)
class LayerResult:
    """One layer of theirs, or one of ours that they lack.

    Attributes
    ----------
    index : int
        Number of our slice.
    z : float
        Its cutting height, mm.
    where : str
        Where it begins in their file.
    verdict : {"pass", "fail", "cannot tell"}
    reasons : list of str
    measures : Measures
    theirs : TheirLayer
        In our frame.
    copy : int
        Which copy this is of several, from 1; 0 where there is one.
    """

    index: int
    z: float
    where: str
    verdict: str
    reasons: list[str]
    measures: Measures
    theirs: TheirLayer
    copy: int = 0


@dataclass(slots=True)
class Report:
    """A whole check.

    Attributes
    ----------
    format : str
    verdict : {"pass", "fail", "cannot tell"}
    faults, notes : list of str
        Of the file as a whole; a fault fails it.
    limits : Limits
    alignment : Alignment
    layers : list of LayerResult
        By ascending height.
    seconds : dict
    copies : list of (float, float)
        By how much each of several copies is moved, mm.
    """

    format: str
    verdict: str
    faults: list[str]
    notes: list[str]
    limits: Limits
    alignment: Alignment
    layers: list[LayerResult]
    seconds: dict[str, float] = field(default_factory=dict)
    copies: list[tuple[float, float]] = field(default_factory=list)

    def worst(self, count: int) -> list[LayerResult]:
        """Return the layers that should be looked at first: failures, then by deviation."""
        rank = {FAIL: 0, UNKNOWN: 1, PASS: 2}
        return sorted(self.layers, key=lambda k: (rank[k.verdict], -deviation(k.measures), k.index))[:count]


def deviation(m: Measures) -> float:
    """Return the larger distance of a layer, mm; 0 when none is known."""
    return float(np.nanmax([m.to_ours, m.to_theirs, 0.0]))


def limits_of(ref: Side, theirs: Theirs, wide: Width, tolerance: float | None, scale: float = 1.0) -> Limits:
    """Return when a deviation counts, from pitch and width unless a tolerance is given; lengths are scaled to mm."""
    p, runs = ref.params, isinstance(ref, Run)
    pitch = max(p.pitch, theirs.pitch) if runs else p.pitch
    beads = any(k.beads is not None for k in theirs.layers)
    width = wide.value
    default = max(pitch / 4, 0.05 * width if beads else 0.0)
    uncertainty = 0.02 * pitch + theirs.precision * scale
    least = pitch**2 + (0.03 * width**2 if beads else 0.0)
    chosen = default if tolerance is None else tolerance
    shallow, deep = (width - wide.low) / 2, (wide.high - width) / 2
    grain = p.pitch if np.isnan(theirs.grain) else theirs.grain * scale
    thin, lost = (DISC * pitch, 0.0) if runs else (0.0, COVERED * grain)
    return Limits(
        chosen, uncertainty, least, p.min_point_spacing, pitch, width, thin, lost, shallow, deep, theirs.unsaid,
        theirs.pixel * scale,
    )  # fmt: skip


def with_missing(ref: Side, found: Alignment) -> tuple[Alignment, list[str], dict[int, str]]:
    """Add empty layers where theirs has none; return the notes of heights, and what is to be said of some layers."""
    z = found.z_scale * np.array([k.z for k in found.layers])
    gaps = missing(ref, z, found.heights, found.thickness)
    if not len(gaps.lost):
        return found, gaps.notes, gaps.astray
    empty = pack_beads([], [], []) if found.layers[0].beads is not None else None
    extra = [TheirLayer(float(z), LOST, beads=empty) for z in gaps.lost]
    heights = np.concatenate([found.heights, gaps.lost])
    order = np.argsort(heights, kind="stable")
    layers = [*found.layers, *extra]
    now = np.argsort(order)
    astray = {int(now[i]): text for i, text in gaps.astray.items()}
    return replace(found, layers=[layers[i] for i in order], heights=heights[order]), gaps.notes, astray


def judge(ref: Side, theirs: Theirs, found: Alignment, limits: Limits, doubt: str = "") -> Report:
    """Measure all layers and judge them; a doubt is one about every layer of beads."""
    found, notes, astray = with_missing(ref, found)
    measures = measure(ref, found, limits)
    _forgive_flat_faces(ref, found, limits, measures)
    for finding in measures[0].findings if theirs.unsaid else []:
        if finding.what.endswith("leaves the part"):
            finding.sure = False
            finding.text += "; a skirt would do so, and the file does not say what its beads are"
    for layer, m in zip(found.layers, measures, strict=True) if doubt else ():
        if layer.beads is not None and layer.where != LOST:
            m.findings.append(Finding("depth", False, doubt))
    if limits.uncertainty > limits.tolerance:
        notes.append(
            f"the file rounds: {limits.uncertainty:.3f} mm cannot be told, the tolerance is {limits.tolerance:g} mm; "
            "write it finer, or give --tolerance"
        )
    note = winding(found.layers, measures)
    _doubles(found, measures)
    for i, text in astray.items():
        measures[i].findings.append(Finding("height", True, text))
    notes = [*found.notes, *notes, *([note] if note else [])]
    index = np.searchsorted(ref.heights, found.heights - 0.25 * found.thickness).clip(max=len(ref.heights) - 1)
    layers = [
        _result(int(k), float(z), layer, m)
        for k, z, layer, m in zip(index, found.heights, found.layers, measures, strict=True)
    ]
    drawn = [k for k in layers if k.verdict != PASS or k.theirs.beads is not None]
    heights, differ = np.array([k.z for k in drawn]), [k.verdict != PASS for k in drawn]
    draw(ref, heights, [k.theirs for k in drawn], [k.measures for k in drawn], differ, limits.width)
    return Report(theirs.format, overall(found.faults, layers), found.faults, notes, limits, found, layers)


def rejudge(report: Report) -> None:
    """Judge anew when findings were added."""
    old = report.layers
    report.layers = [_result(k.index, k.z, k.theirs, k.measures) for k in old]
    report.verdict = overall(report.faults, report.layers)


def overall(faults: Sequence[str], layers: Sequence[LayerResult]) -> str:
    """Return the verdict of a file: a layer that fails fails it, and it passes when most layers were told to."""
    verdicts = [k.verdict for k in layers]
    if faults or FAIL in verdicts:
        return FAIL
    return PASS if verdicts.count(PASS) >= ENOUGH * len(verdicts) > 0 else UNKNOWN


def _result(index: int, z: float, layer: TheirLayer, m: Measures) -> LayerResult:
    sure = [f.text for f in m.findings if f.sure]
    lost = layer.where == LOST
    if lost and sure:
        sure = ["the layer is missing"]
    elif lost and not any(f.what == "missing layer" for f in m.findings):
        m.findings.append(Finding("missing layer", False, "no layer at this height, and nothing that had to be there"))
    verdict = FAIL if sure else UNKNOWN if m.findings else PASS
    return LayerResult(index, z, layer.where, verdict, sure or [f.text for f in m.findings], m, layer)


def _forgive_flat_faces(ref: Side, found: Alignment, limits: Limits, measures: list[Measures]) -> None:
    """Unsay what goes away when our slice may lie a little higher or lower."""
    kinds = [{f.what for f in m.findings if f.sure} for m in measures]
    suspects = [i for i, kind in enumerate(kinds) if kind - {"crossed"}]
    # Heights that come twice are judged one after the other.
    while suspects:
        steps = np.diff(found.heights[suspects], prepend=-np.inf)
        now = [i for i, step in zip(suspects, steps, strict=True) if step > 3 * HEIGHT_SLACK]
        suspects = [i for i in suspects if i not in set(now)]
        again = measure_softly(ref, [found.layers[i] for i in now], found.heights[now], limits)
        for i, softly in zip(now, again, strict=True):
            still = {f.what for f in softly.findings if f.sure}
            for finding in measures[i].findings:
                if finding.sure and finding.what not in still and finding.what != "crossed":
                    finding.sure = False
                    finding.text += f"; within what a slice {HEIGHT_SLACK:g} mm higher or lower may be"


def _doubles(found: Alignment, measures: list[Measures]) -> None:
    """Say which heights come twice."""
    for i in np.flatnonzero(np.diff(found.heights) < 1e-6) + 1:
        text = f"the height {found.layers[i].z:g} mm comes twice: {found.layers[i - 1].where}, {found.layers[i].where}"
        measures[i].findings.append(Finding("twice", True, text))
