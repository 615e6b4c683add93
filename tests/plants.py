"""Faults planted into true slices, one at a time, and writers for every format that check reads."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import models
import numpy as np
import shapely
from shapely import affinity
from shapely.geometry import MultiPolygon, Polygon
from shapely.geometry.polygon import orient

Loops = list[np.ndarray]


@dataclass
class Slice:
    """A layer as a good program would write it: region, middle height, and for G-code its fill."""

    z: float
    region: MultiPolygon
    flipped: list[int] = field(default_factory=list)  # loops wound the wrong way
    raw: Loops | None = None  # loops that are no valid region
    tied: Loops | None = None  # walls as they are, when they are not made from the region
    inset: float = 0.5  # where the middle of a bead lies, widths inside
    fill: Loops = field(default_factory=list)
    support: MultiPolygon = field(default_factory=MultiPolygon)  # what another program's supports cover


def clean(shape: shapely.Geometry) -> MultiPolygon:
    parts = [p for p in getattr(shape, "geoms", [shape]) if isinstance(p, Polygon) and p.area > 1e-6]
    return MultiPolygon([orient(p) for p in parts])


def loops_of(layer: Slice) -> Loops:
    if layer.raw is not None:
        return layer.raw
    rings = [ring for p in clean(layer.region).geoms for ring in (p.exterior, *p.interiors)]
    loops = [np.array(ring.coords)[:-1] for ring in rings]
    return [p[::-1] if i in layer.flipped else p for i, p in enumerate(loops)]


def part() -> models.Body:
    """A part with an island, a hole, a slope, and no symmetry."""
    cone = models.cone(13.0, 30.0, 64)
    cone = models.Body(cone.vertices * (1, 0.8, 1), cone.faces)
    tube = models.prism([models.circle(6, (24, 3), 64), models.circle(3, (24, 3), 64)[::-1]], 0.0, 6.0)
    foot = models.prism([models.rectangle(-6, 16, 14, 22)], 0.0, 6.0)
    return models.join(cone, tube, foot)


def overhanging() -> models.Body:
    """Two table tops at different heights, which nothing but supports holds."""
    stem, low = models.box((-2, -2, 0), (2, 2, 9.1)), models.box((-8, -7, 4.1), (6, 7, 5.3))
    return models.join(stem, low, models.box((-6, -9, 9.1), (9, 6, 10.3)))


def supported(layers: list[Slice], clearance: float = 0.4) -> list[Slice]:
    """Return the layers with supports below everything that lies above them."""
    above, found = MultiPolygon(), []
    for layer in layers[::-1]:
        free = clean(above.difference(layer.region.buffer(clearance)))
        found.append(Slice(**{**layer.__dict__, "support": free}))
        above = clean(above.union(layer.region))
    return found[::-1]


# ---- faults: each returns the changed layers and the numbers of the layers that are now wrong, or None


def _biggest(region: MultiPolygon) -> Polygon:
    return max(region.geoms, key=lambda p: p.area)


def island_deleted(rng, layers, k):
    parts = list(layers[k].region.geoms)
    if len(parts) < 2:
        return None
    parts.pop(int(rng.integers(len(parts))))
    return _with(layers, k, region=MultiPolygon(parts)), [k]


def hole_filled(rng, layers, k):
    holes = [(p, h) for p in layers[k].region.geoms for h in p.interiors]
    if not holes:
        return None
    _, hole = holes[int(rng.integers(len(holes)))]
    return _with(layers, k, region=clean(layers[k].region.union(Polygon(hole)))), [k]


def contour_shifted(rng, layers, k):
    turn = rng.uniform(0, 2 * np.pi)
    moved = affinity.translate(layers[k].region, 0.1 * np.cos(turn), 0.1 * np.sin(turn))
    return _with(layers, k, region=clean(moved)), [k]


def part_scaled(rng, layers, k):
    whole = MultiPolygon([p for layer in layers for p in layer.region.geoms]).bounds
    centre = ((whole[0] + whole[2]) / 2, (whole[1] + whole[3]) / 2)
    return _with(layers, k, region=clean(affinity.scale(layers[k].region, 1.003, 1.003, origin=centre))), [k]


def layers_swapped(rng, layers, k):
    if k + 1 >= len(layers):
        return None
    new = list(layers)
    new[k], new[k + 1] = _at(layers[k + 1], layers[k].z), _at(layers[k], layers[k + 1].z)
    return new, [k, k + 1]


def layer_missing(rng, layers, k):
    return [layer for i, layer in enumerate(layers) if i != k], [k]


def layer_duplicated(rng, layers, k):
    if k + 1 >= len(layers):
        return None
    return _with(layers, k + 1, region=layers[k].region), [k + 1]


def contour_cut_short(rng, layers, k):
    parts = list(layers[k].region.geoms)
    i = int(np.argmax([p.length for p in parts]))
    ring = parts[i].exterior
    start = rng.uniform(0, 0.6)
    kept = [ring.interpolate(t, normalized=True) for t in np.linspace(start, start + 0.75, 400) % 1.0]
    shape = shapely.make_valid(Polygon([(p.x, p.y) for p in kept], parts[i].interiors))
    others = MultiPolygon([p for j, p in enumerate(parts) if j != i])
    return _with(layers, k, region=clean(clean(shape).union(others))), [k]


def winding_reversed(rng, layers, k):
    return _with(layers, k, flipped=[int(rng.integers(len(loops_of(layers[k]))))]), [k]


def offset_wrong_way(rng, layers, k):
    return _with(layers, k, inset=-0.5), [k]


def offset_whole_width(rng, layers, k):
    return _with(layers, k, inset=1.0), [k]


def area_offset_wrong_way(rng, layers, k):
    """Grown by half a width where it had to shrink by it."""
    return _with(layers, k, region=clean(layers[k].region.buffer(0.4, join_style="mitre", mitre_limit=3))), [k]


def area_offset_whole_width(rng, layers, k):
    return _with(layers, k, region=clean(layers[k].region.buffer(-0.8, join_style="mitre", mitre_limit=3))), [k]


def support_missing(rng, layers, k):
    """A pillar broken away under one overhang."""
    bare = layers[k].region.difference(layers[k - 1].region.buffer(2.0)) if k > 3 else MultiPolygon()
    if bare.is_empty:
        return None
    x0, y0, x1, y1 = bare.bounds
    hole = shapely.Point(rng.uniform(x0, x1), rng.uniform(y0, y1)).buffer(6.0)
    new = list(layers)
    for j in range(k - 3, k):
        new[j] = Slice(**{**layers[j].__dict__, "support": clean(layers[j].support.difference(hole))})
    return new, [k]


def unheld(layers: list[Slice], k: int, width: float, pixel: float) -> bool:
    """Whether supports leave an overhang of layer k bare, by the limits that docs/cross-check.md states."""
    step, reach = layers[k].z - layers[k - 1].z, 3 * width
    below = range(max(k - 3, 0), k)
    part = shapely.union_all([layers[j].region for j in below])
    posts = shapely.union_all([layers[j].support for j in below])
    over = layers[k].region.difference(part.buffer(step / np.tan(np.radians(40.0)) + pixel))
    bare = over.difference(posts.buffer(reach + pixel)).buffer(-pixel)
    return max((p.area for p in _polygons_of(bare)), default=0.0) > width**2


def fill_leaves(rng, layers, k):
    x0, y0, x1, y1 = layers[k].region.bounds
    y = rng.uniform(y0 + 0.2 * (y1 - y0), y1 - 0.2 * (y1 - y0))
    line = np.array([[(x0 + x1) / 2, y], [x1 + rng.uniform(1.0, 3.0), y]])
    return _with(layers, k, fill=[*layers[k].fill, line]), [k]


def self_intersection(rng, layers, k):
    return _bow_tie(rng, layers, k, loops_of(layers[k]), "raw")


def bead_self_intersection(rng, layers, k):
    return _bow_tie(rng, layers, k, [p[:-1] for p in beads_of(layers[k], 0.8)[0]], "tied")


def _bow_tie(rng, layers, k, loops, name):
    if not loops:
        return None
    i = int(np.argmax([len(p) for p in loops]))
    p = loops[i].copy()
    j = int(rng.integers(len(p)))
    order = (j + np.arange(len(p))) % len(p)
    p = p[order]
    n = min(6, len(p) - 1)  # a stretch walked backwards: a bow tie
    p[1:n] = p[1:n][::-1]
    ring = shapely.LinearRing(p.round(3))  # as the files write it
    if ring.is_simple:
        return None
    return _with(layers, k, **{name: [*loops[:i], p, *loops[i + 1 :]]}), [k]


def _with(layers, k, **changes):
    new = list(layers)
    new[k] = Slice(**{**layers[k].__dict__, **changes})
    return new


def _at(layer, z):
    return Slice(**{**layer.__dict__, "z": z})


AREA_FAULTS: dict[str, Callable] = {
    f.__name__.replace("_", " "): f
    for f in (
        island_deleted, hole_filled, contour_shifted, part_scaled, layers_swapped, layer_missing, layer_duplicated,
        contour_cut_short, winding_reversed, self_intersection,
    )
}  # fmt: skip
BEAD_FAULTS: dict[str, Callable] = {
    name: f for name, f in AREA_FAULTS.items() if name not in ("winding reversed", "self intersection")
} | {
    f.__name__.replace("_", " "): f for f in (offset_wrong_way, offset_whole_width, fill_leaves, bead_self_intersection)
}
BEAD_FAULTS["self intersection"] = BEAD_FAULTS.pop("bead self intersection")
AREA_FAULTS |= {"offset wrong way": area_offset_wrong_way, "offset whole width": area_offset_whole_width}


#: Planted into supported layers of `overhanging`.
SUPPORT_FAULTS: dict[str, Callable] = {"support missing": support_missing}


# ---- writers


def svg_legacy(layers: list[Slice], path: Path, thickness: float) -> Path:
    text = ['<?xml version="1.0" encoding="UTF-8"?>\n<svg width="200" height="200" '
            'xmlns="http://www.w3.org/2000/svg" xmlns:slic3r="http://slic3r.org/namespaces/slic3r">\n']  # fmt: skip
    for i, layer in enumerate(layers):
        text.append(f'<g id="layer{i}" slic3r:z="{layer.z * 1e-6:.9g}">\n' + _polygons(layer) + "</g>\n")
    path.write_text("".join(text) + "</svg>\n")
    return path


def svg_new(layers: list[Slice], path: Path, thickness: float) -> Path:
    text = ['<?xml version="1.0"?>\n<svg width="200" height="200" '
            'xmlns="http://www.w3.org/2000/svg" xmlns:slic3r="http://slic3r.org/namespaces/slic3r">\n']  # fmt: skip
    for i, layer in enumerate(layers):
        z = f'slic3r:z="{layer.z + thickness / 2:.4f}" slic3r:slice-z="{layer.z:.4f}"'
        data = "".join("M " + " L ".join(f"{x:.5f} {y:.5f}" for x, y in p) + " z " for p in loops_of(layer))
        text.append(f'<g id="layer{i}" {z}>\n<path d="{data}" slic3r:type="perimeter"/>\n')
        beside = loops_of(Slice(layer.z, layer.support))
        data = "".join("M " + " L ".join(f"{x:.5f} {y:.5f}" for x, y in p) + " z " for p in beside)
        text.append((f'<path d="{data}" slic3r:type="support"/>\n' if beside else "") + "</g>\n")
    path.write_text("".join(text) + "</svg>\n")
    return path


def _polygons(layer: Slice) -> str:
    kinds = ["contour" if Polygon(p).exterior.is_ccw else "hole" for p in loops_of(Slice(layer.z, layer.region))]
    if layer.raw is not None:
        kinds = ["contour"] * len(layer.raw)
    return "".join(
        f'<polygon slic3r:type="{kind}" points="{" ".join(f"{x:.6f},{y:.6f}" for x, y in p)}" />\n'
        for kind, p in zip(kinds, loops_of(layer), strict=True)
    )


def _labelled(layer: Slice) -> list[tuple[int, np.ndarray]]:
    loops = [(1, p) for p in loops_of(layer)] + [(2, p) for p in loops_of(Slice(layer.z, layer.support))]
    return [(label, np.vstack([p, p[:1]])) for label, p in loops]


def cli_ascii(layers: list[Slice], path: Path, thickness: float) -> Path:
    text = ["$$HEADERSTART\n$$ASCII\n$$UNITS/1.0\n$$VERSION/200\n$$LABEL/1,part\n$$LABEL/2,support\n"]
    text.append(f"$$LAYERS/{len(layers)}\n$$HEADEREND\n$$GEOMETRYSTART\n$$LAYER/0.0\n")
    for layer in layers:
        text.append(f"$$LAYER/{layer.z + thickness / 2:.5f}\n")
        for label, p in _labelled(layer):
            direction = int(shapely.LinearRing(p).is_ccw)
            text.append(f"$$POLYLINE/{label},{direction},{len(p)}," + ",".join(f"{v:.5f}" for v in p.ravel()) + "\n")
    path.write_text("".join(text) + "$$GEOMETRYEND\n")
    return path


def cli_binary(layers: list[Slice], path: Path, thickness: float) -> Path:
    data = [b"$$HEADERSTART\n$$BINARY\n$$UNITS/1.0\n$$VERSION/200\n$$LABEL/1,part\n$$LABEL/2,support\n$$HEADEREND"]
    for layer in layers:
        data.append(struct.pack("<Hf", 127, layer.z + thickness / 2))
        for label, p in _labelled(layer):
            data.append(struct.pack("<Hiii", 130, label, int(shapely.LinearRing(p).is_ccw), len(p)))
            data.append(p.astype("<f4").tobytes())
    path.write_bytes(b"".join(data))
    return path


def csv_nan(layers: list[Slice], path: Path, thickness: float) -> Path:
    rows = []
    for layer in layers:
        for p in loops_of(layer):
            rows += [f"{x:.5f},{y:.5f},{layer.z:.5f}" for x, y in np.vstack([p, p[:1]])] + ["NaN,NaN,NaN"]
    path.write_text("\n".join(rows) + "\n")
    return path


def dxf_polylines(layers: list[Slice], path: Path, thickness: float) -> Path:
    """Write LWPOLYLINE of R2000, all others R12: POLYLINE, in turn some as single lines, as CAD programs do."""
    text = ["0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1015\n9\n$INSUNITS\n70\n4\n0\nENDSEC\n0\nSECTION\n2\nENTITIES\n"]
    for layer in layers:
        pairs = [("PART", p) for p in loops_of(layer)]
        pairs += [("SUPPORT", p) for p in loops_of(Slice(layer.z, layer.support))]
        for i, (name, p) in enumerate(pairs):
            text.append(_DXF_FORMS[i % 3](name, p, f"{layer.z:.5f}"))
    path.write_text("".join(text) + "0\nENDSEC\n0\nEOF\n")
    return path


def _lwpolyline(name: str, p: np.ndarray, z: str) -> str:
    head = f"0\nLWPOLYLINE\n100\nAcDbEntity\n8\n{name}\n100\nAcDbPolyline\n90\n{len(p)}\n70\n1\n38\n{z}\n"
    return head + "".join(f"10\n{x:.5f}\n20\n{y:.5f}\n" for x, y in p)


def _polyline(name: str, p: np.ndarray, z: str) -> str:
    head = f"0\nPOLYLINE\n8\n{name}\n66\n1\n10\n0.0\n20\n0.0\n30\n{z}\n70\n1\n"
    return head + "".join(f"0\nVERTEX\n8\n{name}\n10\n{x:.5f}\n20\n{y:.5f}\n30\n{z}\n" for x, y in p) + "0\nSEQEND\n"


def _lines(name: str, p: np.ndarray, z: str) -> str:
    return "".join(
        f"0\nLINE\n8\n{name}\n10\n{a[0]:.5f}\n20\n{a[1]:.5f}\n30\n{z}\n11\n{b[0]:.5f}\n21\n{b[1]:.5f}\n31\n{z}\n"
        for a, b in zip(p, np.roll(p, -1, axis=0), strict=True)
    )


_DXF_FORMS = (_lwpolyline, _polyline, _lines)


def npz_arrays(layers: list[Slice], path: Path, thickness: float) -> Path:
    """Write regions in the way of our own export, by NumPy, packed."""
    loops = [loops_of(layer) for layer in layers]
    sizes = [len(p) for held in loops for p in held]
    arrays = {
        "index": np.arange(len(layers), dtype="<u4"), "z": np.array([layer.z for layer in layers]),
        "part_points": np.concatenate([np.empty((0, 2)), *(p for held in loops for p in held)]),
        "part_offsets": np.cumsum([0, *sizes]).astype("<u8"),
        "part_layers": np.cumsum([0, *(len(held) for held in loops)]).astype("<u8"),
    }  # fmt: skip
    np.savez_compressed(path, **arrays)
    return path


FINER = 4  # a picture is drawn finer, and then made smaller


def tiff_stack(layers: list[Slice], path: Path, thickness: float, pixel: float = 0.05) -> Path:
    """Write shares of pixels as other programs do: by tifffile, with ImageJ's sizes; a missing layer is black."""
    import tifffile

    shape, pictures = _pictures(layers, thickness, pixel)
    about = {"spacing": thickness, "unit": "mm", "axes": "ZYX"}
    shares = (_smaller(picture) for picture in pictures)
    size = (1 / pixel, 1 / pixel)
    tifffile.imwrite(path, shares, shape=shape, dtype=np.uint8, imagej=True, resolution=size, metadata=about)
    return path


