"""Closed, consistently oriented test bodies, their files, and the way tests slice them.

Every body stands on z = 0 (the transform of the parameter file then changes nothing), has float32 vertices,
and is 10 to 40 mm large unless its name says otherwise.
"""

from __future__ import annotations

import functools
import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import manifold3d
import numpy as np
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).resolve().parents[1]
SHARED_MODELS = ROOT.parent / "shared" / "models"
EXAMPLE = ROOT / "examples" / "body.ply"

AROUND, ALONG = 384, 192  # facets around a round body and along half of its meridian


@dataclass(frozen=True)
class Body:
    """Vertices (V, 3) float64, mm, and faces (T, 3), counter-clockwise from outside."""

    vertices: np.ndarray
    faces: np.ndarray

    def triangles(self) -> np.ndarray:
        """Return (T, 3, 3) float32, as the files hold them."""
        return self.vertices.astype(np.float32)[self.faces]

    def moved(self, shift) -> Body:
        return Body(self.vertices + np.asarray(shift, float), self.faces)

    def turned(self, *euler: float) -> Body:
        """Rotate about x, the new y and the new z by degrees, and stand the body on z = 0."""
        turn = Rotation.from_euler("XYZ", euler, degrees=True)
        return Body(turn.apply(self.vertices), self.faces).grounded()

    def grounded(self) -> Body:
        return self.moved((0, 0, -self.vertices[:, 2].min()))

    def inverted(self) -> Body:
        return Body(self.vertices, self.faces[:, ::-1])

    def mirrored(self) -> Body:
        """Mirror in x and keep the facets outward."""
        return Body(self.vertices * (-1, 1, 1), self.faces[:, ::-1])

    def without(self, *faces: int) -> Body:
        return Body(self.vertices, np.delete(self.faces, faces, axis=0))

    def flipped(self, *faces: int) -> Body:
        turned = self.faces.copy()
        turned[list(faces)] = turned[list(faces)][:, ::-1]
        return Body(self.vertices, turned)

    def rounded(self, step: float) -> Body:
        """Put every vertex on multiples of a step."""
        return Body(np.round(self.vertices / step) * step, self.faces)


def join(*bodies: Body) -> Body:
    """Put bodies into one file, shells and all, without any boolean."""
    first = np.cumsum([0] + [len(b.vertices) for b in bodies])
    faces = [b.faces + n for b, n in zip(bodies, first, strict=False)]
    return Body(np.concatenate([b.vertices for b in bodies]), np.concatenate(faces))


# ---------------------------------------------------------------- shapes
def revolve(profile, around: int = AROUND, phase: float = 0.0, fair: bool = True) -> Body:
    """Turn a closed counter-clockwise (r, z) profile about z.

    With `fair` the radii grow by the 1e-5 that makes each ring of chords enclose the area of its circle.
    """
    profile = np.asarray(profile, float)
    step = 2 * math.pi / around
    grow = math.sqrt(step / math.sin(step)) if fair else 1.0
    angle = phase + step * np.arange(around)
    vertices, rows = [], []
    for r, z in profile:
        on_axis = abs(r) < 1e-12
        ring = np.zeros((1, 2)) if on_axis else grow * r * np.stack([np.cos(angle), np.sin(angle)], 1)
        rows.append(np.full(around, len(vertices)) if on_axis else len(vertices) + np.arange(around))
        vertices.extend((x, y, z) for x, y in ring)
    faces = []
    for i, a in enumerate(rows):
        b = rows[(i + 1) % len(rows)]
        a1, b1 = np.roll(a, -1), np.roll(b, -1)
        faces += [np.stack([a, a1, b1], 1), np.stack([a, b1, b], 1)]
    faces = np.concatenate(faces)
    real = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return Body(np.asarray(vertices, float), faces[real])


def sphere(radius: float, around: int = AROUND, along: int = ALONG) -> Body:
    """A ball whose chords straddle the true surface (faceting error under 0.003 px at 0.2 mm for r = 15)."""
    step = math.pi / along
    lat = np.linspace(-math.pi / 2, math.pi / 2, along + 1)
    r = radius * (1 + step**2 / 12)
    profile = np.stack([r * np.cos(lat), r * np.sin(lat)], 1)
    profile[[0, -1], 0] = 0.0
    return revolve(profile, around).grounded()


def torus(major: float, minor: float, around: int = AROUND, along: int = 256) -> Body:
    step = 2 * math.pi / along
    t = step * np.arange(along)
    r = minor * (1 + step**2 / 12)
    return revolve(np.stack([major + r * np.cos(t), r * np.sin(t)], 1), around).grounded()


