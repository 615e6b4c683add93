"""A small part sliced on a device and held against NumPy, once per device, driver and kernels."""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .bins import sort_pieces
from .contour import Seeds, trace
from .device import Device
from .distance import part_distance
from .errors import DeviceError
from .grid import Grid, cover
from .section import Sectioner, to_pixels
from .sources import compose
from .tiles import Images, new_images, quanta, read_images
from .toolchain import ensure_cache

BAND = 6.0  # pixels
DEPTH = 3.0  # level that is traced, pixels inside
SIZE = np.array([6.0, 4.0, 1.0])  # mm, of a box that is turned by half a radian
PITCH = 0.2


def ensure_tested(device: Device) -> None:
    """Run the self-test unless this device has passed it before.

    Raises
    ------
    DeviceError
        When the device computes something else than NumPy.
    """
    state = "\n".join([device.identity, str(device.wide), compose()]).encode()
    mark = Path(ensure_cache()) / "rasterslice" / f"passed-{zlib.crc32(state):08x}{zlib.crc32(state[::-1]):08x}"
    if mark.exists():
        return
    run(device)
    try:
        mark.parent.mkdir(parents=True, exist_ok=True)
        mark.touch()
    except OSError:
        pass  # it will be run again


def run(device: Device) -> None:
    """Slice a turned box; compare its distances and the area inside a level with closed forms."""
    grid, images, where = measured(device, [0.5])
    found = read_images(device, images, 1, grid)[0]
    exact = _distances(grid.to_mm(np.stack(np.meshgrid(np.arange(grid.width), np.arange(grid.height)), 2))) / PITCH
    near = np.isfinite(found) & (np.abs(exact) < BAND - 0.1)
    worst = float(np.abs(found - exact)[near].max()) if near.sum() > 1000 else np.inf
    if worst > 0.01 or (np.sign(found) != np.sign(exact))[np.abs(exact) > 0.01].any():
        raise DeviceError(_failed(device, f"distances are off by {worst:.3g} pixels, limit 0.01"))
    level = images.level(-DEPTH)
    seeds = Seeds(device, grid, images, 1, 1, (level, level))
    seeds.find(where, 0)
    loops = trace(device, grid, seeds, 0.1, 1.0, (True, True), seeds.count())[1]()
    x, y = loops.points.astype(np.float64).T
    area = 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    wanted = float(np.prod(SIZE[:2] / PITCH - 2 * DEPTH))
    if len(loops.ends[0]) != 1 or abs(area - wanted) > 0.01 * wanted:
        raise DeviceError(_failed(device, f"a contour encloses {area:.2f} px^2 instead of {wanted:.2f}"))


def measured(device: Device, heights: list[float]) -> tuple[Grid, Images, NDArray[np.int32]]:
    """Slice the box at some heights, mm, ascending; return the grid, the images, top first, and their map."""
    vertices, faces = _box()
    grid = cover(vertices[:, :2].min(0), vertices[:, :2].max(0), PITCH, 0.0)
    to_pixels(vertices, np.zeros(3), grid, 0.0)
    layers = len(heights)
    sections = Sectioner(device, vertices, faces, np.array(heights), 1000).cut(0, layers)
    span = (0, int(sections.offsets[-1]))
    pieces, wind = sort_pieces(device, grid, sections.segments, sections.slice_of, span, layers - 1, layers)
    images, counter = new_images(device, "sdf", layers, grid, quanta(BAND))
    doubts = device.zeros("contacts", layers, np.int32)
    where, _ = part_distance(device, grid, pieces, pieces, wind, layers, BAND, "nonzero", images, counter, doubts)
    return grid, images, where


def _failed(device: Device, what: str) -> str:
    return f"device {device.name} fails the self-test: {what}; name another with --device"


def _turn() -> NDArray[np.float64]:
    c, s = np.cos(0.5), np.sin(0.5)
    return np.array([[c, s], [-s, c]])


def _box() -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return the (8, 3) vertices and (12, 3) faces of the box, oriented outward, the lowest at z = 0."""
    corners = np.array([(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)]) * SIZE
    corners[:, :2] = (corners[:, :2] - SIZE[:2] / 2) @ _turn()
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (1, 3, 7, 5), (3, 2, 6, 7), (2, 0, 4, 6)]
    facets = [(a, b, c) for a, b, c, _ in quads] + [(a, c, d) for a, _, c, d in quads]
    return corners.astype(np.float32), np.array(facets, np.int32)


def _distances(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the signed distance of points (..., 2), mm, to the section of the box, mm."""
    q = np.abs(points @ _turn().T) - SIZE[:2] / 2
    outside = np.hypot(np.maximum(q[..., 0], 0.0), np.maximum(q[..., 1], 0.0))
    return np.asarray(outside + np.minimum(q.max(axis=-1), 0.0))
