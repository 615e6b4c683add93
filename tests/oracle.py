"""Exact polygons to hold the slicer against: float64 sections, manifold3d offsets and booleans, distances.

Loops are lists of (n, 2) arrays, closed without a repeated point, with the solid on the left. Round joins are
chords within `ARC` mm of their arc, so an offset of the oracle is itself wrong by at most that much.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import manifold3d
import numpy as np
import shapely
from manifold3d import CrossSection, FillRule, JoinType, OpType
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

Loops = Sequence[np.ndarray]

ARC = 2e-4  # mm between a round join's chord and its arc (0.001 px)
CORNER_TURN = 20.0  # degrees
CORNER_RADIUS = 0.5  # mm
MERGE = 1e-3  # mm: micro-edges shorter than this are merged before turns are measured


# ---------------------------------------------------------------- sections
@dataclass(frozen=True)
class Segments:
    """All segments of all planes: solid on the left of start -> end.

    `tail` and `head` number the end points: one per (plane, facet edge), so that facets that share an edge
    share the number; nothing is linked by comparing floats.
    """

    plane: np.ndarray  # (S,)
    start: np.ndarray  # (S, 2)
    end: np.ndarray
    tail: np.ndarray  # (S,)
    head: np.ndarray
    planes: int

    def areas(self) -> np.ndarray:
        """Shoelace sum of every plane, mm^2."""
        twice = self.start[:, 0] * self.end[:, 1] - self.start[:, 1] * self.end[:, 0]
        return np.bincount(self.plane, 0.5 * twice, self.planes)

    def loop_counts(self) -> np.ndarray:
        """Number of loops of every plane (of connected chains of segments)."""
        if not len(self.plane):
            return np.zeros(self.planes, int)
        n = int(max(self.tail.max(), self.head.max())) + 1
        ones = np.ones(len(self.tail), np.int8)
        count, label = connected_components(coo_array((ones, (self.tail, self.head)), (n, n)), False)
        plane = np.zeros(count, np.int64)
        plane[label[self.tail]] = self.plane
        return np.bincount(plane, minlength=self.planes)


def section(triangles: np.ndarray, heights, vertex: np.ndarray | None = None) -> Segments:
    """Cut triangles (T, 3, 3) by horizontal planes in float64; a vertex with z <= plane is below.

    `vertex` (T, 3) numbers the corners; without it, corners at the same place are one vertex.
    """
    triangles = np.asarray(triangles, np.float64)
    heights = np.asarray(heights, np.float64)
    if vertex is None:
        vertex = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 3)
    vertex = np.asarray(vertex, np.int64)
    total = int(vertex.max()) + 1
    low, high = triangles[..., 2].min(axis=1), triangles[..., 2].max(axis=1)
    first, last = np.searchsorted(heights, low), np.searchsorted(heights, high)
    count = last - first
    tri = np.repeat(np.arange(len(triangles)), count)
    plane = np.arange(len(tri)) - np.repeat(np.cumsum(count) - count, count) + first[tri]
    corner, ids, h = triangles[tri], vertex[tri], heights[plane]
    above = corner[..., 2] > h[:, None]
    # turn each facet so that corner 0 is alone on its side
    alone = np.where(above.sum(axis=1) == 1, above.argmax(axis=1), (~above).argmax(axis=1))
    order = (alone[:, None] + np.arange(3)) % 3
    corner = np.take_along_axis(corner, order[..., None], 1)
    ids = np.take_along_axis(ids, order, 1)
    lone_up = above[np.arange(len(tri)), alone]
    p, pid = _cross(corner[:, 0], corner[:, 1], ids[:, 0], ids[:, 1], h)
    q, qid = _cross(corner[:, 2], corner[:, 0], ids[:, 2], ids[:, 0], h)
    up = lone_up[:, None]
    keys = np.concatenate([(plane * total + i) * total + j for i, j in (pid, qid)])
    assert not len(heights) or len(heights) < 2**63 // total**2
    nodes = np.unique(keys, return_inverse=True)[1].reshape(2, -1)
    return Segments(
        plane,
        np.where(up, p, q),
        np.where(up, q, p),
        np.where(lone_up, nodes[0], nodes[1]),
        np.where(lone_up, nodes[1], nodes[0]),
        len(heights),
    )


def _cross(a, b, ia, ib, h):
    """Where edges a-b meet their plane, computed from the lower vertex number on, and both numbers."""
    swap = (ia > ib)[:, None]
    a, b = np.where(swap, b, a), np.where(swap, a, b)
    t = ((h - a[:, 2]) / (b[:, 2] - a[:, 2]))[:, None]
    return a[:, :2] + t * (b[:, :2] - a[:, :2]), (np.minimum(ia, ib), np.maximum(ia, ib))


def loops_by_plane(cut: Segments) -> list[list[np.ndarray]]:
    """Link the segments of closed bodies into loops, plane by plane; raise where they do not balance."""
    result: list[list[np.ndarray]] = [[] for _ in range(cut.planes)]
    heads, tails = np.sort(cut.head), np.sort(cut.tail)
    if not np.array_equal(heads, tails):
        raise ValueError("open section: end points do not balance")
    by_tail = np.argsort(cut.tail, kind="stable")
    following = by_tail[np.searchsorted(tails, cut.head)]
    # where several loops meet in one point, the n-th to arrive leaves as the n-th
    arrive = np.argsort(cut.head, kind="stable")
    following[arrive] = by_tail
    seen = np.zeros(len(following), bool)
    after = following.tolist()
    for i in range(len(after)):
        if seen[i]:
            continue
        chain, j = [], i
        while not seen[j]:
            seen[j] = True
            chain.append(j)
            j = after[j]
        result[int(cut.plane[i])].append(cut.start[chain])
    return result


def slice_loops(triangles: np.ndarray, heights) -> list[list[np.ndarray]]:
    """Return the loops of each plane."""
    return loops_by_plane(section(triangles, heights))


# ---------------------------------------------------------------- regions
def region(loops: Loops, rule: FillRule = FillRule.NonZero) -> CrossSection:
    """Unite loops by winding number."""
    loops = [p for p in loops if len(p) >= 3]
    return CrossSection(loops, rule) if loops else CrossSection()


def regions(triangles: np.ndarray, heights) -> list[CrossSection]:
    return [region(loops) for loops in slice_loops(triangles, heights)]


def arc_segments(radius: float, tolerance: float = ARC) -> int:
    """Chords of a full circle that stay within the tolerance of it (a multiple of four)."""
    return max(16, 4 * math.ceil(math.pi / math.acos(1 - min(tolerance, radius) / radius) / 4))


def grow(shape: CrossSection, distance: float) -> CrossSection:
    """Offset with round joins; negative shrinks."""
    if shape.is_empty() or distance == 0:
        return shape
    return shape.offset(distance, JoinType.Round, 2.0, arc_segments(abs(distance)))


def unite(shapes: Sequence[CrossSection]) -> CrossSection:
    return CrossSection.batch_boolean(list(shapes), OpType.Add) if len(shapes) else CrossSection()


def unions_from_top(parts: Sequence[CrossSection], wanted: Sequence[int], mode: str = "above") -> dict:
    """Return, for the wanted layers, the union of all layers above (`own`: and of the layer itself)."""
    result, total, top = {}, CrossSection(), len(parts)
    for k in sorted(wanted, reverse=True):
        first = k if mode == "own" else k + 1
        total = unite([total, *parts[first:top]])
        top = min(top, first)
        result[k] = total
    return result


def scaffold(above: CrossSection, part: CrossSection, buffer: float) -> CrossSection:
    return grow(above, buffer) - part


def polygons(shape: CrossSection) -> list[np.ndarray]:
    """Outer loops counter-clockwise, holes clockwise."""
    return [np.asarray(p, np.float64) for p in shape.to_polygons()]


def to_shapely(shape: CrossSection) -> shapely.Geometry:
    """Return a valid (Multi)Polygon."""
    pieces = []
    for piece in shape.decompose():
        rings = polygons(piece)
        if not rings:  # nothing decomposes into one empty piece
            continue
        outer = max(range(len(rings)), key=lambda i: loop_area(rings[i]))
        pieces.append(shapely.Polygon(rings[outer], [r for i, r in enumerate(rings) if i != outer]))
    return shapely.union_all(shapely.make_valid(np.array(pieces))) if pieces else shapely.MultiPolygon()


def manifold_regions(triangles: np.ndarray, heights) -> list[CrossSection]:
    """Cut by manifold3d itself (float32 vertices), to hold this module's own sections against."""
    vertices, faces = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    mesh = manifold3d.Mesh(vertices.astype(np.float32), faces.reshape(-1, 3).astype(np.uint32))
    solid = manifold3d.Manifold(mesh)
    assert solid.status() == manifold3d.Error.NoError, solid.status()
    return [solid.slice(float(z)) for z in heights]