def tiff_distances(layers: list[Slice], path: Path, thickness: float, pixel: float = 0.05) -> Path:
    """Write distances of the middles of pixels, px, negative inside, that end at 8 px, as OME and packed."""
    import tifffile

    shape, low, held = _stack(layers, thickness, pixel)

    def distances() -> Iterator[np.ndarray]:
        for number in range(shape[0]):
            loops = [(p - low) / pixel for p in loops_of(held[number])] if number in held else []
            away = distances_from(loops, shape[1:])
            yield np.where(middles(loops, np.array(shape[:0:-1])) > 0, -away, away)[::-1].astype(np.float32)

    about = {"axes": "ZYX", **{f"PhysicalSize{a}": v for a, v in zip("XYZ", (pixel, pixel, thickness), strict=True)}}
    about |= {f"PhysicalSize{a}Unit": "mm" for a in "XYZ"}
    tifffile.imwrite(path, distances(), shape=shape, dtype=np.float32, ome=True, compression="zlib", metadata=about)
    return path


def distances_from(loops: Loops, shape: tuple[int, ...], most: float = 8.0) -> np.ndarray:
    """Return how far the middle of each pixel is from the nearest edge: each edge looks at the pixels about it."""
    away = np.full(shape, most)
    for p in loops:
        for a, b in zip(p, np.roll(p, -1, axis=0), strict=True):
            x0, y0 = np.floor(np.minimum(a, b) - most).astype(int).clip(0).tolist()
            x1, y1 = np.ceil(np.maximum(a, b) + most).astype(int).clip(0).tolist()
            x = np.arange(x0, min(x1, shape[1])) + 0.5 - a[0]
            y = (np.arange(y0, min(y1, shape[0])) + 0.5 - a[1])[:, None]
            along = b - a
            share = ((x * along[0] + y * along[1]) / max(float(along @ along), 1e-30)).clip(0.0, 1.0)
            about = away[y0:y1, x0:x1]
            np.minimum(about, np.hypot(x - share * along[0], y - share * along[1]), out=about)
    return away


