"""``rasterslice preview``: a mesh or a parameter file -> one picture, quickly, and the viewer if asked for.

To be quick it takes fewer, thicker slices and coarser pixels than a run would; what it took is written on the
picture. With ``full`` a parameter file is sliced as it says.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import math
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import UsageError, counted
from ..export import FORMATS, Context
from ..interrupts import unbroken
from ..params import Params, read_params
from ..part import load_part
from .picture import nice, picture, short

if TYPE_CHECKING:
    from ..slicer import Slicing

LAYERS, PIXELS = 250, 320  # slices, and pixels across, of a preview
STEPS = (1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10)
SMALLEST = 60.0  # mm: beads of the usual width show nothing of a smaller part, so they are made narrower
LEAST, MOST = 1e-3, 1e5  # mm: what parameters may say at least, and a part that is scaled down


def preview(
    source: Path, *, out: Path | None = None, html: bool = False, full: bool = False, device: str | None = None,
    units: str | None = None,
) -> dict[str, Any]:
    """Slice coarsely, and write ``<stem>.preview.png``.

    Parameters
    ----------
    source : Path
        A parameter file (``.txt``) or a mesh.
    out : Path, optional
        The picture; default beside `source`.
    html : bool
        Also write the viewer, beside the picture.
    full : bool
        Slice as the parameter file says.
    device : str, optional
        As in `slicer.prepare`.
    units : str, optional
        Of a mesh that does not name its own; default mm.

    Returns
    -------
    dict
        ``files``, ``layers``, ``facets``, ``thickness``, ``pitch``, ``device``, ``warnings``, and ``seconds`` of each
        stage.

    Raises
    ------
    RasterSliceError
        Bad parameters, model or device; or the picture cannot be written.
    """
    start = time.perf_counter()
    free = source.suffix.lower() != ".txt"
    if units and not free:
        raise UsageError(f"{source}: names the units of its meshes itself; write units = {units} there, not --units")
    params = Params((source,), units=units or "mm") if free else read_params(source)
    target = out if out is not None else source.with_suffix(".preview.png")
    if target.suffix.lower() != ".png" or not target.parent.is_dir():
        raise UsageError(f"{target}: must be a .png in a folder that exists; name one with -o")
    if html:
        _check_ours(target.with_suffix(".html"))
    with unbroken():
        from .. import opening as devices

        devices.begin(device)
        from .. import slicer
    threading.Thread(target=importlib.import_module, args=("cv2",), daemon=True).start()  # beside the slicing
    if not full:
        params = coarser(params, free)
    seconds = {"bounds": time.perf_counter() - start}
    slicing = slicer.prepare(params, device=device)
    layers = list(slicing.layers())[::-1]
    seconds |= slicing.seconds
    lap = time.perf_counter()
    context = Context(
        source.stem, slicing.grid, params.thickness, params.part_width, params.support_width, params.slice_position
    )
    data = picture(layers, context, _facts(slicing, len(layers), full))
    seconds["picture"] = time.perf_counter() - lap
    files = [target]
    _put(target, lambda path: path.write_bytes(data))
    if html:
        lap = time.perf_counter()
        files.append(target.with_suffix(".html"))
        _put(files[1], lambda path: FORMATS["html"].write(layers, path, context))
        seconds["html"] = time.perf_counter() - lap
    seconds["total"] = time.perf_counter() - start
    return {
        "files": [str(path) for path in files], "layers": len(layers), "facets": slicing.facets,
        "thickness": params.thickness, "pitch": params.pitch, "device": slicing.device_name,
        "warnings": list(slicing.warnings), "seconds": {name: round(value, 4) for name, value in seconds.items()},
    }  # fmt: skip


def _facts(slicing: Slicing, count: int, full: bool) -> str:
    """Return the line below the name: the part, and how it was sliced for the picture."""
    p = slicing.params
    scale = p.scaling[0] if p.scaling and p.source is None else 1.0
    parts = [
        f"{slicing.facets:,} facets", f"{' x '.join(short(v) for v in slicing.high - slicing.low)} mm",
        *([f"scaled by {scale:g}"] if scale != 1 else []),
        f"{'as it will be sliced' if full else 'preview'}: {counted(count, 'slice')} of {p.thickness:.4g} mm, paths "
        f"{p.part_width:.4g} mm, pixel {p.pitch:g} mm",
    ]  # fmt: skip
    return "   \N{MIDDLE DOT}   ".join(parts)


def _check_ours(page: Path) -> None:
    """Refuse to replace a page that is no viewer."""
    try:
        head = page.read_bytes()[:500] if page.is_file() else b" - layers</title>"
    except OSError as error:
        raise UsageError(f"{page}: cannot be read: {error.strerror}; name another with -o") from error
    if b" - layers</title>" not in head:
        raise UsageError(f"{page}: is there and is no layer viewer, so it is not replaced; name another with -o")


def _put(target: Path, write: Callable[[Path], object]) -> None:
    """Write a file under another name and rename it, so that it is whole or is what it was."""
    scratch = target.with_name(f".{target.name}.part")
    try:
        write(scratch)
        scratch.replace(target)
    except OSError as error:
        raise UsageError(f"{target}: cannot be written: {error.strerror}; name another with -o") from error
    finally:
        with contextlib.suppress(OSError):
            scratch.unlink(missing_ok=True)


def coarser(params: Params, free: bool) -> Params:
    """Return the parameters of a preview: at most `LAYERS` slices and `PIXELS` across, whatever the size of the part.

    Slices divide the height evenly, so that their volume is that of the part. Beads are never narrower than two
    pixels. With `free`, where there is no parameter file, they fit the size of the part, too, and a part of which the
    parameters cannot speak (of less than 0.1 mm, or of a kilometre) is scaled by a power of ten.
    """
    mesh, _ = load_part(params)
    wide, deep, high = (mesh.high - mesh.low).tolist()
    factor = _scale(max(wide, deep, high), high) if free else 1.0
    across, high = max(wide, deep) * factor, high * factor
    width, thickness, finest = min(params.part_width, params.support_width), params.thickness, params.pitch
    if free and 0 < across < SMALLEST:
        width = max(nice(across / 80, STEPS), 4 * LEAST)
        thickness, finest = width / 4, width / 4
    count = max(math.ceil(high / max(thickness, nice(high / LAYERS, STEPS)) - 1e-6), 1)
    pitch = max(finest, nice(max(across / PIXELS, LEAST), STEPS))
    grown = max(width, 2 * pitch) / min(params.part_width, params.support_width)
    return dataclasses.replace(
        params, thickness=max(high / count, LEAST), pitch=pitch, part_width=params.part_width * grown,
        support_width=params.support_width * grown, scaffold_buffer=params.scaffold_buffer * grown,
        min_point_spacing=min(max(params.min_point_spacing * grown, LEAST), params.min_point_spacing),
        scaling=(factor, factor, factor) if factor != 1 else params.scaling,
    )  # fmt: skip


def _scale(size: float, high: float) -> float:
    """Return the power of ten that brings a part to a size of which the parameters can speak; mostly 1."""
    if size > MOST:
        power = math.floor(math.log10(MOST / size))
    elif size < 0.1 or high < 2 * LEAST:
        power = math.ceil(math.log10(max(1 / size, 10 * LEAST / high)))
    else:
        return 1.0
    return float(10.0 ** min(max(power, -6), 6))
