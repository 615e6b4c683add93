"""Make ``body.ply``: a swan with raised wings on a stepped plinth, 77 mm high.

It is small and has what is hard to build: overhangs (wings, neck, tail, beak), holes (the wings meet above
the back, arches go through the plinth), thin parts (the wings, 1.3 to 2.4 mm) and sharp edges (the plinth).
The swan is the zero set of a field, a blend of a few solids; the plinth is joined to it exactly.

Needs what the tests need: ``pip install .[test]``, then ``python examples/make_body.py``.
"""

from pathlib import Path

import manifold3d
import numpy as np
from numpy.typing import ArrayLike, NDArray
from skimage.measure import marching_cubes

Array = NDArray[np.float64]

CELL = 0.75  # mm between samples of the field
LOW, HIGH = np.array([-42.0, -22.0, 6.0]), np.array([46.0, 22.0, 82.0])
PLINTH = 13.0  # mm, its height


def blend(a: Array, b: Array, radius: float) -> Array:
    """Return the union of two fields with a fillet."""
    h = np.clip(0.5 + 0.5 * (b - a) / radius, 0.0, 1.0)
    return b + (a - b) * h - radius * h * (1.0 - h)


def ellipsoid(p: Array, centre: ArrayLike, radii: ArrayLike) -> Array:
    """Return a field close to the distance from an ellipsoid."""
    q = (p - np.asarray(centre)) / np.asarray(radii)
    k = np.linalg.norm(q, axis=-1)
    return k * (k - 1.0) / np.maximum(np.linalg.norm(q / np.asarray(radii), axis=-1), 1e-9)


def limb(p: Array, points: ArrayLike, radii: ArrayLike) -> Array:
    """Return the distance from a round tube along a polyline whose radius changes."""
    points, radii = np.asarray(points, float), np.asarray(radii, float)
    best = np.full(p.shape[:-1], np.inf)
    for a, b, ra, rb in zip(points, points[1:], radii, radii[1:], strict=False):
        t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(p - a - t[..., None] * (b - a), axis=-1) - ra - t * (rb - ra))
    return best


def smooth_line(points: ArrayLike, count: int) -> Array:
    """Return Catmull-Rom points between the inner ones of `points`."""
    p = np.asarray(points, float)
    t = np.linspace(0, len(p) - 3 - 1e-9, count)
    i, u = t.astype(int), (t % 1)[:, None]
    a, b, c, d = p[i], p[i + 1], p[i + 2], p[i + 3]
    return 0.5 * (2 * b + (c - a) * u + (2 * a - 5 * b + 4 * c - d) * u**2 + (3 * b - a - 3 * c + d) * u**3)


def wing(p: Array) -> Array:
    """Return the field of both wings: feathered fans that bulge outward and meet at the top."""
    x, y, z = p[..., 0], np.abs(p[..., 1]), p[..., 2]
    dx, dz = x - 9.0, z - 20.0
    r, angle = np.hypot(dx, dz), np.arctan2(dz, -dx)  # 0 points back, pi/2 up
    feather = np.abs(np.sin(4.5 * (angle + 0.25)))
    reach = 17.0 + 25.0 * np.exp(-(((angle - 0.95) / 0.48) ** 2)) + 5.0 * feather
    rise = np.clip((z - 20.0) / 37.0, 0.0, 1.25)
    sheet = 9.5 + 9.0 * np.sin(np.pi * np.minimum(rise, 1.0) ** 0.8) - 9.5 * rise**2.5
    half = 0.65 + 0.55 * feather * np.clip(r / 26.0, 0.0, 1.0)
    shell = (np.abs(y - sheet) - half) * 0.8
    fan = np.maximum(r - reach, r * np.maximum(0.1 - angle, angle - 1.55))
    return -blend(-shell, -fan * 0.8, 0.8)


def swan(p: Array) -> Array:
    """Return the field of the whole bird at (..., 3) points, mm; negative inside."""
    body = ellipsoid(p, (0, 0, 23), (23, 13, 11.5))
    body = blend(body, ellipsoid(p, (12, 0, 26), (11, 9.5, 9.5)), 6.0)
    flat = p * (1.0, 0.6, 1.0)
    tail = limb(flat, [(-14, 0, 26), (-26, 0, 31), (-35, 0, 38)], [7.0, 4.0, 1.2])
    neck = smooth_line(
        [(0, 0, 20), (14, 0, 27), (24, 0, 36), (22, 0, 48),
         (15.5, 0, 58), (17, 0, 69), (25, 0, 74), (33, 0, 70)], 40,
    )  # fmt: skip
    bird = blend(body, tail, 5.0)
    bird = blend(bird, limb(p, neck, np.linspace(7.5, 2.9, 40) + 0.8 * np.linspace(-1, 1, 40) ** 8), 4.0)
    bird = blend(bird, ellipsoid(p, (26.5, 0, 72.8), (5.2, 3.7, 3.9)), 1.5)
    beak = limb(p * (1, 0.8, 1), [(30, 0, 72), (34, 0, 70.3), (39.5, 0, 67)], [2.6, 1.9, 0.8])
    bird = blend(bird, beak, 0.8)
    for side in (-1, 1):  # eyes
        bird = blend(bird, np.linalg.norm(p - (28.2, 3.0 * side, 74.2), axis=-1) - 0.9, 0.3)
    return blend(bird, wing(p), 2.0)


