"""A stack of pictures in one TIFF: shares of pixels that are solid, or distances, negative inside.

Size of a pixel, distance of layers and channels come from OME, from ImageJ, or from the resolution.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from ..errors import ModelError
from .form import UNSIZED, Floats, TheirLayer, Theirs, load
from .read_png import outlines
from .tiff_about import About, about_stack
from .tiff_pages import Page, read_pages

_TAG_MM = {2: 25.4, 3: 10.0}  # units of the resolution
_NAMES = ["part", "scaffold"]


def read(path: Path) -> Theirs:
    """Read a stack.

    Raises
    ------
    ModelError
        ``file: picture N: message``: as `tiff_pages.read_pages`; pictures of several sizes or kinds, fewer than are
        promised, several channels without names, numbers that are neither shares nor distances.
    """
    data = load(path)
    pages = list(read_pages(data, path))
    if not pages:
        raise ModelError(f"{path}: no picture was found; write it anew")
    first = pages[0]
    for page in pages:
        if (page.width, page.height, page.dtype) != (first.width, first.height, first.dtype):
            raise page.wrong(f"{page.width} x {page.height} px, unlike the first", "write all of one size and kind")
    about = about_stack(first.description, path)
    if about.count and about.count != len(pages):
        raise ModelError(f"{path}: promises {about.count} pictures and holds {len(pages)}; write it anew")
    if len(about.channels) > 1 and about.channels != _NAMES:
        said = f"{len(about.channels)} channels, {', '.join(about.channels)[:60]}"
        raise ModelError(f"{path}: {said}; write one, or two with the names part and scaffold")
    pixel = _pixel(about, first)
    stack = _Stack(pages, pixel or 1.0)
    part, scaffold = _channels(about, len(pages))
    ours = about.channels == _NAMES and first.software == "rasterslice"
    number = ours or not about.step
    layers = []
    for k, i in enumerate(part):
        loops = stack.loops(i)
        beside = stack.loops(scaffold[k]) if scaffold else []
        z = float(k) if number else (k + 0.5) * about.step
        layers.append(TheirLayer(z, f"picture {i}", loops, beside, [0] * len(loops)))
    return Theirs(
        "TIFF of rasterslice" if ours else "TIFF stack", layers, "number" if number else "middle",
        (0.75 if stack.binary else 0.35) * (pixel or 1.0), scaffold=any(k.scaffold for k in layers), any_mirror=True,
        notes=[] if pixel else [UNSIZED], unsized=not pixel, step=about.step if number else 0.0,
        grain=0.0 if stack.binary else pixel or 1.0,
    )  # fmt: skip


def _channels(about: About, count: int) -> tuple[list[int], list[int]]:
    """Return the numbers of the pictures of the part and of the scaffold, upwards."""
    if len(about.channels) == 1:
        return list(range(count)), []
    if about.inner:
        return list(range(0, count, 2)), list(range(1, count, 2))
    return list(range(count // 2)), list(range(count // 2, count))


def _pixel(about: About, first: Page) -> float:
    """Return the size of a pixel, mm; 0 where it is not said."""
    unit = about.unit or _TAG_MM.get(first.unit, 0.0)
    x, y = about.pixel if min(about.pixel) > 0 else tuple(unit / r if r > 0 else 0.0 for r in first.resolution)
    if not (1e-4 <= x <= 10 and 1e-4 <= y <= 10):
        return 0.0
    if abs(x / y - 1) > 1e-3:
        raise first.wrong(f"pixels of {x:g} x {y:g} mm are not built yet", "write square ones")
    return x


class _Stack:
    """Contours of pictures, of which one kind of sample is told from the other by all of them."""

    def __init__(self, pages: list[Page], pixel: float) -> None:
        self.pages, self.pixel, self.binary = pages, pixel, True
        self.distances, self.full = False, 1.0
        low, high = 0.0, 0.0
        for page in pages:
            image = page.image()
            low, high = min(low, float(image.min())), max(high, float(image.max()))
            if not math.isfinite(low) or not math.isfinite(high):
                raise page.wrong("a sample is no finite number")
            if low < 0 or (page.dtype.kind == "u" and high > 1):
                break
        if low < 0:
            self.distances, self.binary = True, False
        elif high > 1:
            if pages[0].dtype.kind != "u":
                what = f"samples from 0 to {high:g} are neither shares of 1 nor distances, negative inside"
                raise pages[0].wrong(what, "write 8 bits, 0 to 255")
            self.full = float(np.iinfo(pages[0].dtype).max)

    def loops(self, number: int) -> list[Floats]:
        """Return the closed contours of one picture, mm."""
        image = self.pages[number].image().astype(np.float32)
        if not bool(np.isfinite(image).all()):
            raise self.pages[number].wrong("a sample is no finite number")
        if self.distances:
            found = outlines(-image, 0.0, -max(1.0, float(image.max())))
        else:
            image /= self.full
            self.binary &= not bool(np.any((image > 0.03) & (image < 0.97)))
            found = outlines(image, 0.5, 0.0)
        return [p * self.pixel for p in found]
