"""Stacks of images of occupancy: OME-TIFF and PNG, with the scale in their metadata.

A sample is the share of its pixel's square that the region covers, 0 to 255, exact to half a step. Pictures have
row 0 on top, so y is turned around; the pixel at the lower left lies at (x0, y0) of the grid.
"""

from __future__ import annotations

import math
import os
import struct
import uuid
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..paths import Layer, Paths
from .coverage import samples
from .format import Context

_MATERIALS = ("part", "scaffold")
Made = TypeVar("Made")


def write_tiff(layers: Sequence[Layer], path: Path, context: Context) -> None:
    """Write one OME-TIFF of 8-bit samples, axes ZCYX, channels part and scaffold, sizes of a voxel in mm."""
    from tifffile import TiffWriter

    grid = context.grid
    size = (max(len(layers), 1), 2, grid.height, grid.width)  # no layers: one empty image
    metadata = {
        "axes": "ZCYX", "Name": context.stem, "Channel": {"Name": list(_MATERIALS)},
        "PhysicalSizeX": grid.pitch, "PhysicalSizeY": grid.pitch, "PhysicalSizeZ": context.thickness,
        "PhysicalSizeXUnit": "mm", "PhysicalSizeYUnit": "mm", "PhysicalSizeZUnit": "mm",
        # The standard wants a name for the file; made of the job's, so that the same job gives the same bytes. Of
        # other jobs of this name, grid and number of layers it is the same.
        "UUID": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_OID, f'{context.stem} {grid} {len(layers)}')}",
    }  # fmt: skip

    def strip(layer: Layer | None, name: str) -> bytes:
        return zlib.compress(_image(getattr(layer, name, None), context).data, 1)

    def pages() -> Iterator[bytes]:
        each = ((layer, name) for layer in (layers if len(layers) else [None]) for name in _MATERIALS)
        yield from _side_by_side(strip, each)

    with TiffWriter(path, ome=True, bigtiff=needs_bigtiff(size)) as file:
        file.write(
            pages(), shape=size, dtype=np.uint8, photometric="minisblack", compression="zlib", rowsperstrip=grid.height,
            resolution=(10 / grid.pitch, 10 / grid.pitch), resolutionunit="CENTIMETER", metadata=metadata,
            software="rasterslice",
        )  # fmt: skip


def needs_bigtiff(size: tuple[int, ...]) -> bool:
    """Tell whether so many samples may pass 4 GB, where 32-bit places end; compressed they can be larger than raw."""
    return math.prod(size) * 1.01 + 1e6 >= 2**32


def write_png(layers: Sequence[Layer], folder: Path, context: Context) -> None:
    """Write ``part_0000.png``, ``scaffold_0000.png`` and so on, 8-bit grey, with pixels per metre."""
    folder.mkdir()
    density, grid = round(1000 / context.grid.pitch), context.grid
    head = b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", struct.pack(">IIBBBBB", grid.width, grid.height, 8, 0, 0, 0, 0))
    head += _chunk(b"pHYs", struct.pack(">IIB", density, density, 1))

    def put(layer: Layer, name: str) -> None:
        about = f"layer {layer.index}; z {layer.z:.4f} mm; pitch {grid.pitch:g} mm; "
        about += f"thickness {context.thickness:g} mm; lower left pixel {grid.x0:.4f} {grid.y0:.4f} mm"
        rows = np.zeros((grid.height, grid.width + 1), np.uint8)  # each row begins with its filter, 0: none
        rows[:, 1:] = _image(getattr(layer, name), context)
        body = _chunk(b"tEXt", b"Description\0" + about.encode("ascii")) + _chunk(b"IDAT", zlib.compress(rows.data, 1))
        (folder / f"{name}_{layer.index:04d}.png").write_bytes(head + body + _chunk(b"IEND", b""))

    for _ in _side_by_side(put, ((layer, name) for layer in layers for name in _MATERIALS)):
        pass


def _side_by_side(work: Callable[[Any, str], Made], items: Iterable[tuple[Any, str]]) -> Iterator[Made]:
    """Yield the results of some work in order; a few more items are held than there are threads."""
    threads = min(os.cpu_count() or 1, 8)
    with ThreadPoolExecutor(threads) as pool:
        pending: deque[Future[Made]] = deque()
        for item in items:
            pending.append(pool.submit(work, *item))
            if len(pending) > threads + 2:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()


def _image(region: Paths | None, context: Context) -> NDArray[np.uint8]:
    return np.ascontiguousarray(samples(region, context.grid)[::-1])  # y turns around here


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
