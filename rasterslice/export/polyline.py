"""What the writers of text share: deposition paths as open polylines, and text made of arrays."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..paths import Layer, Paths

#: The deposition paths in the order in which they are written: (set, material, what).
DEPOSITS = (
    ("part_boundary", "part", "boundary"), ("part_fill", "part", "fill"),
    ("scaffold_boundary", "scaffold", "boundary"), ("scaffold_fill", "scaffold", "fill"),
)  # fmt: skip


def deposits(layer: Layer) -> Iterator[tuple[str, str, Paths]]:
    """Yield (material, ``boundary`` or ``fill``, paths) for the sets of a layer that hold paths."""
    for name, material, what in DEPOSITS:
        paths: Paths = getattr(layer, name)
        if len(paths.points):
            yield material, what, paths


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