def _smaller(picture: np.ndarray) -> np.ndarray:
    import cv2

    return cv2.resize(picture, None, fx=1 / FINER, fy=1 / FINER, interpolation=cv2.INTER_AREA)


def _stack(layers: list[Slice], thickness: float, pixel: float) -> tuple[tuple[int, ...], np.ndarray, dict[int, Slice]]:
    """Return the shape of a stack, its lower left corner, mm, and the layers by number."""
    bounds = np.array([layer.region.bounds for layer in layers if not layer.region.is_empty])
    low, high = bounds[:, :2].min(axis=0) - 2, bounds[:, 2:].max(axis=0) + 2
    wide, high_px = np.ceil((high - low) / pixel).astype(int).tolist()
    held = {round((layer.z - thickness / 2) / thickness): layer for layer in layers}
    return (max(held) + 1, high_px, wide), low, held


def _pictures(layers: list[Slice], thickness: float, pixel: float) -> tuple[tuple[int, ...], Iterator[np.ndarray]]:
    """Return the shape of a stack, and one finer picture after the other, black where a layer is missing."""
    import cv2

    shape, low, held = _stack(layers, thickness, pixel)

    def drawn() -> Iterator[np.ndarray]:
        for number in range(shape[0]):
            picture = np.zeros((FINER * shape[1], FINER * shape[2]), np.uint8)
            loops = loops_of(held[number]) if number in held else []
            points = [np.round(((p - low) / pixel * FINER - 0.5) * 256).astype(np.int32) for p in loops]
            cv2.fillPoly(picture, points, 255, shift=8)
            yield picture[::-1]

    return shape, drawn()


