"""Which reader a file or folder needs."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import ModelError
from ..folder import MANIFEST, read_manifest
from ..paths import Layer, Paths
from ..spool import open_result
from . import read_cli, read_csv, read_dxf, read_fab, read_gcode, read_npz, read_png, read_svg, read_tiff
from .form import LIMIT_MM, OURS, OUTER, TheirLayer, Theirs, load, pack_beads

_SHOWN = 6  # names
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_DXF = re.compile(rb"(?:999\s*\n[^\n]*\n\s*)*0\s*\n\s*SECTION\b")


def read(path: Path) -> Theirs:
    """Read what another program, or a run of ours, wrote.

    Raises
    ------
    ModelError
        ``file:line: message``, in one line, for a damaged file or one of no known format.
    """
    return replace(_read(path), name=str(path))


def _read(path: Path) -> Theirs:
    """Read a file or folder."""
    if path.is_dir():
        return _folder(path)
    try:
        with path.open("rb") as file:
            head = file.read(4096)
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror}; check name and permissions") from error
    reader = _reader_of(head, path.suffix.lower())
    if reader is not None:
        return reader(path)
    load(path)  # says so when it is empty
    raise ModelError(
        f"{path}: no format that is known: it must be SVG, CLI, G-code, DXF, Fab@Home, NPZ, TIFF, polylines in CSV, or "
        "a folder of PNG or SVG"
    )


def _reader_of(head: bytes, suffix: str) -> Callable[[Path], Theirs] | None:
    """Return the reader for a file that begins so: by its content, and where that says nothing by its ending."""
    start = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    if b"$$HEADERSTART" in head:
        return read_cli.read
    if head.startswith(b"PK") or suffix == ".npz":
        return read_npz.read
    if head.startswith(_TIFF) or suffix in (".tif", ".tiff"):
        return read_tiff.read
    if b"<fabAtHomePrinter" in head or suffix == ".fab":
        return read_fab.read
    if start.startswith((b"<?xml", b"<svg", b"<!DOCTYPE")):
        return read_svg.read
    if _DXF.match(start) or head.startswith(b"AutoCAD Binary DXF") or suffix == ".dxf":
        return read_dxf.read
    if suffix in (".gcode", ".gco", ".g", ".nc") or re.search(rb"(?m)^(?:G[0-9]+\b|;)", head):
        return read_gcode.read
    if suffix in (".csv", ".txt", ".dat", ".xyz") or re.match(rb"[-+.0-9]|nan", start, re.IGNORECASE):
        return read_csv.read
    return None


def _folder(folder: Path) -> Theirs:
    if read_manifest(folder) is not None:
        return ours(folder)
    for suffix, reader in ((".svg", read_svg.read_folder), (".png", read_png.read_folder)):
        files = sorted(folder.glob(f"*{suffix}"), key=_order)
        if files:
            kept = _alike(files)
            theirs = reader(kept)
            aside = [path.name for path in files if path not in kept]
            note = f"left out, because most of the folder is named like {kept[0].name}: {', '.join(aside[:_SHOWN])}"
            note += f", and {len(aside) - _SHOWN} more" if len(aside) > _SHOWN else ""
            return replace(theirs, notes=[*theirs.notes, note]) if aside else theirs
    raise ModelError(f"{folder}: holds neither SVG nor PNG, and is no run of rasterslice; name a folder of layers")


def _alike(files: list[Path]) -> list[Path]:
    """Return the files that are named as most of those with numbers are; all where no name is that of most."""
    forms = [re.sub("[0-9]+", "#", "part_#" if OURS.fullmatch(path.stem) else path.stem) for path in files]
    counted = Counter(form for form in forms if "#" in form)
    usual, times = counted.most_common(1)[0] if counted else ("", 0)
    if times <= counted.total() / 2:
        return files
    return [path for path, form in zip(files, forms, strict=True) if form == usual]


def _order(path: Path) -> tuple[list[int], str]:
    return [int(n) for n in re.findall(r"[0-9]+", path.stem)], path.name


def ours(folder: Path, areas: str = "") -> Theirs:
    """Read a finished run: its regions where it has them, else the middle lines of its boundary beads.

    Parameters
    ----------
    folder : Path
    areas : {"", "regions", "boundary"}
        What to read as areas, when that is not to be chosen: regions, or the insides of boundary paths.
    """
    spool = open_result(folder)
    pitch, width, scaffold = _settings(folder)
    if areas == "boundary":
        layers = [_areas(k, k.part_boundary, k.scaffold_boundary) for k in spool]
        name = "boundary paths of a run of rasterslice"
        return Theirs(name, layers, "middle", 0.25 * pitch, pitch=pitch, grain=pitch)
    if spool.regions or areas:
        layers = [_areas(k, k.part, k.scaffold) for k in spool]
        return Theirs("a run of rasterslice", layers, "middle", 0.1 * pitch, scaffold, pitch=pitch, grain=pitch)
    layers = [_bead_layer(k, width) for k in spool]
    return Theirs("a run of rasterslice, boundary beads", layers, "middle", precision=0.06)


def _settings(folder: Path) -> tuple[float, float, bool]:
    """Return pitch, mm, width of the part's beads, mm, and whether there is a scaffold, as the manifest says."""
    manifest = read_manifest(folder) or {}
    settings, grid = manifest.get("settings", {}), manifest.get("grid", {})
    try:
        pitch, width = float(grid.get("pitch", 0.2)), float(settings.get("part_width", 0.0))
        if not (0 < pitch <= LIMIT_MM and 0 <= width <= LIMIT_MM):
            raise ValueError
    except (AttributeError, TypeError, ValueError, OverflowError):
        raise ModelError(f"{folder / MANIFEST}: a pitch or width that is no length; slice again") from None
    return pitch, width or math.nan, bool(settings.get("scaffolding", True))


def has_regions(folder: Path) -> bool:
    """Whether a run holds regions."""
    return open_result(folder).regions


def _loops(paths: Paths | None) -> list[np.ndarray]:
    return [np.array(p) for p in paths or () if len(p) >= 3]


def _areas(layer: Layer, part: Paths | None, scaffold: Paths | None) -> TheirLayer:
    loops = _loops(part)
    return TheirLayer(layer.z, f"layer {layer.index}", loops, _loops(scaffold), [0] * len(loops))


def _bead_layer(layer: Layer, width: float) -> TheirLayer:
    rings = [np.vstack([p, p[:1]]) for p in layer.part_boundary if len(p)]
    beads = pack_beads(rings, [OUTER] * len(rings), [width] * len(rings))
    return TheirLayer(layer.z, f"layer {layer.index}", beads=beads)
