"""The picture of a preview: the part as its layers build it, area over height, and a row of slices."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..export.draw import BEAD, CARD, DARK, GREY, LINE, PAGE, RULE, TINT, bgr, text
from ..export.format import Context
from ..export.sheet import spread
from ..paths import Layer, Paths
from .shade import depths, shade

WIDTH, HEIGHT, MARGIN, GAP, HEADER = 2000, 1500, 48, 20, 96
PLOT, STRIP = 560, 300  # width of the plot, height of the row of slices
SLICES, TURN, SHIFT = 8, -0.5, 4
SHADOW, SHINE = "#123b57", "#eef7fc"  # darkest and lightest of the shaded part

Image = NDArray[np.uint8]
Box = tuple[int, int, int, int]  # x, y, width, height


def picture(layers: Sequence[Layer], context: Context, facts: str) -> bytes:
    """Return the picture as PNG.

    Parameters
    ----------
    layers : sequence of Layer
        In print order; regions are not needed.
    context : Context
    facts : str
        The line below the name.
    """
    import cv2

    image: Image = np.full((HEIGHT, WIDTH, 3), bgr(PAGE), np.uint8)
    text(image, context.stem, (MARGIN, MARGIN + 28), 36, DARK, 600)
    text(image, facts, (MARGIN, MARGIN + 66), 19, GREY)
    top, tall = MARGIN + HEADER, HEIGHT - 2 * MARGIN - HEADER - GAP - STRIP
    wide = WIDTH - 2 * MARGIN - GAP - PLOT
    for box in ((MARGIN, top, wide, tall), (MARGIN + wide + GAP, top, PLOT, tall)):
        _card(image, box)
    _shaded(image, (MARGIN, top, wide, tall), layers, context)
    _plot(image, (MARGIN + wide + GAP, top, PLOT, tall), layers, context)
    width = (WIDTH - 2 * MARGIN - (SLICES - 1) * GAP) // SLICES
    for n, i in enumerate(spread(len(layers), SLICES)):
        box = (MARGIN + n * (width + GAP), HEIGHT - MARGIN - STRIP, width, STRIP)
        _card(image, box)
        _slice(image, box, layers[i], context)
    return bytes(cv2.imencode(".png", image)[1].tobytes())


def _card(image: Image, box: Box) -> None:
    import cv2

    x, y, w, h = box
    cv2.rectangle(image, (x, y), (x + w - 1, y + h - 1), bgr(CARD), cv2.FILLED)
    cv2.rectangle(image, (x, y), (x + w - 1, y + h - 1), bgr(RULE), 1)


def _shaded(image: Image, box: Box, layers: Sequence[Layer], context: Context) -> None:
    """Draw the part in front of the shadow of its scaffold; from behind too, where there is room."""
    x, y, w, h = box[0] + 30, box[1] + 30, box[2] - 60, box[3] - 60
    sets = {name: [getattr(layer, f"{name}_boundary") for layer in layers] for name in ("part", "scaffold")}
    points = np.concatenate([p.points for paths in sets.values() for p in paths] or [np.empty((0, 2))])
    if not len(points):
        text(image, "no layer holds a path", (x, y + 30), 19, GREY)
        return
    across = points @ (np.cos(TURN), -np.sin(TURN))
    reach = float(np.ptp(across)) / 2 + context.part_width
    middle, tall = (float(across.min()) + float(across.max())) / 2, len(layers) * context.thickness
    views = 2 if w / (4.2 * reach) > h / tall else 1
    zoom = min(w / (2 * reach * views), h / tall)
    columns, rows = max(int(2 * reach * zoom), 1), max(int(tall * zoom), 1)

    def draw(n: int) -> None:
        left = x + (2 * n + 1) * w // (2 * views) - columns // 2
        low = (middle if n == 0 else -middle) - reach  # from behind, left is right
        frame = (TURN + n * np.pi, columns, low, 1 / zoom)
        _view(image[y + h - rows : y + h, left : left + columns], sets, context, frame)

    with ThreadPoolExecutor(views) as pool:
        list(pool.map(draw, range(views)))


def _view(area: Image, sets: dict[str, list[Paths]], context: Context, frame: tuple[float, int, float, float]) -> None:
    """Draw one view; `frame` is the turn, and the columns as `depths` takes them."""
    import cv2

    rows, columns = area.shape[:2]

    def drawn(name: str) -> NDArray[np.float64]:
        return depths(sets[name], *frame, context.width(name) / 2)

    def enlarged(layered: NDArray[Any]) -> NDArray[np.float32]:
        way = cv2.INTER_LINEAR if rows > len(layered) else cv2.INTER_AREA
        flipped = np.ascontiguousarray(layered[::-1], np.float32)
        return np.asarray(cv2.resize(flipped, (columns, rows), interpolation=way), np.float32)

    behind = enlarged(np.isfinite(drawn("scaffold")))[..., None] * np.float32(0.75)
    picture = area + (np.array(bgr(TINT["scaffold"]), np.float32) - area) * behind
    part = drawn("part")
    there = enlarged(np.isfinite(part))
    tone = enlarged(shade(part, (context.thickness, frame[3]))) / np.maximum(there, np.float32(1e-6))
    dark, light = np.array(bgr(SHADOW), np.float32), np.array(bgr(SHINE), np.float32)
    colour = dark + (light - dark) * np.clip(tone, 0, 1)[..., None]
    area[:] = picture + (colour - picture) * there[..., None]


def _plot(image: Image, box: Box, layers: Sequence[Layer], context: Context) -> None:
    """Draw area over height: part, and beside it the scaffold."""
    import cv2

    x, y, w, h = box[0] + 84, box[1] + 30, box[2] - 124, box[3] - 110
    part, scaffold = (np.array([_value(layer, f"{n}_area") for layer in layers]) for n in ("part", "scaffold"))
    most, high = float((part + scaffold).max(initial=1e-9)), max(len(layers) * context.thickness, 1e-9)
    level = y + h - (np.arange(len(layers)) + 0.5) * context.thickness / high * h

    def band(left: Any, right: Any, colour: str) -> None:
        edge = np.concatenate([np.column_stack([right, level]), np.column_stack([left, level])[::-1]])
        if len(edge):
            cv2.fillPoly(image, [np.rint(edge * (1 << SHIFT)).astype(np.int32)], bgr(colour), cv2.LINE_AA, SHIFT)

    step = nice(high / 6)
    for n in range(int(high / step) + 1):
        at = round(y + h - n * step / high * h)
        cv2.line(image, (x, at), (x + w, at), bgr(RULE), 1)
        text(image, f"{n * step:g}", (box[0] + 18, at + 6), 15, GREY)
    edges = x + part / most * w, x + (part + scaffold) / most * w
    band(edges[0], edges[1], BEAD["scaffold"])
    band(np.full(len(part), float(x)), edges[0], BEAD["part"])
    step = nice(most / 4)
    for n in range(int(most / step) + 1):
        at = round(x + n * step / most * w)
        cv2.line(image, (at, y + h), (at, y + h + 5), bgr(GREY), 1)
        text(image, f"{n * step:g}", (at - 8, y + h + 24), 15, GREY)
    square = "mm\N{SUPERSCRIPT TWO}"
    end = text(
        image,
        f"part {short(part.sum() * context.thickness / 1000)} cm\N{SUPERSCRIPT THREE}",
        (x, y + h + 58),
        17,
        LINE["part"],
    )
    volume = scaffold.sum() * context.thickness / 1000
    text(image, f"scaffold {short(volume)} cm\N{SUPERSCRIPT THREE}", (end + 16, y + h + 58), 17, LINE["scaffold"])
    text(image, f"height, mm; area, {square}", (box[0] + 18, box[1] + 22), 15, GREY)


def _slice(image: Image, box: Box, layer: Layer, context: Context) -> None:
    """Draw the beads of a layer."""
    import cv2

    grid = context.grid
    x, y, w, h = box[0] + 12, box[1] + 12, box[2] - 24, box[3] - 62
    zoom = min(w / (grid.width * grid.pitch), h / (grid.height * grid.pitch))
    centre = np.array([grid.x0 + grid.width * grid.pitch / 2, grid.y0 + grid.height * grid.pitch / 2])

    def pixels(paths: Paths) -> list[NDArray[np.int32]]:
        xy = (paths.points - centre) * zoom * (1, -1) + (x + w / 2, y + h / 2)  # y turns around here
        return [p for p in np.split(np.rint(xy * (1 << SHIFT)).astype(np.int32), paths.offsets[1:-1]) if len(p)]

    for name in ("scaffold", "part"):
        boundary, fill = pixels(getattr(layer, f"{name}_boundary")), pixels(getattr(layer, f"{name}_fill"))
        if boundary:
            cv2.fillPoly(image, boundary, bgr(TINT[name]), cv2.LINE_AA, SHIFT)
        cv2.polylines(image, fill, False, bgr(BEAD[name]), 1, cv2.LINE_AA, SHIFT)
        cv2.polylines(image, boundary, True, bgr(LINE[name]), 1, cv2.LINE_AA, SHIFT)
    end = text(image, f"{layer.index}", (x, box[1] + box[3] - 32), 17, DARK, 600)
    text(image, f"z {short(layer.z)} mm", (end + 8, box[1] + box[3] - 32), 15, GREY)
    area = f"{short(_value(layer, 'part_area'))} mm\N{SUPERSCRIPT TWO}"
    text(image, area, (x, box[1] + box[3] - 12), 15, LINE["part"])


def nice(length: float, steps: tuple[float, ...] = (1, 2, 5, 10)) -> float:
    """Return the smallest of some steps (the last one 10) times a power of ten that is not below a length."""
    power = 10.0 ** math.floor(math.log10(length))
    return next(float(f"{m * power:.6g}") for m in steps if m * power >= length * (1 - 1e-9))


def short(value: float) -> str:
    """Return a number with one decimal, of small ones three digits, of large ones none after the point."""
    if abs(value) >= 1000:
        return f"{value:.0f}"
    return f"{value:.1f}" if abs(value) >= 10 or not value else f"{value:.3g}"


def _value(layer: Layer, name: str) -> float:
    value = layer.stats.get(name)
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else 0.0
