"""Stacks of images of occupancy: OME-TIFF and PNG, with the scale in their metadata.

A sample is the share of its pixel's square that the region covers, 0 to 255, exact to half a step. Pictures have
row 0 on top, so y is turned around; the pixel at the lower left lies at (x0, y0) of the grid.
"""

from __future__ import annotations

import math
import struct
import uuid
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..paths import Layer, Paths
from .coverage import coverage
from .format import Context

_MATERIALS = ("part", "scaffold")


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

    def pages() -> Iterator[NDArray[np.uint8]]:
        for layer in layers:
            yield from (_image(getattr(layer, name), context) for name in _MATERIALS)
        yield from (_image(None, context) for _ in range(0 if len(layers) else 2))

    with TiffWriter(path, ome=True, bigtiff=needs_bigtiff(size)) as file:
        file.write(
            pages(), shape=size, dtype=np.uint8, photometric="minisblack", compression="zlib",
            compressionargs={"level": 1}, resolution=(10 / grid.pitch, 10 / grid.pitch), resolutionunit="CENTIMETER",
            metadata=metadata, software="rasterslice",
        )  # fmt: skip


def needs_bigtiff(size: tuple[int, ...]) -> bool:
    """Tell whether so many samples may pass 4 GB, where 32-bit places end; compressed they can be larger than raw."""
    return math.prod(size) * 1.01 + 1e6 >= 2**32


def write_png(layers: Sequence[Layer], folder: Path, context: Context) -> None:
    """Write ``part_0000.png``, ``scaffold_0000.png`` and so on, 8-bit grey, with pixels per metre."""
    import cv2

    folder.mkdir()
    density = round(1000 / context.grid.pitch)
    scale = _chunk(b"pHYs", struct.pack(">IIB", density, density, 1))
    for layer in layers:
        about = f"layer {layer.index}; z {layer.z:.4f} mm; pitch {context.grid.pitch:g} mm; "
        about += f"thickness {context.thickness:g} mm; lower left pixel {context.grid.x0:.4f} {context.grid.y0:.4f} mm"
        extra = scale + _chunk(b"tEXt", b"Description\0" + about.encode("ascii"))
        for name in _MATERIALS:
            image = _image(getattr(layer, name), context)
            data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
            (folder / f"{name}_{layer.index:04d}.png").write_bytes(data[:33] + extra + data[33:])  # after the header


def _image(region: Paths | None, context: Context) -> NDArray[np.uint8]:
    samples = np.rint(coverage(region, context.grid)[::-1] * 255)  # y turns around here
    return np.ascontiguousarray(samples, np.uint8)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