def png_stack(layers: list[Slice], path: Path, thickness: float, pixel: float = 0.05) -> Path:
    """Write pictures whose pixels are white where their middles are solid."""
    import cv2

    path.mkdir(exist_ok=True)
    for old in path.glob("*.png"):
        old.unlink()
    bounds = np.array([layer.region.bounds for layer in layers if not layer.region.is_empty])
    low, high = bounds[:, :2].min(axis=0) - 2, bounds[:, 2:].max(axis=0) + 2
    size = np.ceil((high - low) / pixel).astype(int)
    for layer in layers:
        image = middles([(p - low) / pixel for p in loops_of(layer)], size)
        data = cv2.imencode(".png", image[::-1])[1].tobytes()
        scale = struct.pack(">2IB", round(1000 / pixel), round(1000 / pixel), 1)
        chunk = struct.pack(">I4s", 9, b"pHYs") + scale + struct.pack(">I", zlib.crc32(b"pHYs" + scale))
        number = round((layer.z - thickness / 2) / thickness)
        (path / f"layer_{number:04d}.png").write_bytes(data[:33] + chunk + data[33:])
    return path


def middles(loops: Loops, size: np.ndarray) -> np.ndarray:
    """Return which pixels have their middles inside an odd number of loops, by where each row is crossed."""
    turns = np.zeros((size[1], size[0] + 1), np.int64)
    for p in loops:
        for (x0, y0), (x1, y1) in zip(p, np.roll(p, -1, axis=0), strict=True):
            rows = np.arange(np.ceil(min(y0, y1) - 0.5), np.ceil(max(y0, y1) - 0.5)).astype(int)
            if len(rows):
                x = x0 + (rows + 0.5 - y0) * (x1 - x0) / (y1 - y0)
                np.add.at(turns, (rows, np.ceil(x - 0.5).astype(int)), 1)
    return (255 * (np.cumsum(turns, axis=1)[:, :-1] % 2)).astype(np.uint8)


