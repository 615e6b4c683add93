"""``rasterslice preview``: a mesh or a parameter file -> one picture, quickly, and the viewer if asked for.

To be quick it takes fewer, thicker slices and coarser pixels than a run would; what it took is written on the
picture. With ``full`` a parameter file is sliced as it says.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..errors import UsageError
from ..export import FORMATS, Context
from ..params import Params, read_params
from ..part import load_part
from .picture import nice, picture

LAYERS, PIXELS = 250, 320  # slices, and pixels across, of a preview
STEPS = (1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10)
SMALLEST = 60.0  # mm: beads of the usual width show nothing of a smaller part, so they are made narrower


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
    from .. import slicer

    start = time.perf_counter()
    free = source.suffix.lower() != ".txt"
    if units and not free:
        raise UsageError(f"{source}: names the units of its meshes itself; write units = {units} there, not --units")
    params = Params((source,), units=units or "mm") if free else read_params(source)
    target = out if out is not None else source.with_suffix(".preview.png")
    if target.suffix.lower() != ".png" or not target.parent.is_dir():
        raise UsageError(f"{target}: must be a .png in a folder that exists; name one with -o")
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
    facts = (
        f"{slicing.facets:,} facets   \N{MIDDLE DOT}   {' x '.join(f'{v:.1f}' for v in slicing.high - slicing.low)} mm"
        f"   \N{MIDDLE DOT}   {'as it will be sliced' if full else 'preview'}: {len(layers)} slices of "
        f"{params.thickness:g} mm, paths {params.part_width:g} mm, pixel {params.pitch:g} mm"
    )
    data = picture(layers, context, facts)
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
    """Return the parameters of a preview: not more than about `LAYERS` slices and `PIXELS` across.

    With `free`, where there is no parameter file, the widths of the paths fit the size of the part, too.
    """
    mesh, _ = load_part(params)
    wide, deep, high = (mesh.high - mesh.low).tolist()
    size = max(wide, deep, high)
    changes: dict[str, Any] = {}
    width = min(params.part_width, params.support_width)
    if free and 0 < size < SMALLEST:
        width = nice(size / 80, STEPS)
        changes |= {"part_width": width, "support_width": width, "scaffold_buffer": 3 * width}
        changes["min_point_spacing"] = min(params.min_point_spacing, width / 5)
        params = dataclasses.replace(params, thickness=width / 4, pitch=width / 4, **changes)
    thickness = max(params.thickness, nice(high / LAYERS, STEPS)) if high > 0 else params.thickness
    pitch = min(max(params.pitch, nice(max(wide, deep) / PIXELS, STEPS)), width / 2)
    return dataclasses.replace(params, thickness=thickness, pitch=pitch)