def cone(radius: float, height: float, around: int = AROUND) -> Body:
    return revolve([(0, 0), (radius, 0), (0, height)], around)


def prism(rings, z0: float, z1: float) -> Body:
    """Extrude rings: outer ones counter-clockwise, holes clockwise."""
    rings = [np.asarray(r, float) for r in rings]
    flat = np.concatenate(rings)
    n = len(flat)
    caps = np.asarray(manifold3d.triangulate(rings), np.int64)
    first = np.cumsum([0] + [len(r) for r in rings])
    here = np.arange(n)
    after = np.concatenate([first[i] + np.roll(np.arange(len(r)), -1) for i, r in enumerate(rings)])
    walls = [np.stack([here, after, after + n], 1), np.stack([here, after + n, here + n], 1)]
    vertices = np.concatenate([np.column_stack([flat, np.full(n, z)]) for z in (z0, z1)])
    return Body(vertices, np.concatenate([caps[:, ::-1], caps + n, *walls]))


def rectangle(x0: float, y0: float, x1: float, y1: float) -> np.ndarray:
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], float)


def circle(radius: float, centre=(0.0, 0.0), n: int = AROUND) -> np.ndarray:
    """A polygon of the circle's area."""
    step = 2 * math.pi / n
    t = step * np.arange(n)
    r = radius * math.sqrt(step / math.sin(step))
    return np.stack([centre[0] + r * np.cos(t), centre[1] + r * np.sin(t)], 1)


def box(low, high) -> Body:
    return prism([rectangle(*low[:2], *high[:2])], low[2], high[2])


# x, y, radius of the plate's holes; no line of a hatch of 1.5 or 2 mm is tangent to anything
HOLES = ((-9.1, -5.1, 2.5), (0.2, 4.1, 4.0), (10.1, -4.1, 3.0))


def plate() -> Body:
    """40 x 24.75 x 2 mm with three round holes."""
    holes = [circle(r, (x, y))[::-1] for x, y, r in HOLES]
    return prism([rectangle(-20, -12.375, 20, 12.375), *holes], 0.0, 2.0)


def frame() -> Body:
    """A square with a square hole."""
    return prism(
        [rectangle(-12.375, -12.375, 12.375, 12.375), rectangle(-6.3, -6.3, 6.3, 6.3)[::-1]], 0.0, 2.0
    )


def stepped_pyramid(step: float = 0.5, rise: float = 0.25, levels: int = 6) -> Body:
    """Square terraces, each wall `step` high: every terrace lies in a plane at rise + i * step."""
    side = [20.0 - 2.5 * i for i in range(levels)]
    height = [0.0] + [rise + step * (i + 1) for i in range(levels)]
    profile = [(0.0, 0.0)]
    for i, s in enumerate(side):
        r = s / 2 * math.sqrt(2)
        profile += [(r, height[i]), (r, height[i + 1])]
    profile.append((0.0, height[-1]))
    return revolve(profile, 4, math.pi / 4, fair=False).rounded(2.0**-10)


def spindle() -> Body:
    """A round body whose vertices all lie in the planes 0.25 + i * 0.5."""
    return revolve([(0, 0), (7, 0), (9, 0.75), (12, 1.25), (6, 2.25), (0, 3.75)], 360)


def pillars(n: int = 4, side: float = 2.6, gap: float = 3.1) -> Body:
    """A plate on a grid of n x n square pillars: touching shells, with overhangs between them."""
    span = (n - 1) * (side + gap) + side
    posts = [
        box((i * (side + gap), j * (side + gap), 0), (i * (side + gap) + side, j * (side + gap) + side, 4))
        for i in range(n)
        for j in range(n)
    ]
    return join(*posts, box((0, 0, 4), (span, span, 6)))


def star(points: int = 5, outer: float = 14.0, inner: float = 6.0, turn: float = 0.1) -> Body:
    """A prism with acute and reflex corners."""
    t = turn + math.pi * np.arange(2 * points) / points
    r = np.where(np.arange(2 * points) % 2, inner, outer)
    return prism([np.stack([r * np.cos(t), r * np.sin(t)], 1)], 0.0, 2.0)


def wedge(angle: float, turn: float, length: float = 16.0) -> Body:
    """An isosceles triangle with the apex angle given, degrees, turned in the plane."""
    half = math.radians(angle) / 2
    ring = np.array([(0, 0), (length * math.cos(half), -length * math.sin(half))])
    ring = np.concatenate([ring, [(length * math.cos(half), length * math.sin(half))]])
    c, s = math.cos(math.radians(turn)), math.sin(math.radians(turn))
    return prism([ring @ np.array([(c, s), (-s, c)])], 0.0, 1.2)