def beads_of(layer: Slice, width: float) -> tuple[Loops, Loops]:
    """Return outer perimeters, closed, and solid fill."""
    inner = clean(layer.region.buffer(-layer.inset * width, join_style="mitre", mitre_limit=3))
    walls = [np.array(ring.coords) for p in inner.geoms for ring in (p.exterior, *p.interiors)]
    if layer.tied is not None:
        walls = [np.vstack([p, p[:1]]) for p in layer.tied]
    return walls, [*_hatched(clean(layer.region.buffer(-width)), width, 4 * width), *layer.fill]


def _hatched(area: MultiPolygon, width: float, apart: float) -> Loops:
    lines: Loops = []
    if not area.is_empty:
        x0, y0, x1, y1 = area.bounds
        for y in np.arange(y0 + width / 2, y1, apart):
            cut = area.intersection(shapely.LineString([(x0 - 1, y), (x1 + 1, y)]))
            lines += [np.array(g.coords) for g in getattr(cut, "geoms", [cut]) if g.length > width]
    return lines


DIALECTS = {
    "PrusaSlicer": (
        "; generated by PrusaSlicer 2.5.0",
        ";LAYER_CHANGE",
        ";TYPE:External perimeter",
        ";TYPE:Solid infill",
        ";TYPE:Support material",
    ),
    "OrcaSlicer": ("; generated by OrcaSlicer 2.0", ";LAYER_CHANGE", ";TYPE:Outer wall", ";TYPE:Sparse infill",
                   ";TYPE:Support"),
    "Cura": (";FLAVOR:Marlin\n;Generated with Cura_SteamEngine 5.4", ";LAYER:{i}", ";TYPE:WALL-OUTER", ";TYPE:FILL",
             ";TYPE:SUPPORT"),
    "Slic3r": (
        "; generated by Slic3r 1.3.0\n; external perimeters extrusion width = {w:.2f}mm",
        "",
        "; perimeter",
        "; infill",
        "; support material",
    ),
}


