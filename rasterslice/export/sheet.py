"""Contact sheet: evenly spread layers on one PNG page, each with its number, height and areas."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..paths import Layer, Paths
from .draw import BEAD, CARD, DARK, GREY, LINE, PAGE, RED, RULE, TINT, area, bgr, text
from .format import Context

COUNT = 24
#: All lengths below are pixels of the finished page; it is drawn SCALE times larger and shrunk, which smooths lines.
SCALE = 2
WIDTH, MARGIN, GAP, PAD, HEADER, LABEL = 2000, 48, 20, 14, 104, 74
SHIFT = 4  # fractional bits of OpenCV's coordinates

Image = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class _Sheet:
    """Where the cards lie on the page, and what part of the frame each shows."""

    columns: int
    rows: int
    card: tuple[int, int]
    low: NDArray[np.float64]
    zoom: float  # page pixels per mm
    picture: tuple[float, float]

    @property
    def size(self) -> tuple[int, int]:
        rows = self.rows * (self.card[1] + GAP) - GAP
        return WIDTH, 2 * MARGIN + HEADER + rows


def write(layers: Sequence[Layer], path: Path, context: Context) -> None:
    """Write the contact sheet as PNG."""
    import cv2  # takes some tenths of a second to import

    picked = [layers[i] for i in spread(len(layers))]
    sheet = _lay_out(picked, context)
    width, height = sheet.size
    image: Image = np.full((height * SCALE, width * SCALE, 3), bgr(PAGE), np.uint8)
    for n, layer in enumerate(picked):
        _card(image, sheet, n, layer)
    image = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    _title(image, len(layers), len(picked), context)
    for n, layer in enumerate(picked):
        _label(image, sheet, n, layer)
    path.write_bytes(cv2.imencode(".png", image)[1].tobytes())


def spread(n: int, count: int = COUNT) -> list[int]:
    """Return up to `count` evenly spread indices of n layers, each from the middle of its share."""
    count = min(n, count)
    return [(2 * i + 1) * n // (2 * count) for i in range(count)]


def _lay_out(layers: list[Layer], context: Context) -> _Sheet:
    """Choose as many columns as give a page about 1.4 times as wide as high."""
    low, high = _box(layers, context.grid.to_mm([(0, 0), (context.grid.width - 1, context.grid.height - 1)]))
    wide, tall = (high - low).tolist()
    n = max(len(layers), 1)

    def shape(columns: int) -> tuple[int, int, float]:
        card_width = (WIDTH - 2 * MARGIN - (columns - 1) * GAP) // columns
        zoom = min((card_width - 2 * PAD) / wide, 1.5 * card_width / tall)
        return card_width, math.ceil(zoom * tall) + 2 * PAD + LABEL, zoom

    def page_height(columns: int) -> int:
        return 2 * MARGIN + HEADER + math.ceil(n / columns) * (shape(columns)[1] + GAP)

    columns = min(range(min(n, 3), min(n, 8) + 1), key=lambda c: abs(math.log(1.4 * page_height(c) / WIDTH)))
    card_width, card_height, zoom = shape(columns)
    picture = (card_width - 2 * PAD, card_height - 2 * PAD - LABEL)
    centre = (low + high) / 2
    corner = centre - np.array(picture) / (2 * zoom)
    return _Sheet(columns, math.ceil(n / columns), (card_width, card_height), corner, zoom, picture)


def _box(layers: list[Layer], grid_box: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners of all that is drawn, else those of the grid."""
    sets = [p for layer in layers for p in (layer.part, layer.scaffold) if p is not None and len(p.points)]
    if not sets:
        return grid_box[0], grid_box[1]
    low = np.min([p.points.min(axis=0) for p in sets], axis=0)
    high = np.max([p.points.max(axis=0) for p in sets], axis=0)
    return low, np.maximum(high, low + 1e-3)


def _corner(sheet: _Sheet, n: int) -> tuple[int, int]:
    row, column = divmod(n, sheet.columns)
    return MARGIN + column * (sheet.card[0] + GAP), MARGIN + HEADER + row * (sheet.card[1] + GAP)


def _card(image: Image, sheet: _Sheet, n: int, layer: Layer) -> None:
    import cv2

    x, y = _corner(sheet, n)
    corner, end = (x * SCALE, y * SCALE), ((x + sheet.card[0]) * SCALE - 1, (y + sheet.card[1]) * SCALE - 1)
    cv2.rectangle(image, corner, end, bgr(CARD), cv2.FILLED)
    cv2.rectangle(image, corner, end, bgr(RULE), SCALE)
    origin = np.array([x + PAD, y + PAD + sheet.picture[1]], np.float64)

    def pixels(paths: Paths) -> list[NDArray[np.int32]]:
        xy = (paths.points - sheet.low) * sheet.zoom * (1, -1) + origin  # y turns around here
        fixed = np.rint((xy * SCALE - 0.5) * (1 << SHIFT)).astype(np.int32)
        return [loop for loop in np.split(fixed, paths.offsets[1:-1]) if len(loop)]

    for name in ("scaffold", "part"):
        region, boundary, fill = (getattr(layer, name + ending) for ending in ("", "_boundary", "_fill"))
        if region is not None and len(region):
            cv2.fillPoly(image, pixels(region), bgr(TINT[name]), cv2.LINE_AA, SHIFT)  # even-odd
        cv2.polylines(image, pixels(fill), False, bgr(BEAD[name]), 1, cv2.LINE_AA, SHIFT)
        cv2.polylines(image, pixels(boundary), True, bgr(LINE[name]), 1, cv2.LINE_AA, SHIFT)


def _label(image: Image, sheet: _Sheet, n: int, layer: Layer) -> None:
    x, y = _corner(sheet, n)
    image = image[:, : x + sheet.card[0] - PAD // 2]  # text that is too long is cut at the edge of its card
    x, y = x + PAD, y + sheet.card[1]
    end = text(image, f"{layer.index}", (x, y - 58), 19, DARK, 600)
    end = text(image, f"z {layer.z:.2f} mm", (end + 10, y - 58), 15, GREY)
    if layer.stats.get("flags"):
        text(image, str(layer.stats["flags"]), (end + 10, y - 58), 15, RED)
    text(image, f"part {area(layer.stats, 'part_area')}", (x, y - 36), 15, LINE["part"])
    text(image, f"scaffold {area(layer.stats, 'scaffold_area')}", (x, y - 15), 15, LINE["scaffold"])


def _title(image: Image, n_layers: int, shown: int, context: Context) -> None:
    text(image, context.stem, (MARGIN, MARGIN + 32), 36, DARK, 600)
    what = (
        f"{n_layers} layers of {context.thickness:g} mm, {shown} shown   \N{MIDDLE DOT}   "
        f"paths {context.part_width:g} mm (part), {context.support_width:g} mm (scaffold)   \N{MIDDLE DOT}   "
        f"pixel {context.grid.pitch:g} mm"
    )
    text(image, what, (MARGIN, MARGIN + 70), 19, GREY)
