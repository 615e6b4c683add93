"""Layers as the arrays and shapes of other libraries: stacks of masks, and shapely geometry on request."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .errors import UsageError
from .export.coverage import coverage
from .grid import Grid
from .paths import Layer, Paths
from .settings import shown

if TYPE_CHECKING:
    from shapely import MultiLineString, MultiPolygon


def to_polygons(paths: Paths) -> MultiPolygon:
    """Return closed paths as shapely polygons with their holes; needs the extra ``[shapely]``.

    Parameters
    ----------
    paths : Paths
        Closed, mm: a region, or boundary paths. What lies inside an odd number of loops is material.

    Returns
    -------
    shapely.MultiPolygon
        In mm, in the frame of the transformed part.

    Raises
    ------
    ValueError
        When the paths are open: use `to_lines`.
    UsageError
        When shapely is not installed.
    """
    if not paths.closed:
        raise ValueError("open paths enclose nothing; use to_lines")
    shapely = _shapely()
    loops = [shapely.Polygon(p) for p in paths if len(p) >= 3]
    shape = shapely.MultiPolygon()
    for loop in sorted(loops, key=lambda polygon: -polygon.area):
        shape = shape.symmetric_difference(loop if loop.is_valid else loop.buffer(0))
    parts = [part for part in getattr(shape, "geoms", [shape]) if part.geom_type == "Polygon" and not part.is_empty]
    return shapely.MultiPolygon(parts)


def to_lines(paths: Paths) -> MultiLineString:
    """Return paths as shapely lines, mm, closed ones with their first point repeated; needs the extra ``[shapely]``."""
    shapely = _shapely()
    lines = [np.vstack([p, p[:1]]) if paths.closed else p for p in paths if len(p) >= 2]
    return shapely.MultiLineString(lines)


def to_stack(layers: Iterable[Layer], grid: Grid, material: str = "part") -> NDArray[np.float32]:
    """Return the share of each pixel's square that a region covers, for all layers.

    Parameters
    ----------
    layers : iterable of Layer
        With their regions.
    grid : Grid
        The pixels: that of the run (the manifest's ``grid``), or a coarser one of `grid.cover`.
    material : {"part", "scaffold"}

    Returns
    -------
    (K, height, width) float32
        0 to 1; row 0 is the lowest, y points up; pixel (i, j) is centred on ``grid.to_mm((i, j))``.

    Raises
    ------
    UsageError
        When the material is unknown, a layer holds no regions, or a region reaches beyond the grid.
    """
    if material not in ("part", "scaffold"):
        raise UsageError(f"material must be part or scaffold, got {shown(material)}")
    images = []
    low, high = np.array([-0.5, -0.5]), np.array([grid.width, grid.height]) - 0.5
    for layer in layers:
        region = getattr(layer, material)
        if region is None:
            raise UsageError(f"layer {layer.index} holds no regions; slice with an export that draws them, such as svg")
        at = grid.to_pixels(region.points)
        if ((at < low - 1e-6) | (at > high + 1e-6)).any():
            box = " to ".join(f"({x:.4g}, {y:.4g})" for x, y in grid.to_mm([low, high]).tolist())
            raise UsageError(
                f"layer {layer.index}: its {material} reaches beyond the grid, {box} mm; use the grid of the run, or "
                "cover() with the bounds of the part"
            )
        images.append(coverage(region, grid))
    return np.stack(images) if images else np.zeros((0, grid.height, grid.width), np.float32)


def _shapely() -> Any:
    try:
        import shapely
    except ImportError as error:
        raise UsageError("shapely is not installed: pip install 'rasterslice[shapely]'") from error
    return shapely