def gcode(dialect: str, relative: bool = False) -> Callable[..., Path]:
    """Return a writer of G-code in the way of one program."""
    head, change, wall, fill, support = DIALECTS[dialect]

    def write(layers: list[Slice], path: Path, thickness: float, width: float = 0.8) -> Path:
        text = [head.format(w=width), "G21", "G90", "M83" if relative else "M82", "G92 E0", "G28"]
        e, fed = 0.0, width * thickness / (np.pi / 4 * 1.75**2)
        for i, layer in enumerate(layers):
            if change:
                text.append(change.format(i=i))
            text.append(f"G1 Z{layer.z + thickness / 2:.3f} F7200")
            walls, lines = beads_of(layer, width)
            posts = _hatched(layer.support.buffer(-width / 2), width, 2 * width)
            for kind, paths in ((support, posts), (wall, walls), (fill, lines)):
                said = kind if change else None
                if said and paths:
                    text += [said, *([f";WIDTH:{width}"] if dialect != "Cura" else [])]
                for p in paths:
                    text.append(f"G0 X{p[0, 0]:.3f} Y{p[0, 1]:.3f}")
                    for a, b in zip(p[:-1], p[1:], strict=True):
                        step = fed * float(np.hypot(*(b - a)))
                        e = step if relative else e + step
                        order = f"F1800 X{b[0]:.3f} Y{b[1]:.3f}" if dialect == "Cura" else f"X{b[0]:.3f} Y{b[1]:.3f}"
                        text.append(f"G1 {order} E{e:.5f}" + ("" if said else f" {kind}"))
        path.write_text("\n".join(text) + "\n")
        return path

    return write


