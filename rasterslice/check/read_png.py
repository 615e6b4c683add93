"""A stack of PNG pictures, one a layer, white where there is material."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import ModelError
from .form import OURS, UNSIZED, Floats, TheirLayer, Theirs, load, numbered

_MOST_PIXELS = 1 << 26
_METRES = 1  # unit of the chunk pHYs


def read_folder(files: list[Path]) -> Theirs:
    """Read pictures in the order of the numbers in their names.

    The size of a pixel is what the chunk pHYs says; without it coordinates are pixels, and the alignment scales them.

    Raises
    ------
    ModelError
        No PNG, pictures of different sizes, or too large ones.
    """
    materials = {m: [p for p in files if p.name.startswith(f"{m}_")] for m in ("part", "scaffold")}
    if not (materials["part"] and len(materials["part"]) + len(materials["scaffold"]) == len(files)):
        materials = {"part": files, "scaffold": []}  # any other program's
    layers: list[TheirLayer] = []
    reader, corner = _Pictures(), np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
    for path, count in zip(materials["part"], numbered(materials["part"]), strict=True):
        loops, middle = reader.loops(path), corner * (reader.pixel or 1.0)
        layers.append(TheirLayer(count, path.name, loops, declared=[0] * len(loops), middle=middle))
    beside = dict(zip(numbered(materials["scaffold"]), materials["scaffold"], strict=True))
    for k in layers:
        if k.z in beside:
            k.scaffold.extend(reader.loops(beside[k.z]))
    unit = reader.pixel or 1.0
    precision, scaffold = (0.75 if reader.binary else 0.35) * unit, bool(beside)
    pixel, grain = (unit, 0.0) if reader.binary else (0.0, unit)
    own = all(OURS.fullmatch(path.stem) for path in files)
    return Theirs(
        "PNG stack", layers, "number", precision, scaffold, any_mirror=True, any_turn=not own,
        notes=[] if reader.pixel else [UNSIZED], unsized=not reader.pixel, pixel=pixel, grain=grain,
    )  # fmt: skip


class _Pictures:
    """Contours of pictures that must all have one size."""

    def __init__(self) -> None:
        self.first, self.size, self.binary = "", (0, 0), True
        self.pixel: float | None = None

    def loops(self, path: Path) -> list[Floats]:
        import cv2

        data = load(path)
        found, scale = _header(data, path)
        if not self.first:
            self.first, self.size, self.pixel = path.name, found, scale
        elif found != self.size or scale != self.pixel:
            raise ModelError(f"{path}: {found[0]} x {found[1]} px, unlike {self.first}; write all of one size")
        if not _ends(data):  # the decoder would say so on its own
            raise ModelError(f"{path}: a damaged picture: the file ends before its last chunk; write it anew")
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
        if image is None or image.shape != (found[1], found[0]):
            raise ModelError(f"{path}: a damaged picture; write it anew")
        self.binary &= not bool(np.any((image > 8) & (image < 247)))
        return [p * (self.pixel or 1.0) for p in outlines(image.astype(np.float32) / 255.0, 0.5, 0.0)]


def outlines(image: NDArray[np.floating], level: float, outside: float) -> list[Floats]:
    """Return the closed contours of a picture, px from the centre of its lower left pixel.

    Parameters
    ----------
    image : (H, W) float
        The upper row first.
    level : float
        Of the contours; solid is what lies above it.
    outside : float
        What lies beyond the picture.
    """
    from skimage.measure import find_contours

    framed = np.pad(image[::-1], 1, constant_values=outside)
    contours = find_contours(framed, level)  # type: ignore[no-untyped-call]
    return [c[:-1, ::-1] - 1.0 for c in contours if len(c) > 3]


def _ends(data: bytes) -> bool:
    """Whether all chunks up to the last one are there."""
    at = 8
    while at + 12 <= len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        at += 12 + length
        if kind == b"IEND":
            break
    return at <= len(data) and data[at - 8 : at - 4] == b"IEND"


def _header(data: bytes, path: Path) -> tuple[tuple[int, int], float | None]:
    """Return width and height, px, and the size of a pixel, mm, before anything is decoded."""
    if data[:8] != b"\x89PNG\r\n\x1a\n" or data[12:16] != b"IHDR" or len(data) < 33:
        raise ModelError(f"{path}: no PNG picture; write it anew")
    width, height = struct.unpack(">2I", data[16:24])
    if not 0 < width * height <= _MOST_PIXELS:
        limit = f"at most {_MOST_PIXELS} pixels are read"
        raise ModelError(f"{path}: {width} x {height} px; {limit}. Write smaller pictures")
    at = 33
    while at + 12 <= len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        if kind == b"pHYs" and length == 9 and at + 17 <= len(data):
            x, y, unit = struct.unpack(">2IB", data[at + 8 : at + 17])
            if unit == _METRES and x == y and 1000 <= x <= 10_000_000:
                return (width, height), 1000.0 / x
        if kind == b"IDAT":
            break
        at += 12 + length
    return (width, height), None