def gradient(p: Array) -> Array:
    """Return the gradient of the field by central differences."""
    steps = np.eye(3) * 0.02
    return np.stack([swan(p + s) - swan(p - s) for s in steps], -1) / 0.04


def sculpt() -> tuple[Array, NDArray[np.int32]]:
    """Return vertices and facets of the swan, cut flat inside the plinth."""
    axes = [np.arange(a, b, CELL) for a, b in zip(LOW, HIGH, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    values = np.concatenate([swan(slab) for slab in np.array_split(grid, 16)])
    vertices, faces, _, _ = marching_cubes(values, 0.0, spacing=(CELL,) * 3, gradient_direction="descent")
    vertices = vertices.astype(np.float64) + LOW
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    degree = np.bincount(edges.ravel(), minlength=len(vertices))[:, None]

    def toward_mean() -> Array:
        total = np.zeros_like(vertices)
        np.add.at(total, edges[:, 0], vertices[edges[:, 1]])
        np.add.at(total, edges[:, 1], vertices[edges[:, 0]])
        return total / degree - vertices

    for _ in range(4):  # even out the facets along the surface, then go back to the surface
        g = gradient(vertices)
        n = g / np.maximum(np.linalg.norm(g, axis=1, keepdims=True), 1e-9)
        move = 0.5 * toward_mean()
        vertices += move - n * np.sum(move * n, axis=1, keepdims=True)
        g = gradient(vertices)
        step = -swan(vertices)[:, None] * g / np.maximum(np.sum(g * g, axis=1, keepdims=True), 0.1)
        vertices += np.clip(step, -0.2, 0.2)
    for weight in (0.5, -0.53) * 4:  # Taubin: smooths the rims of the wings without shrinking them
        vertices += weight * toward_mean()
    return vertices, faces.astype(np.int32)


def plinth() -> manifold3d.Manifold:
    """Return two steps with cut corners, and three arches through the upper one."""

    def step(x: float, y: float, low: float, high: float, cut: float) -> manifold3d.Manifold:
        corners = [(x, y - cut), (x - cut, y), (cut - x, y), (-x, y - cut),
                   (-x, cut - y), (cut - x, -y), (x - cut, -y), (x, cut - y)]  # fmt: skip
        return manifold3d.CrossSection([corners]).extrude(high - low).translate((0, 0, low))

    def arch(x: float, width: float) -> manifold3d.Manifold:
        turns = np.linspace(0, np.pi, 25)
        top = np.stack([width * np.cos(turns), 4.2 + width * np.sin(turns)], -1)
        outline = manifold3d.CrossSection([np.concatenate([[(-width, 0), (width, 0)], top])])
        return outline.extrude(80).rotate((90, 0, 0)).translate((x, 40, 4))

    return (
        step(34, 22, 0, 4, 6) + step(29, 17, 4, PLINTH, 4) - arch(0, 3.4) - arch(-14, 3.4) - arch(14, 3.4)
    )  # fmt: skip


def write_ply(path: Path, vertices: NDArray[np.float32], faces: NDArray[np.int32]) -> None:
    """Write a binary little-endian PLY."""
    records = np.empty(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    records["count"], records["corners"] = 3, faces
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment rasterslice examples/make_body.py, MIT licence\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(header.encode() + vertices.astype("<f4").tobytes() + records.tobytes())


def main() -> None:
    """Write ``body.ply`` beside this script."""
    vertices, faces = sculpt()
    bird = manifold3d.Manifold(manifold3d.Mesh(vertices.astype(np.float32), faces.astype(np.uint32)))
    if bird.status() != manifold3d.Error.NoError or bird.volume() <= 0:
        raise SystemExit(f"the swan is not closed, or inside out: {bird.status()}, {bird.volume():.0f} mm^3")
    pieces = (bird + plinth()).simplify(0.01).decompose()
    mesh = max(pieces, key=lambda piece: piece.volume()).to_mesh()
    path = Path(__file__).with_name("body.ply")
    write_ply(path, np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts).astype(np.int32))
    print(f"{path}: {len(mesh.tri_verts)} facets, {len(pieces)} piece(s), {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