def fab_paths(layers: list[Slice], path: Path, thickness: float, width: float = 0.8) -> Path:
    text = ['<?xml version="1.0"?>\n<fabAtHomePrinter>\n']
    for name in ("water", "support"):
        text.append(f"<materialCalibration><name>{name}</name><pathWidth>{width}</pathWidth></materialCalibration>\n")
    for layer in layers:
        walls, lines = beads_of(layer, width)
        posts = _hatched(layer.support.buffer(-width / 2), width, 2 * width)
        for name, paths in (("water", [*walls, *lines]), ("support", posts)):
            for p in paths:
                text.append(f"<path><materialCalibrationName>{name}</materialCalibrationName>\n")
                z = layer.z + thickness / 2
                text += [f"<point><x>{x:.4f}</x><y>{y:.4f}</y><z>{z:.4f}</z></point>\n" for x, y in p]
                text.append("</path>\n")
    path.write_text("".join(text) + "</fabAtHomePrinter>\n")
    return path


AREA_WRITERS: dict[str, tuple[str, Callable[..., Path]]] = {
    "SVG Slic3r legacy": (".svg", svg_legacy), "SVG Slic3r 1.3": (".svg", svg_new), "CLI ASCII": (".cli", cli_ascii),
    "CLI binary": (".cli", cli_binary), "CSV polylines": (".csv", csv_nan), "PNG stack": ("", png_stack),
}  # fmt: skip
AREA_WRITERS |= {
    "DXF": (".dxf", dxf_polylines), "NPZ": (".npz", npz_arrays), "TIFF stack": (".tif", tiff_stack),
    "TIFF distances": (".ome.tif", tiff_distances),
}  # fmt: skip
PICTURED = ("PNG stack", "TIFF stack", "TIFF distances")
BEAD_WRITERS: dict[str, tuple[str, Callable[..., Path]]] = {
    "G-code PrusaSlicer": (".gcode", gcode("PrusaSlicer")), "G-code OrcaSlicer": (".gcode", gcode("OrcaSlicer", True)),
    "G-code Cura": (".gcode", gcode("Cura")), "G-code Slic3r": (".gcode", gcode("Slic3r")),
    "Fab@Home": (".fab", fab_paths),
}  # fmt: skip
CARRIES_SUPPORT = ("SVG Slic3r 1.3", "CLI ASCII", "CLI binary", "DXF", *BEAD_WRITERS)
CARRIES_WINDING = ("SVG Slic3r legacy", "SVG Slic3r 1.3", "CLI ASCII", "CLI binary", "CSV polylines", "NPZ")


HEIGHT_SLACK = 0.002  # mm: docs/cross-check.md