def two_spheres() -> Body:
    return join(sphere(9.0), sphere(9.0).moved((8.0, 3.0, 0.0)))


def two_boxes() -> Body:
    """Two boxes that cross at an angle."""
    a = box((-12, -4, 0), (12, 4, 3))
    return join(a, a.turned(0, 0, 37.0).moved((1.0, 2.0, 0)))


def box_cavity() -> Body:
    """A box with a box-shaped void that reaches no surface."""
    return join(box((-10, -8, 0), (10, 8, 6)), box((-5, -4, 1), (6, 3, 5)).inverted())


def nested_shells() -> Body:
    """A box wholly inside a box, both outward: winding 2 in the inner one."""
    return join(box((-10, -8, 0), (10, 8, 6)), box((-5, -4, 1), (6, 3, 5)))


def touching_boxes() -> Body:
    """Two boxes with one whole face in common."""
    return join(box((-9, -6, 0), (1.3, 6, 3)), box((1.3, -6, 0), (11, 6, 3)))


def touching_unequal() -> Body:
    """A small box set against the middle of the side of a larger one: T-junctions in the section."""
    return join(box((-9, -6, 0), (1.3, 6, 3)), box((1.3, -2.7, 0), (11, 3.1, 3)))


def stacked_boxes() -> Body:
    """Two boxes with a common horizontal face in a slicing plane (thickness 0.5)."""
    return join(box((-9, -6, 0), (9, 6, 1.25)), box((-9, -6, 1.25), (9, 6, 3)))


def fin() -> Body:
    """A free wall 1.0 mm thick beside a block: no bead of 1.5 mm fits it."""
    wall = prism([rectangle(0, 0, 20, 1.0)], 0, 2).turned(0, 0, 11.0)
    return join(wall, box((0, -12, 0), (20, -4, 2)))


def long_bar() -> Body:
    """12 facets, 150 mm long, at an odd angle in the plane."""
    return box((0, 0, 0), (150, 12, 2)).turned(0, 0, 23.7)


def ball_on_stem() -> Body:
    """A ball on a slender stem (shells overlap): a wide overhang over open ground."""
    stem = revolve([(0, 0), (2.5, 0), (2.5, 8), (0, 8)], 96)
    return join(stem, sphere(7.0, 256, 128).moved((0, 0, 5.0)))


def cube() -> Body:
    return box((-10, -10, 0), (10, 10, 6))


def wall_facets(body: Body, axis: int, value: float) -> list[int]:
    """Return the facets that lie in the plane where a coordinate has a value."""
    flat = (np.abs(body.vertices[body.faces][:, :, axis] - value) < 1e-9).all(axis=1)
    return [int(i) for i in np.flatnonzero(flat)]


def cube_gap(axis: int, side: float, count: int) -> Body:
    """The cube with facets of one wall left out."""
    return cube().without(*wall_facets(cube(), axis, side)[:count])


def cube_flip() -> Body:
    return cube().flipped(wall_facets(cube(), 0, 10.0)[0])


BODIES: dict[str, Callable[[], Body]] = {
    "sphere": lambda: sphere(15.0).moved((0.31, -0.17, 0)),
    "torus": lambda: torus(12.0, 5.0).moved((-0.23, 0.41, 0)),
    "cone": lambda: cone(16.0, 24.0).moved((0.07, 0.33, 0)),
    "tilted_box": lambda: box((-11, -8, -6), (11, 8, 6)).turned(31.0, 23.0, 17.0),
    "cube": cube,
    "plate": plate,
    "frame": frame,
    "star": star,
    "two_spheres": two_spheres,
    "two_boxes": two_boxes,
    "box_cavity": box_cavity,
    "nested_shells": nested_shells,
    "touching_boxes": touching_boxes,
    "touching_unequal": touching_unequal,
    "stacked_boxes": stacked_boxes,
    "stepped_pyramid": stepped_pyramid,
    "spindle": spindle,
    "fin": fin,
    "long_bar": long_bar,
    "pillars": pillars,
    "ball_on_stem": ball_on_stem,
    "ball_mirrored": lambda: ball_on_stem().mirrored(),
    "gap_x_one": lambda: cube_gap(0, 10.0, 1),
    "gap_x_two": lambda: cube_gap(0, 10.0, 2),
    "gap_y_one": lambda: cube_gap(1, 10.0, 1),
    "cube_flip": cube_flip,
}


@functools.cache
def body(name: str) -> Body:
    return BODIES[name]()


@functools.cache
def triangles(name: str) -> np.ndarray:
    """Return the facets of a named body as the slicer sees them, float64."""
    return body(name).triangles().astype(np.float64)


