"""What of a file belongs to one of the copies that it holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .form import SUPPORT, Beads, Flags, Floats, TheirLayer, Theirs
from .loops import Ints
from .picture import Canvas


def share_of(theirs: Theirs, ids: NDArray[np.int32], sheet: Canvas, number: int) -> Theirs:
    """Return what of a file belongs to one copy."""

    def mine(points: Floats) -> Flags:
        at = np.floor((points - sheet.low) / sheet.pixel).astype(int)
        return np.asarray(ids[at[:, 1].clip(0, ids.shape[0] - 1), at[:, 0].clip(0, ids.shape[1] - 1)] == number)

    def held(loops: list[Floats]) -> list[int]:
        middles = np.array([p[len(p) // 2] for p in loops]).reshape(-1, 2)
        return np.flatnonzero(mine(middles)).tolist()

    layers: list[TheirLayer] = []
    props: list[TheirLayer] = []
    for source, all_props in ((theirs.layers, False), (theirs.props, True)):
        for k in source:
            kept = held(k.loops)
            beads = k.beads
            if beads is not None and len(beads.role):
                middles = beads.points[(beads.offsets[:-1] + beads.offsets[1:]) // 2]
                beads = _some(beads, np.flatnonzero(mine(middles)))
            layer = replace(
                k, beads=beads, loops=[k.loops[i] for i in kept], declared=[k.declared[i] for i in kept if k.declared],
                scaffold=[k.scaffold[i] for i in held(k.scaffold)], supports=[k.supports[i] for i in held(k.supports)],
            )  # fmt: skip
            if beads is not None and len(beads.role):
                (props if all_props or bool((beads.role == SUPPORT).all()) else layers).append(layer)
            elif layer.loops or layer.scaffold or layer.supports:
                layers.append(layer)
    return replace(theirs, layers=layers, props=props, notes=list(theirs.notes))


def _some(beads: Beads, which: Ints) -> Beads:
    """Return some beads of a layer."""
    count = np.diff(beads.offsets)
    chosen = np.zeros(len(count), bool)
    chosen[which] = True
    offsets = np.concatenate([[0], np.cumsum(count[chosen])]).astype(np.int64)
    fed = None if beads.fed is None else beads.fed[chosen]
    return Beads(beads.points[np.repeat(chosen, count)], offsets, beads.role[chosen], beads.width[chosen], fed)
