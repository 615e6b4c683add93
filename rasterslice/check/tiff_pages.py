"""The pictures of a TIFF, one after the other, with the few tags that matter.

Directories and samples are read here and not by tifffile, which gives fewer pictures and no error where the chain of
directories is damaged, and unpacks a strip to whatever it contains. What a directory promises is held against limits
and against the bytes of the file before a picture is made; a strip is unpacked up to the size that it must have.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ModelError

MOST_PIXELS = 1 << 26  # of one picture
MOST_PAGES = 200_000
_MOST_TAGS = 500
_MOST_TEXT = 64 << 20  # bytes of the description
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}
_WHOLE = {1: "u1", 3: "u2", 4: "u4", 13: "u4", 16: "u8", 18: "u8"}  # kinds of whole numbers; 5 are two of them
_MOST_STRIPS = 1 << 20  # of one picture
(_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _PHOTOMETRIC, _FILL_ORDER, _DESCRIPTION, _OFFSETS, _SAMPLES, _ROWS, _COUNTS, _X,
 _Y, _UNIT, _SOFTWARE, _PREDICTOR, _TILE_X, _TILE_Y, _TILES, _TILE_COUNTS, _FORMAT, _DEPTH) = (
    256, 257, 258, 259, 262, 266, 270, 273, 277, 278, 279, 282, 283, 296, 305, 317, 322, 323, 324, 325, 339, 32997,
)  # fmt: skip
_DEFLATE, _PLAIN = (8, 32946), 1
_KNOWN = {1: "u", 2: "i", 3: "f"}


@dataclass(slots=True)
class Page:
    """One picture, not yet unpacked.

    Attributes
    ----------
    number : int
        From 0.
    width, height : int
        Pixels.
    dtype : numpy.dtype
        Of its samples; bits are given as bytes of 0 and 1.
    description, software : str
    resolution : tuple of float
        Pixels for a unit along x and y; 0 where it is not said.
    unit : int
        1 none, 2 inch, 3 centimetre.
    """

    number: int
    width: int
    height: int
    dtype: np.dtype[Any]
    description: str
    software: str
    resolution: tuple[float, float]
    unit: int
    _path: Path
    _data: bytes = field(repr=False)
    _bits: int
    _packed: bool
    _tile: tuple[int, int]  # height and width of a strip or tile
    _offsets: list[int]
    _counts: list[int]

    @property
    def stored(self) -> int:
        """Bytes of its samples in the file."""
        return sum(self._counts)

    def image(self) -> NDArray[Any]:
        """Return the samples, the upper row first."""
        high, wide = self._tile
        across = math.ceil(self.width / wide)
        picture = np.zeros((self.height, self.width), self.dtype)
        for i, (start, count) in enumerate(zip(self._offsets, self._counts, strict=True)):
            y, x = i // across * high, i % across * wide
            rows = min(high, self.height - y) if wide == self.width else high  # the last strip is cut short
            samples = self._samples(start, count, rows, wide, f"strip {i}")
            picture[y : y + high, x : x + wide] = samples[: self.height - y, : self.width - x]
        return picture

    def _samples(self, start: int, count: int, rows: int, wide: int, what: str) -> NDArray[Any]:
        across = math.ceil(wide * self._bits / 8)
        data, due = self._data[start : start + count], rows * across
        if self._packed:
            try:
                data = zlib.decompressobj().decompress(data, due)
            except zlib.error as error:
                raise self.wrong(f"{what}: {error}") from None
        if len(data) < due:
            raise self.wrong(f"{what} holds {len(data)} bytes of {due}")
        raw = np.frombuffer(data, np.uint8, due).reshape(rows, across)
        if self._bits == 1:
            return np.unpackbits(raw, axis=1, count=wide)
        return raw.view(self.dtype)

    def wrong(self, what: str, remedy: str = "write it anew") -> ModelError:
        """Return the error of this picture."""
        return ModelError(f"{self._path}: picture {self.number}: {what}; {remedy}")


def read_pages(data: bytes, path: Path) -> Iterator[Page]:
    """Give the pictures of a TIFF, or of a BigTIFF.

    Raises
    ------
    ModelError
        ``file: picture N: message``: a damaged chain of directories, samples that are not in the file, too many pixels,
        and what is not read: colours, packing other than deflate, other numbers than plain ones.
    """
    order = {b"II": "<", b"MM": ">"}.get(data[:2], "")
    version = struct.unpack_from(order + "H", data, 2)[0] if order and len(data) >= 4 else 0
    if version not in (42, 43):
        raise ModelError(f"{path}: no TIFF; write it anew")
    big = version == 43
    place = "Q" if big else "I"
    file = _File(data, path, order, big)
    at, number, seen, left = file.unpack(place, 8 if big else 4, 0)[0], 0, set[int](), len(data)
    while at:
        if number >= MOST_PAGES or at in seen:
            raise ModelError(f"{path}: picture {number}: the chain of pictures does not end; write it anew")
        seen.add(at)
        tags, at = file.directory(at, number)
        page = _page(tags, file, number)
        left -= page.stored
        if left < 0:
            raise page.wrong("pictures share their samples")
        yield page
        number += 1


@dataclass(slots=True)
class _File:
    """Bytes, and how numbers stand in them."""

    data: bytes
    path: Path
    order: str
    big: bool

    def unpack(self, form: str, at: int, number: int) -> tuple[Any, ...]:
        form = self.order + form
        if at < 0 or at + struct.calcsize(form) > len(self.data):
            raise ModelError(f"{self.path}: picture {number}: the file ends before byte {at}; write it anew")
        return struct.unpack_from(form, self.data, at)

    def directory(self, at: int, number: int) -> tuple[dict[int, tuple[int, int, int]], int]:
        """Return kind, count and place of the values of each tag, and where the next directory is."""
        head, entry, room, place = ("Q", 20, 8, "Q") if self.big else ("H", 12, 4, "I")
        count = self.unpack(head, at, number)[0]
        if not 0 < count <= _MOST_TAGS:
            what = f"{count} tags; 1 to {_MOST_TAGS} are read"
            raise ModelError(f"{self.path}: picture {number}: {what}. Write it anew")
        first, tags = at + struct.calcsize("<" + head), {}
        for i in range(count):
            where = first + i * entry
            tag, kind, values = self.unpack("HHQ" if self.big else "HHI", where, number)
            size, inside = _SIZES.get(kind, 1) * values, where + entry - room
            tags[tag] = (kind, values, inside if size <= room else self.unpack(place, inside, number)[0])
        return tags, self.unpack(place, first + count * entry, number)[0]


class _Tags:
    """The values of the tags of one picture."""

    def __init__(self, tags: dict[int, tuple[int, int, int]], file: _File, number: int) -> None:
        self.tags, self.file, self.number = tags, file, number

    def wrong(self, what: str, remedy: str = "write it anew") -> ModelError:
        return ModelError(f"{self.file.path}: picture {self.number}: {what}; {remedy}")

    def all(self, tag: int, most: int, kinds: dict[int, str] = _WHOLE) -> list[int]:
        """Return the whole numbers of a tag, when no more are promised than may be and the file has."""
        kind, count, at = self.tags.get(tag, (4, 0, 0))
        if kind not in kinds or count > most:
            raise self.wrong(f"tag {tag} holds {count} values of kind {kind}, at most {most} are read")
        if at + count * _SIZES[kind] > len(self.file.data):
            raise self.wrong(f"tag {tag} lies beyond the end of the file")
        dtype = np.dtype(self.file.order + kinds[kind])
        values: list[int] = np.frombuffer(self.file.data, dtype, count * _SIZES[kind] // dtype.itemsize, at).tolist()
        return values

    def one(self, tag: int, usual: int) -> int:
        values = self.all(tag, 16)
        if any(v != values[0] for v in values):
            raise self.wrong(f"tag {tag} holds {values[:4]}, one number is read")
        return values[0] if values else usual

    def ratio(self, tag: int) -> float:
        values = self.all(tag, 1, {4: "u4", 5: "u4"})
        return values[0] / values[1] if len(values) == 2 and values[1] else 0.0

    def text(self, tag: int) -> str:
        kind, count, at = self.tags.get(tag, (2, 0, 0))
        if not count:
            return ""
        if kind in (1, 2, 7) and count <= _MOST_TEXT and at + count > len(self.file.data):
            raise self.wrong(f"the file ends before byte {at + count}, within the text of tag {tag}")
        if count > _MOST_TEXT or kind not in (1, 2, 7):
            raise self.wrong(f"tag {tag} is no text")
        return self.file.data[at : at + count].rstrip(b"\0").decode("utf-8", "replace")


def _page(found: dict[int, tuple[int, int, int]], file: _File, number: int) -> Page:
    tags = _Tags(found, file, number)
    width, height = tags.one(_WIDTH, 0), tags.one(_HEIGHT, 0)
    if not (width > 0 and height > 0 and width * height <= MOST_PIXELS):
        raise tags.wrong(f"{width} x {height} px; at most {MOST_PIXELS} pixels are read", "write smaller pictures")
    packing = tags.one(_COMPRESSION, _PLAIN)
    if packing not in (_PLAIN, *_DEFLATE) or tags.one(_PREDICTOR, 1) != 1:
        raise tags.wrong(f"packing {packing} or its predictor is not built yet", "write it plain, or by deflate")
    if tags.one(_SAMPLES, 1) != 1 or tags.one(_PHOTOMETRIC, 1) != 1 or tags.one(_DEPTH, 1) != 1:
        raise tags.wrong("colours, or white that is 0, are not built yet", "write grey, black 0")
    bits, form = tags.one(_BITS, 1), _KNOWN.get(tags.one(_FORMAT, 1), "")
    if (form, bits) not in {("u", 1), *((f, b) for f in "ui" for b in (8, 16, 32)), ("f", 32), ("f", 64)} or (
        bits == 1 and tags.one(_FILL_ORDER, 1) != 1
    ):
        raise tags.wrong(f"samples of {bits} bits of kind {form or 'unknown'} are not built yet", "write 8 bits")
    tiled = _TILES in found
    if tiled:
        tile = (tags.one(_TILE_Y, 0), tags.one(_TILE_X, 0))
    else:
        tile = (min(max(tags.one(_ROWS, height), 0), height), width)
    due = math.ceil(height / tile[0]) * math.ceil(width / tile[1]) if min(tile) > 0 else 0
    if not (0 < due <= _MOST_STRIPS and tile[0] * tile[1] <= MOST_PIXELS):
        raise tags.wrong(f"strips or tiles of {tile[1]} x {tile[0]} px", "write larger ones")
    offsets = tags.all(_TILES if tiled else _OFFSETS, due)
    counts = tags.all(_TILE_COUNTS if tiled else _COUNTS, due)
    if len(offsets) != due or len(counts) != due:
        raise tags.wrong(f"{len(offsets)} strips or tiles of {due}")
    if any(a + n > len(file.data) for a, n in zip(offsets, counts, strict=True)):
        raise tags.wrong("samples lie beyond the end of the file")
    dtype = np.dtype("u1" if bits == 1 else f"{file.order}{form}{bits // 8}")
    return Page(
        number, width, height, dtype, tags.text(_DESCRIPTION) if number == 0 else "", tags.text(_SOFTWARE),
        (tags.ratio(_X), tags.ratio(_Y)), tags.one(_UNIT, 2), file.path, file.data, bits, packing != _PLAIN, tile,
        offsets, counts,
    )  # fmt: skip