# ---------------------------------------------------------------- files
STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
PLY_FACE = np.dtype([("n", "u1"), ("v", "<i4", 3)])


def write_stl(path: Path, triangles: np.ndarray) -> Path:
    """Write binary STL from (T, 3, 3)."""
    facets = np.zeros(len(triangles), STL)
    facets["corners"] = triangles
    path.write_bytes(b"test body".ljust(80) + np.uint32(len(facets)).tobytes() + facets.tobytes())
    return path


def write_ply(path: Path, body: Body) -> Path:
    """Write binary little-endian PLY."""
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(body.vertices)}"]
    head += [f"property float {c}" for c in "xyz"] + [f"element face {len(body.faces)}"]
    head += ["property list uchar int vertex_indices", "end_header", ""]
    faces = np.zeros(len(body.faces), PLY_FACE)
    faces["n"], faces["v"] = 3, body.faces
    data = body.vertices.astype("<f4").tobytes() + faces.tobytes()
    path.write_bytes("\n".join(head).encode() + data)
    return path


def read_ply(path: Path) -> Body:
    """Read a binary PLY of float x y z and three-cornered faces."""
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    head = data[:end].decode().splitlines()
    assert "format binary_little_endian 1.0" in head
    count = {w[1]: int(w[2]) for w in (line.split() for line in head) if w[0] == "element"}
    properties = [line.split()[1:] for line in head if line.startswith("property")]
    assert properties[:3] == [["float", c] for c in "xyz"] and len(properties) == 4, properties
    vertices = np.frombuffer(data, "<f4", 3 * count["vertex"], end).reshape(-1, 3)
    faces = np.frombuffer(data, PLY_FACE, count["face"], end + 12 * count["vertex"])
    assert (faces["n"] == 3).all()
    return Body(vertices.astype(np.float64), faces["v"].astype(np.int64))


@functools.cache
def read_grounded(path: Path) -> Body:
    """Read a PLY and stand it on z = 0, as a parameter file without a transform does."""
    return read_ply(path).grounded()


# ---------------------------------------------------------------- parameters and slicing
ENTRIES: dict[str, Any] = {  # the paper's Table 1, without the number and names of the files
    "inexact": 0,
    "option": 2,
    "scaffolding": 1,
    "tolerance": "1e-4",
    "widths": (1.5, 1.5),
    "thickness": 0.4,
    "smooth_angle": 45,
    "scaling": (0, 0, 0, 0),
    "rotation": (0, 0, 0, 0),
    "translation": (0, 0, 0, 0),
    "part_fraction": (0, 1),
    "scaffold_subset": (0, 1),
    "copies": (1, 1, 1),
    "buffer": 5,
}


def text(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def write_params(folder: Path, mesh: Path, **settings: Any) -> Path:
    """Write a parameter file; settings that are no entry of the paper become ``key = value`` lines."""
    entries = ENTRIES | {k: v for k, v in settings.items() if k in ENTRIES}
    lines = ["1", str(mesh), *(text(v) for v in entries.values())]
    lines += [f"{k} = {text(v)}" for k, v in settings.items() if k not in ENTRIES]
    path = folder / "params.txt"
    path.write_text("\n".join(lines) + "\n")
    return path


def prepare_file(mesh: Path, run: dict[str, Any] | None = None, **settings: Any) -> Any:
    """Return the `Slicing` of a mesh file; `run` goes to `prepare`."""
    from rasterslice.params import read_params
    from rasterslice.slicer import prepare

    with tempfile.TemporaryDirectory() as folder:
        params = read_params(write_params(Path(folder), mesh.resolve(), **settings))
    return prepare(params, **({"regions": True} | (run or {})))


def slice_file(mesh: Path, run: dict[str, Any] | None = None, **settings: Any) -> list[Any]:
    """Slice a mesh file; `run` goes to `prepare`. Return the layers bottom-up."""
    layers = list(prepare_file(mesh, run, **settings).layers())
    assert layers, f"{mesh} gave no layers"
    assert [k.index for k in layers] == list(range(len(layers)))[::-1], "layers must come top-down, none lost"
    return layers[::-1]


def slice_body(body: Body, run: dict[str, Any] | None = None, **settings: Any) -> list[Any]:
    with tempfile.TemporaryDirectory() as folder:
        return slice_file(write_stl(Path(folder) / "body.stl", body.triangles()), run, **settings)


@functools.cache
def sliced(name: str, **settings: Any) -> tuple[Any, ...]:
    """Slice a named body once for all tests."""
    return tuple(slice_body(body(name), **settings))