# ---------------------------------------------------------------- measures of loops
def loop_area(loop: np.ndarray) -> float:
    p = loop - loop[0]
    q = np.roll(p, -1, axis=0)
    return 0.5 * float(np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]))


def area(loops: Loops) -> float:
    return sum(loop_area(p) for p in loops)


def edges(loops: Loops) -> np.ndarray:
    """Return (E, 2, 2)."""
    if not len(loops):
        return np.empty((0, 2, 2))
    return np.concatenate([np.stack([p, np.roll(p, -1, axis=0)], 1) for p in map(np.asarray, loops)])


def distance(points: np.ndarray, loops: Loops) -> np.ndarray:
    """Exact distance of points from the edges of loops; infinite when there are none."""
    points = np.asarray(points, np.float64)
    both = edges(loops)
    if not len(both) or not len(points):
        return np.full(len(points), np.inf)
    tree = shapely.STRtree(shapely.linestrings(both))
    (which, _), found = tree.query_nearest(shapely.points(points), return_distance=True, all_matches=False)
    result = np.full(len(points), np.nan)
    result[which] = found
    return result


def inside(points: np.ndarray, loops: Loops) -> np.ndarray:
    """Whether points lie inside (winding number not 0), by crossings of a ray along +x."""
    both = edges(loops)
    winding = np.zeros(len(points), np.int64)
    x, y = points[:, 0, None], points[:, 1, None]
    for part in np.array_split(both, max(1, len(points) * len(both) // 4_000_000)):
        (ax, ay), (bx, by) = part[:, 0].T, part[:, 1].T
        up, down = (ay <= y) & (by > y), (ay > y) & (by <= y)
        left = (bx - ax) * (y - ay) - (x - ax) * (by - ay)
        winding += (up & (left > 0)).sum(axis=1) - (down & (left < 0)).sum(axis=1)
    return winding != 0


def signed_distance(points: np.ndarray, loops: Loops) -> np.ndarray:
    """Exact signed distance, negative inside."""
    points = np.asarray(points, np.float64)
    return np.where(inside(points, loops), -1.0, 1.0) * distance(points, loops)


def sample(loops: Loops, step: float = 0.1) -> np.ndarray:
    """Return points on loops, no farther apart than a step: all vertices and evenly spread ones between."""
    both = edges(loops)
    if not len(both):
        return np.empty((0, 2))
    length = np.hypot(*(both[:, 1] - both[:, 0]).T)
    count = np.maximum(1, np.ceil(length / step).astype(int))
    which = np.repeat(np.arange(len(both)), count)
    t = (np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)) / count[which]
    return both[which, 0] + t[:, None] * (both[which, 1] - both[which, 0])


# ---------------------------------------------------------------- corners
def without_micro_edges(loop: np.ndarray, shortest: float = MERGE) -> np.ndarray:
    """Drop vertices nearer than `shortest` to the last one kept."""
    keep = [0]
    for i in range(1, len(loop)):
        if np.hypot(*(loop[i] - loop[keep[-1]])) >= shortest:
            keep.append(i)
    if len(keep) > 1 and np.hypot(*(loop[keep[-1]] - loop[0])) < shortest:
        keep.pop()
    return loop[keep]


def turns(loop: np.ndarray) -> np.ndarray:
    """Degrees by which a loop turns at each vertex, left positive."""
    before, after = loop - np.roll(loop, 1, axis=0), np.roll(loop, -1, axis=0) - loop
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    return np.degrees(np.arctan2(cross, (before * after).sum(axis=1)))


def corners(loops: Loops, turn: float = CORNER_TURN) -> np.ndarray:
    """Return the vertices that turn by more than some degrees."""
    found = [np.empty((0, 2))]
    for loop in loops:
        short = without_micro_edges(np.asarray(loop))
        if len(short) < 3:
            found.append(short)
        else:
            found.append(short[np.abs(turns(short)) > turn])
    return np.concatenate(found)


def away(points: np.ndarray, places: np.ndarray, radius: float = CORNER_RADIUS) -> np.ndarray:
    """Whether points are farther than a radius from all places."""
    if not len(places) or not len(points):
        return np.ones(len(points), bool)
    return cKDTree(places).query(points)[0] > radius


@dataclass
class Comparison:
    """How far two contour sets lie apart, sampled on both."""

    samples: int  # all
    judged: int  # those far from corners
    worst: float  # of those, mm
    beyond: int  # of all, those farther than the limit
    slivers: (
        int  # of those beyond and far from corners, the ones where the exact shape is thinner than a pixel
    )
    where: tuple[float, float]  # the worst place

    @property
    def share(self) -> float:
        return self.beyond / max(1, self.samples)


def compare(found: Loops, exact: Loops, limit: float = 0.05, step: float = 0.1) -> Comparison:
    """Compare contours both ways; the corners are those of the exact ones."""
    a, b = sample(found, step), sample(exact, step)
    points = np.concatenate([a, b])
    gap = np.concatenate([distance(a, exact), distance(b, found)])
    free = away(points, corners(exact))
    judged = np.where(free, gap, -1.0)
    i = int(judged.argmax()) if len(points) else -1
    return Comparison(
        len(points),
        int(free.sum()),
        float(judged[i]) if i >= 0 and judged[i] >= 0 else 0.0,
        int((gap > limit).sum()),
        int(in_slivers(points[free & (gap > limit)], exact).sum()),
        tuple(points[i].round(3).tolist()) if i >= 0 else (0.0, 0.0),
    )


def in_slivers(points: np.ndarray, loops: Loops, thin: float = 0.2) -> np.ndarray:
    """Whether points lie on tongues or clefts of a shape that are thinner than `thin`."""
    shape = region(loops)
    if not len(points) or shape.is_empty():
        return np.zeros(len(points), bool)
    tongues = shape - grow(grow(shape, -thin / 2), thin / 2 + 1e-3)
    clefts = grow(grow(shape, thin / 2), -thin / 2 - 1e-3) - shape
    thinnest = polygons(grow(tongues + clefts, 0.02))
    return inside(points, thinnest) if thinnest else np.zeros(len(points), bool)


# ---------------------------------------------------------------- shape of loops
def is_simple(loop: np.ndarray) -> bool:
    """Whether a loop neither crosses nor touches itself."""
    return len(loop) >= 3 and bool(shapely.is_simple(shapely.linearrings(loop)))


def disjoint(loops: Loops) -> bool:
    """Whether no loop crosses another or touches itself or another."""
    return bool(shapely.is_simple(shapely.multilinestrings([shapely.linearrings(p) for p in loops])))


def depths(loops: Loops) -> list[int]:
    """How many other loops each loop lies in (judged by its first vertex, even-odd)."""
    shapes = [shapely.Polygon(p) for p in loops]
    tree = shapely.STRtree([shapely.box(*s.bounds) for s in shapes])
    return [
        sum(
            1
            for j in tree.query(shapely.Point(loop[0]))
            if j != i and shapely.contains_xy(shapes[j], *loop[0])
        )
        for i, loop in enumerate(loops)
    ]


def wrongly_oriented(loops: Loops) -> list[int]:
    """Loops whose sense does not fit their depth: outer counter-clockwise, holes clockwise."""
    return [i for i, d in enumerate(depths(loops)) if (loop_area(loops[i]) > 0) != (d % 2 == 0)]


def spacing(loops: Loops) -> float:
    """Shortest step between successive points."""
    both = edges(loops)
    return float(np.hypot(*(both[:, 1] - both[:, 0]).T).min()) if len(both) else math.inf


# ---------------------------------------------------------------- fill
def hatch(shape: CrossSection, width: float, angle: float, lift: float = 0) -> tuple[np.ndarray, np.ndarray]:
    """Clip lines at (j + 1/2) width, lifted by some mm, by shapely.

    Return j (n,) and the ends along the line's direction (n, 2), sorted; the direction is (cos, sin) of the
    angle and j counts along its left normal.
    """
    turned = to_shapely(shape.rotate(-angle))
    if turned.is_empty:
        return np.empty(0, int), np.empty((0, 2))
    x0, y0, x1, y1 = turned.bounds
    j = np.arange(math.floor(y0 / width - 0.5), math.ceil(y1 / width - 0.5) + 1)
    y = (j + 0.5) * width + lift
    ends = np.stack([np.column_stack([np.full(len(y), x), y]) for x in (x0 - 1, x1 + 1)], 1)
    parts, which = shapely.get_parts(
        shapely.intersection(shapely.linestrings(ends), turned), return_index=True
    )
    is_line = (shapely.get_type_id(parts) == 1) & ~shapely.is_empty(parts)
    bounds = shapely.bounds(parts[is_line])
    order = np.lexsort((bounds[:, 0], j[which[is_line]]))
    return j[which[is_line]][order], bounds[order][:, [0, 2]]


def along(lines: np.ndarray, width: float, angle: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Put lines (n, 2, 2) into the form of `hatch`: j, ends, and how far each strays from its row, mm."""
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    u, v = lines @ np.array([c, s]), lines @ np.array([-s, c])
    j = np.round(v.mean(axis=1) / width - 0.5).astype(int)
    off = np.abs(v - (j[:, None] + 0.5) * width).max(axis=1)
    u = np.sort(u, axis=1)
    order = np.lexsort((u[:, 0], j))
    return j[order], u[order], off[order]
