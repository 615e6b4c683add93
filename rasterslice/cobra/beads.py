"""The simulated beads as an image, held against the region that they should fill.

Pixels are a fifteenth of a bead. A band of one pixel on either side of the region's edge is not counted, for there an
image cannot tell; beads are drawn with round ends, some hundredths of a millimetre too wide.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..paths import ICE, SCAFFOLD, Layer, Paths
from .bundle import Bundle
from .watch import Deposit

_PIXELS = 15  # of a bead; OpenCV draws a line of 13 about 15.4 wide
_SHIFT = 4  # fractional bits of OpenCV's coordinates

Image = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Row:
    """Areas of one material in one layer, mm^2.

    Attributes
    ----------
    layer, material, pass_ : int
        As in `Toolpath`.
    region : float
        What should be filled.
    uncovered, outside : float
        Region that no bead reaches, and bead that lies outside of the region.
    """

    layer: int
    material: int
    pass_: int
    region: float
    uncovered: float
    outside: float


def compare(bundle: Bundle, layers: Iterable[Layer], deposits: Iterable[Deposit]) -> Iterator[Row]:
    """Compare every deposit of every layer with its region.

    Parameters
    ----------
    bundle : Bundle
    layers : iterable of Layer
        In print order, with regions, of one copy.
    deposits : iterable of Deposit
        Of a simulation, in any order.
    """
    m, profile, copies = bundle.manifest, bundle.profile, np.array(bundle.manifest["copies"])
    found: dict[tuple[int, int], list[Paths]] = {}
    for d in deposits:
        found.setdefault((d.tool, round(d.z * 500)), []).append(d.laid)
    for layer in layers:
        bottom = layer.z - m["slice_position"] * m["thickness"]
        events = [(ICE, i, (i + 1) / m["part_layers"]) for i in range(m["part_layers"])] + [(SCAFFOLD, 0, 1.0)]
        for material, pass_, share in events:
            z = round(bottom + share * m["thickness"] + profile.nozzles[material].standoff, 3)
            region = layer.scaffold if material == SCAFFOLD else layer.part
            key = round(z * 500)
            laid = [p for k in (key - 1, key, key + 1) for p in found.get((material, k), ())]
            if region is not None and (len(region) or laid):
                yield Row(layer.index, material, pass_, *_areas(region.repeated(copies), laid, m["widths"][material]))


def _areas(region: Paths, laid: list[Paths], width: float) -> tuple[float, float, float]:
    """Return the area of a region, and how much of it is bare and how much bead lies outside."""
    import cv2

    pixel = width / _PIXELS
    everything = np.concatenate([region.points, *(p.points for p in laid)])
    corner = everything.min(axis=0) - width
    size = np.ceil((everything.max(axis=0) + width - corner) / pixel).astype(int)
    shape: Image = np.zeros((size[1], size[0]), np.uint8)
    beads: Image = np.zeros_like(shape)
    loops = _fixed(region, corner, pixel)
    cv2.fillPoly(shape, loops, 1, cv2.LINE_8, _SHIFT)
    for paths in laid:
        cv2.polylines(beads, _fixed(paths, corner, pixel), False, 1, _PIXELS - 2, cv2.LINE_8, _SHIFT)
    kernel: Any = np.ones((3, 3), np.uint8)
    bare = cv2.countNonZero(cv2.subtract(cv2.erode(shape, kernel), beads))
    beyond = cv2.countNonZero(cv2.subtract(beads, cv2.dilate(shape, kernel)))
    return float(region.areas().sum()), bare * pixel**2, beyond * pixel**2


def _fixed(paths: Paths, corner: NDArray[np.float64], pixel: float) -> list[NDArray[np.int32]]:
    fixed = np.rint((paths.points - corner) / pixel * (1 << _SHIFT)).astype(np.int32)
    return [line for line in np.split(fixed, paths.offsets[1:-1].astype(np.int64)) if len(line)]
