"""Which corners of a soup of facets are one vertex: by their bits, or within a tolerance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Ids = NDArray[np.int32]

_CHUNK = 1 << 15  # corners that are hashed at a time
_FACTORS = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)
_CROWD = 16  # neighbours in a cell that are measured one by one; a fuller cell becomes one vertex


def mixed(h: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return numbers whose every bit depends on every bit of the given ones (which are overwritten)."""
    h ^= h >> np.uint64(32)
    h *= np.uint64(0xD6E8FEB86659FD93)
    h ^= h >> np.uint64(32)
    h *= np.uint64(0xD6E8FEB86659FD93)
    h ^= h >> np.uint64(32)
    return h


def hashed(rows: NDArray[np.integer]) -> NDArray[np.uint64]:
    """Return a 64-bit hash of each row of (N, 3) integers: rows of the same hash are taken to be equal."""
    out = np.empty(len(rows), np.uint64)
    for i in range(0, len(rows), _CHUNK):
        part = rows[i : i + _CHUNK].astype(np.uint64)
        h = mixed(part[:, 0] * _FACTORS[0]) + part[:, 1]
        h = mixed(h * _FACTORS[1]) + part[:, 2]
        out[i : i + _CHUNK] = mixed(h * _FACTORS[2])
    return out


def first_of_equal(keys: NDArray[np.uint64]) -> Ids:
    """Return for each key the index of the first one that is equal, through tables of 2^k places."""
    first = np.empty(len(keys), np.int32)
    bits = max(int(len(keys) - 1).bit_length() + 1, 4)
    left, rest = np.arange(len(keys), dtype=np.int32), keys
    while len(left):
        table = np.empty(1 << bits, np.int32)
        place = (rest >> np.uint64(64 - bits)).astype(np.int64)
        table[place[::-1]] = left[::-1]  # where several want one place, the last to come keeps it: the first of all
        owner = table[place]
        same = keys[owner] == rest
        first[left[same]] = owner[same]
        left = left[~same]
        rest = keys[left]
        if len(left):  # other bits choose the places of the next round
            bits = max(len(left).bit_length() + 2, 4)
            keys = mixed(keys * _FACTORS[0])
            rest = keys[left]
    return first


def vertex_ids(triangles: NDArray[np.float32]) -> tuple[Ids, Ids]:
    """Find the vertices of a soup: corners of the same bits are one vertex (0 and -0 are the same).

    Returns
    -------
    ids : (T, 3) int32
        Vertex of each corner, from 0, in the order in which they come.
    first : (V,) int32
        First corner of each vertex.
    """
    corners = triangles.reshape(-1, 3)
    keys = np.empty(len(corners), np.uint64)
    for i in range(0, len(corners), _CHUNK):
        part = corners[i : i + _CHUNK] + np.float32(0.0)  # -0 becomes 0
        keys[i : i + _CHUNK] = hashed(part.view(np.uint32))
    owner = first_of_equal(keys)
    mine = owner == np.arange(len(owner), dtype=np.int32)
    number = np.cumsum(mine, dtype=np.int32) - 1
    return number[owner].reshape(-1, 3), np.flatnonzero(mine).astype(np.int32)


def weld(triangles: NDArray[np.float32], tolerance: float) -> tuple[NDArray[np.float32], int, int]:
    """Make one of vertices that lie within a tolerance, wherever the mesh lies.

    Parameters
    ----------
    triangles : (T, 3, 3) float32
        Overwritten.
    tolerance : float
        mm. Vertices in a chain of such steps become one, which is the first of them in the mesh. Where more
        than 16 vertices share a cube of 2 x 2 x 2 tolerances, they are not measured one by one.

    Returns
    -------
    triangles : (T', 3, 3) float32
        Without the facets that have lost an edge.
    moved : int
        How many vertices were put on another one.
    lost : int
        How many facets were left out.

    Notes
    -----
    Grids of cells of twice the tolerance, shifted by one tolerance along each axis or not, are eight grids.
    Two points within the tolerance share a cell of at least one of them, whatever the offset of the mesh.
    """
    ids, first = vertex_ids(triangles)
    points = triangles.reshape(-1, 3)[first].astype(np.float64)
    parent = np.arange(len(points), dtype=np.int32)
    low = points.min(axis=0)
    for shift in np.ndindex(2, 2, 2):
        cells = np.floor((points - low) / (2 * tolerance) + np.array(shift) / 2).astype(np.int64)
        keys = hashed(cells)
        order = np.argsort(keys, kind="stable")
        _link_cells(points, keys[order], order, tolerance, parent)
    root = components(parent[:, None], parent)
    corner = first[root][ids]
    kept = (corner[:, 0] != corner[:, 1]) & (corner[:, 1] != corner[:, 2]) & (corner[:, 2] != corner[:, 0])
    flat = triangles.reshape(-1, 3)
    moved = int(np.count_nonzero(root != np.arange(len(root))))
    return flat[corner[kept]], moved, int(np.count_nonzero(~kept))


def _link_cells(
    points: NDArray[np.float64], keys: NDArray[np.uint64], order: NDArray[np.int64], tolerance: float, parent: Ids
) -> None:
    """Join, in `parent`, the points of each cell that lie within the tolerance."""
    pairs = []
    for step in range(1, _CROWD + 1):
        near = np.flatnonzero(keys[step:] == keys[:-step]) if step < len(keys) else np.empty(0, np.int64)
        if not len(near):
            break
        a, b = order[near], order[near + step]
        if step < _CROWD:
            close = ((points[a] - points[b]) ** 2).sum(axis=1) <= tolerance**2
            a, b = a[close], b[close]
        pairs.append(np.stack([a, b], axis=1).astype(np.int32))
    if pairs:
        parent[:] = components(np.concatenate(pairs), parent)


def components(groups: Ids, parent: Ids | None = None, count: int = 0) -> Ids:
    """Return for each of some items the least item that it is joined with.

    Parameters
    ----------
    groups : (G, n) int32
        Items that are joined.
    parent : (N,) int32, optional
        What they are joined with so far: an item not above itself each; default nothing.
    count : int
        N, where there is no `parent`.
    """
    parent = np.arange(count, dtype=np.int32) if parent is None else parent.copy()
    columns = list(np.ascontiguousarray(groups.T))
    while True:
        while True:  # every item to its root
            up = parent[parent]
            if np.array_equal(up, parent):
                break
            parent = up
        roots = [parent[column] for column in columns]
        least, active = roots[0], np.zeros(len(columns[0]), bool)
        for other in roots[1:]:
            active |= other != roots[0]
            least = np.minimum(least, other)
        if not active.any():
            return parent
        least = least[active]  # those that agree will agree for ever
        columns = [root[active] for root in roots]
        for root in columns:
            np.minimum.at(parent, root, least)
