"""What a TIFF says of itself in its description: OME, which is XML, or ImageJ's lines."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from ..errors import ModelError
from .form import strict
from .xmltext import parse

_MM = {"m": 1000.0, "cm": 10.0, "mm": 1.0, "µm": 1e-3, "um": 1e-3, "micron": 1e-3, "\\u00b5m": 1e-3, "nm": 1e-6,
       "inch": 25.4, "in": 25.4}  # fmt: skip
_LINE = re.compile(r"(?m)^(images|channels|slices|frames|spacing|unit)=(.{1,40})$")
_MOST_DEPTH = 32


@dataclass(slots=True)
class About:
    """What a stack says of itself.

    Attributes
    ----------
    channels : list of str
        Their names; one where nothing is said.
    count : int
        Pictures in all; 0 where it does not say.
    inner : bool
        Whether the channels of a layer follow each other, and not the layers of a channel.
    pixel : tuple of float
        Size along x and y, mm; 0 where it is not said.
    step : float
        Distance of layers, mm; 0 where it is not said.
    unit : float
        Of the resolution, mm; 0 where its tag tells.
    """

    channels: list[str] = field(default_factory=lambda: [""])
    count: int = 0
    inner: bool = True
    pixel: tuple[float, float] = (0.0, 0.0)
    step: float = 0.0
    unit: float = 0.0


def about_stack(text: str, path: Path) -> About:
    """Return what a description says.

    Raises
    ------
    ModelError
        ``file: message``: no sound XML, entities, several images or times, pictures out of order.
    """
    if text.startswith("ImageJ="):
        return _imagej(text, path)
    return _ome(text, path) if text.lstrip("\ufeff \t\r\n").startswith("<") and "<OME" in text else About()


def _imagej(text: str, path: Path) -> About:
    said = dict(_LINE.findall(text))
    channels, slices, frames = (_whole(said.get(name), path, name) for name in ("channels", "slices", "frames"))
    if slices > 1 and frames > 1:
        raise ModelError(f"{path}: {slices} slices at {frames} times; write one time")
    if channels > 64:
        raise ModelError(f"{path}: {channels} channels; write one")
    count = _whole(said["images"], path, "images") if "images" in said else channels * slices * frames
    unit = _MM.get(said.get("unit", "").strip().lower(), 0.0)
    step = unit * _length(said.get("spacing"))
    return About([f"channel {i}" for i in range(channels)], count, True, step=step, unit=unit)


class _Ome:
    """Collects what matters while expat reads."""

    def __init__(self, path: Path) -> None:
        self.path, self.depth = path, 0
        self.pixels: list[dict[str, str]] = []
        self.names: list[str] = []
        self.places: list[dict[str, str]] = []
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end

    def start(self, name: str, attributes: dict[str, str]) -> None:
        self.depth += 1
        if self.depth > _MOST_DEPTH:
            raise ModelError(f"{self.path}: the description is nested deeper than {_MOST_DEPTH}; write it anew")
        if name == "Pixels":
            self.pixels.append(attributes)
        elif name == "Channel":
            self.names.append(attributes.get("Name", ""))
        elif name == "TiffData":
            self.places.append(attributes)

    def end(self, name: str) -> None:
        self.depth -= 1


def _ome(text: str, path: Path) -> About:
    reader = _Ome(path)
    parse(reader.parser, text.encode("utf-8", "replace"), path, "description ")
    if len(reader.pixels) != 1:
        raise ModelError(f"{path}: {len(reader.pixels)} images in one file; write one")
    said = reader.pixels[0]
    channels, slices, times = (_whole(said.get(name), path, name) for name in ("SizeC", "SizeZ", "SizeT"))
    if times > 1 or channels > 64:
        raise ModelError(f"{path}: {channels} channels at {times} times; write one, or part and scaffold, at one time")
    order = said.get("DimensionOrder", "XYCZT")
    inner = "Z" not in order or "C" not in order or order.index("C") < order.index("Z")
    for place in reader.places:
        z, c, at = (_whole(place.get(name, "0"), path, name, 0) for name in ("FirstZ", "FirstC", "IFD"))
        if at != (z * channels + c if inner else c * slices + z):
            raise ModelError(f"{path}: picture {at} is out of order; write layers upwards, in the order of the file")
    names = reader.names if len(reader.names) == channels else [f"channel {i}" for i in range(channels)]
    x, y, z_step = (_length(said.get(f"PhysicalSize{a}")) * _unit(said.get(f"PhysicalSize{a}Unit")) for a in "XYZ")
    return About(names, channels * slices, inner, (x, y), z_step)


def _unit(text: str | None) -> float:
    return _MM.get((text or "µm").strip(), 0.0)


def _length(text: str | None) -> float:
    """Return a length above 0, else 0."""
    try:
        value = strict(text or "0")
    except ValueError:
        return 0.0
    return value if 0 < value < 1e6 else 0.0


def _whole(text: str | None, path: Path, what: str, least: int = 1) -> int:
    if text is None:
        return 1
    word = text.strip()
    if not (word.isascii() and word.isdigit() and len(word) < 10 and int(word) >= least):
        raise ModelError(f"{path}: {what} must be a whole number, got {word[:30]!r}; write it anew")
    return int(word)