@dataclass
class Stated:
    """The limits that docs/cross-check.md states, and the true slice at the heights between which a slice may lie.

    Whether a plant counts is decided with these and polygons alone, before its file is checked.
    """

    tolerance: float
    uncertainty: float
    pitch: float
    width: float

    @property
    def limit(self) -> float:
        return self.tolerance + self.uncertainty

    def least(self, beads: bool) -> float:
        return self.pitch**2 + (0.03 * self.width**2 if beads else 0.0)


def stated(kind: str, pitch: float = 0.2, width: float = 0.8) -> Stated:
    """Return the limits of a format by the table of the docs."""
    precision = {
        "PNG stack": 0.75 * 0.05, "TIFF stack": 0.35 * 0.05, "TIFF distances": 0.35 * 0.05, "CLI ASCII": 0.0005,
        "CLI binary": 0.0005, "DXF": 0.0005, "NPZ": 0.025, "Fab@Home": 0.0001, "G-code Cura": 0.015,  # says no width
    }.get(kind, 0.0)  # fmt: skip
    return Stated(pitch / 4, 0.02 * pitch + precision, pitch, width)


#: Faults of the contour itself, or so large that no limit can hide them.
ALWAYS = ("winding reversed", "self intersection", "fill leaves", "offset wrong way", "offset whole width")


def exceeds(true: list[MultiPolygon], planted: Slice | None, fault: str, limits: Stated, beads: bool) -> bool:
    """Whether a plant changes its layer by more than the stated limits.

    Parameters
    ----------
    true : list of MultiPolygon
        The slice, and the slices HEIGHT_SLACK lower and higher.
    """
    if fault in ALWAYS:
        return True
    inner, outer = shapely.intersection_all(true), shapely.union_all(true)
    if beads:
        return _leaves(outer, planted, limits) or _bare(inner, outer, planted, limits)
    now = planted.region if planted is not None else MultiPolygon()
    lost = inner.buffer(-limits.limit).difference(now)
    extra = now.difference(outer.buffer(limits.limit))
    return max((p.area for shape in (lost, extra) for p in _polygons_of(shape)), default=0.0) > limits.least(False)


def _polygons_of(shape: shapely.Geometry) -> list[shapely.Geometry]:
    return list(getattr(shape, "geoms", [shape]))


def _walls(planted: Slice | None, width: float) -> shapely.Geometry:
    lines = beads_of(planted, width)[0] if planted else []
    return shapely.MultiLineString([p for p in lines if len(p) > 1])


def _leaves(outer: shapely.Geometry, planted: Slice | None, limits: Stated) -> bool:
    """Whether an outer bead reaches out of the part by more than the limit."""
    out = _walls(planted, limits.width).buffer(limits.width / 2).difference(outer.buffer(limits.limit))
    return max((p.area for p in _polygons_of(out)), default=0.0) > limits.least(True)


def _bare(inner: shapely.Geometry, outer: shapely.Geometry, planted: Slice | None, limits: Stated) -> bool:
    """Whether a wall of a part where three beads fit lacks its bead: deviation times length in a square of 8 pixels."""
    w = limits.width
    closed = inner.union(outer.buffer(limits.limit).buffer(-limits.limit).intersection(inner.buffer(limits.limit)))
    thick = closed.buffer(-1.5 * w).buffer(1.5 * w)
    lines = [ring for p in _polygons_of(thick.buffer(-w / 2)) if not p.is_empty for ring in (p.exterior, *p.interiors)]
    step = 0.1
    points = [p for ring in lines for p in shapely.line_interpolate_point(ring, np.arange(0, ring.length, step))]
    if not points:
        return False
    edge, walls = shapely.distance(points, closed.boundary), _walls(planted, w)
    off = np.full(len(points), 10.0) if walls.is_empty else shapely.distance(points, walls)
    xy = shapely.get_coordinates(points)
    bad = (np.abs(edge - w / 2) < 0.01 * w) & (off > limits.limit)
    cells = np.floor(xy[bad] / (8 * limits.pitch)).astype(int)
    sums: dict[tuple[int, ...], float] = {}
    for cell, d in zip(map(tuple, cells.tolist()), off[bad].clip(max=8 * limits.pitch), strict=True):
        sums[cell] = sums.get(cell, 0.0) + d * step
    return max(sums.values(), default=0.0) > limits.least(True)
