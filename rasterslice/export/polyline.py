"""What the writers of text share: ice layers, deposition paths as open polylines, and text made of arrays."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..paths import Layer, Paths
from .format import Context


@dataclass(frozen=True, slots=True)
class Pass:
    """What is laid at one height of a slice.

    Attributes
    ----------
    number : int
        Of the ice layer in the slice, 0 the lowest.
    share : float
        How much of the slice lies below its upper surface; 1 for the last, which holds the scaffold of the slice too.
    sets : list of (material, ``boundary`` or ``fill``, paths)
        In the order of laying; those that hold no path are left out.
    """

    number: int
    share: float
    sets: list[tuple[str, str, Paths]]


def passes(layer: Layer, context: Context) -> Iterator[Pass]:
    """Yield the ice layers of a slice, upwards: each has the boundary of the part and its own fill."""
    n = context.part_layers
    for i in range(n):
        sets = [("part", "boundary", layer.part_boundary), ("part", "fill", layer.ice_fill(i))]
        if i == n - 1:
            sets += [("scaffold", "boundary", layer.scaffold_boundary), ("scaffold", "fill", layer.scaffold_fill)]
        yield Pass(i, (i + 1) / n, [item for item in sets if len(item[2].points)])


def slice_notes(context: Context) -> list[str]:
    """Return what tells ice layers from slices, for the head of a file: `check` reads it."""
    return [
        f"ice_layers = {context.part_layers}", f"slice_thickness = {context.thickness:g}",
        f"slice_position = {context.slice_position:g}",
    ]  # fmt: skip


def unrolled(paths: Paths) -> Paths:
    """Return paths as open polylines: closed ones repeat their first point, those of less than two points go.

    Parameters
    ----------
    paths : Paths
        Points in mm.

    Returns
    -------
    Paths
        ``closed`` is False.
    """
    ends = paths.offsets.astype(np.int64)
    count: NDArray[np.int64] = ends[1:] - ends[:-1]
    keep = count >= 2
    count, first = count[keep], ends[:-1][keep]
    total = count + int(paths.closed)
    ends = np.concatenate([[0], np.cumsum(total)])
    step = np.arange(ends[-1]) - np.repeat(ends[:-1], total)
    step[step == np.repeat(count, total)] = 0  # the closing point is the first once more
    return Paths(paths.points[np.repeat(first, total) + step], ends.astype(np.uint32), False)


def fill_in(counts: NDArray[np.integer], patterns: dict[int, str], values: NDArray[np.float64]) -> str:
    """Return one text for all paths: the pattern of each one's number of points, filled in by one operation.

    Parameters
    ----------
    counts : (P,) int
        Points of each path.
    patterns : dict
        A format string for each number of points.
    values : (V,) float64
        What all of them take together, in order.
    """
    return "".join([patterns[n] for n in counts.tolist()]) % tuple(values.tolist())


def rounded(values: NDArray[np.float64], digits: int) -> NDArray[np.float64]:
    """Return values rounded, without a negative zero."""
    result: NDArray[np.float64] = np.round(values, digits) + 0.0
    return result
