"""All layers as packed arrays in one NPZ file, which ``numpy.load`` opens.

::

    index (K,) uint32, z (K,) float64           number and cutting height of each layer
    <set>_points  (N, 2) float64                x and y of all vertices, mm
    <set>_offsets (P + 1,) uint64               path i is points[offsets[i]:offsets[i + 1]]
    <set>_layers  (K + 1,) uint64               layer k holds paths layers[k] .. layers[k + 1] - 1
    stats_<column> (K,) float64                 as in layers.csv, NaN where blank

The sets are those of the deposition paths (``part_second_fill`` is that of every other ice layer), and the regions
``part`` and ``scaffold`` where the layers hold them.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from ..paths import COLUMNS, DEPOSITION, REGIONS, Layer, Paths
from .format import Context


def write(layers: Sequence[Layer], path: Path, context: Context) -> None:
    """Write the arrays one after the other, each layer by layer."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        rows = [layer.stats for layer in layers]
        _put(archive, "index", np.array([layer.index for layer in layers], "<u4"))
        _put(archive, "z", np.array([layer.z for layer in layers], "<f8"))
        for name in COLUMNS[2:-1]:
            values = [row.get(name) for row in rows]
            _put(archive, f"stats_{name}", np.array([np.nan if v is None else v for v in values], "<f8"))
        for name in (*REGIONS, *DEPOSITION):
            if not len(layers) or getattr(layers[0], name) is not None:
                _put_set(archive, name, layers)


def _put_set(archive: zipfile.ZipFile, name: str, layers: Sequence[Layer]) -> None:
    """Write points, offsets and the paths of each layer."""

    def sets() -> Iterator[Paths]:
        return (getattr(layer, name) for layer in layers)

    paths = np.array([0, *(len(p) for p in sets())], "<u8").cumsum(dtype="<u8")
    ends = [np.zeros(1, "<u8")]
    total = 0
    for p in sets():
        ends.append(p.offsets[1:].astype("<u8") + np.uint64(total))
        total += len(p.points)
    _put(archive, f"{name}_layers", paths)
    _put(archive, f"{name}_offsets", np.concatenate(ends))
    _stream(archive, f"{name}_points", "<f8", (total, 2), (p.points for p in sets()))


def _put(archive: zipfile.ZipFile, name: str, array: NDArray[Any]) -> None:
    _stream(archive, name, array.dtype.str, array.shape, [array])


def _stream(
    archive: zipfile.ZipFile, name: str, dtype: str, shape: tuple[int, ...], parts: Iterable[NDArray[Any]]
) -> None:
    entry = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))  # no time of day: the same bytes each time
    with archive.open(entry, "w", force_zip64=True) as file:
        header = {"descr": dtype, "fortran_order": False, "shape": shape}
        npy.write_array_header_1_0(file, header)
        for part in parts:
            file.write(np.ascontiguousarray(part, dtype).tobytes())
