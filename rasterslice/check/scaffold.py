"""Compare scaffolds, which only writers that follow our rule make alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .findings import Finding, Limits, Measures
from .form import Floats, TheirLayer
from .loops import segments_of
from .measure import compare_both, zone
from .ours import sort_loops, spread
from .reference import BATCH, BATCH_TILES, Side

#: A scaffold is the level set of an image: it is exact to a pixel where it has creases.
CREASE = 0.75  # pixels


def compare_scaffolds(
    side: Side, ours: list[list[Floats]], layers: list[TheirLayer], out: list[Measures], limits: Limits
) -> None:
    """Add what is missing or extra in their scaffolds to the findings of each layer.

    Parameters
    ----------
    side : Reference or Run
        For its grid and device.
    ours : list of lists of (N, 2) float64
        Our scaffold at each of their layers.
    layers : list of TheirLayer
    out : list of Measures
    limits : Limits
    """
    pitch = limits.pitch
    loose = replace(limits, uncertainty=limits.uncertainty + CREASE * pitch, area=9 * pitch**2)
    batch = max(1, min(BATCH, BATCH_TILES // side.grid.tiles))
    for first in range(0, len(layers), batch):
        part = slice(first, first + batch)
        found = _one_batch(side, ours[part], [k.scaffold for k in layers[part]], loose)
        for m, mine in zip(out[part], found, strict=True):
            m.findings += [Finding(f.what, f.sure, f.text, f.place) for f in mine.findings]


def _one_batch(side: Side, ours: list[list[Floats]], theirs: list[list[Floats]], limits: Limits) -> list[Measures]:
    found = [Measures() for _ in ours]
    segments, layer, _ = segments_of(ours)
    mine = spread(segments, layer, 2 * limits.pitch)
    held = sort_loops(side.device, side.grid, segments, layer, len(ours), "first")
    others, owner, _ = segments_of(theirs)
    samples = spread(others, owner, 2 * limits.pitch)
    outward = held.distance(samples.points, samples.layer)
    second = sort_loops(side.device, side.grid, others, owner, len(ours), "second")
    inward = zone(held, second, mine, np.zeros(len(mine.points)), limits)
    compare_both(held, second, samples, outward, mine, inward, found, limits, "scaffold ")
    return found
