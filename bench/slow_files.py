"""Reads files that were made to be slow: large garbage, long lines, many solids, promises; prints seconds and MiB.

    python bench/slow_files.py [--mb 40] [--only TEXT]

Each is read by a process of its own, as `rasterslice info` reads it. What becomes of it is the last column.
"""

from __future__ import annotations

import argparse
import math
import random
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

READ = """
import resource, sys, time
from pathlib import Path
from rasterslice.errors import RasterSliceError
from rasterslice.survey import survey_file
start = time.perf_counter()
try:
    found = f"{survey_file(Path(sys.argv[1]))['facets']} facets"
except RasterSliceError as error:
    found = str(error).removeprefix(sys.argv[1])[:110]
seconds = time.perf_counter() - start
print(f"{seconds:.2f} | {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10} | {found}")
"""
FACET = b"facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 %d\nendloop\nendfacet\n"
STAR = [(math.cos(i * math.pi / 50) * (1 + i % 2), math.sin(i * math.pi / 50) * (1 + i % 2)) for i in range(100)]


def words(size: int, seed: int = 1) -> bytes:
    rng = random.Random(seed)
    line = b" ".join(rng.randbytes(4).hex().encode() for _ in range(4000)) + b"\n"
    return line * (size // len(line))


def facets(size: int) -> bytes:
    return b"".join(FACET % (i % 9) for i in range(size // len(FACET)))


def stars(size: int) -> bytes:
    count = size // 500
    head = b"OFF\n%d %d 0\n" % (100 * 20, count)
    points = b"".join(b"%.6f %.6f %d\n" % (*p, z) for z in range(20) for p in STAR)
    rows = [b"100 " + b" ".join(b"%d" % (100 * z + i) for i in range(100)) + b"\n" for z in range(20)]
    return head + points + b"".join(rows[k % 20] for k in range(count))


def comb(size: int) -> bytes:
    """One polygon of many teeth."""
    n = 9_000
    points = [(i, (i % 2) * 5 if 0 < i < n - 1 else -1) for i in range(n)]
    rows = b"".join(b"v %d %d 0\n" % p for p in points)
    return rows + (b"f " + b" ".join(b"%d" % (i + 1) for i in range(n)) + b"\n") * 3


def nested(size: int) -> bytes:
    return (b"solid a\nendsolid a\n" * (size // 19)) + b"solid b\n" + FACET % 1 + b"endsolid b\n"


def stl(corners: NDArray[np.floating]) -> bytes:
    out = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    out["corners"] = corners
    return bytes(80) + len(out).to_bytes(4, "little") + out.tobytes()


def tetrahedra(size: int, room: float) -> bytes:
    """Make closed shells, every second one inside out, strewn in a cube of so many of their sizes."""
    rng = np.random.default_rng(1)
    one = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]]
    many = one * rng.random((size // 200, 1, 1, 1)) + room * rng.random((size // 200, 1, 1, 3))
    many[::2] = many[::2, :, ::-1]
    return stl(many.reshape(-1, 3, 3))


def unwelded(size: int) -> bytes:
    """Make a surface of which no two facets share a vertex."""
    side, rng = math.isqrt(size // 100), np.random.default_rng(1)
    x, y = np.meshgrid(np.arange(side), np.arange(side))
    at = np.stack([x, y, np.sin(x / 9) + np.sin(y / 9)], axis=-1).reshape(-1, 1, 3)
    square = np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]])
    corners = (at[:, None] + square).reshape(-1, 3, 3)
    return stl(corners + rng.normal(0, 1e-3, corners.shape))


PLY = b"ply\nformat %s 1.0\nelement vertex %d\nproperty float x\nproperty float y\nproperty float z\n"
LIST = b"element face %d\nproperty list %s int vertex_indices\nend_header\n"
CASES: dict[str, Callable[[int], bytes]] = {
    "garbage.stl": words,
    "garbage of solid.stl": lambda n: b"solid x\n" + words(n),
    "garbage after a facet.stl": lambda n: b"solid x\n" + FACET % 1 + words(n),
    "garbage after the end.stl": lambda n: b"solid x\n" + FACET % 1 + b"endsolid x\n" + words(n),
    "one line of garbage.stl": lambda n: b"solid x " + words(n).replace(b"\n", b" "),
    "facets on one line.stl": lambda n: (b"solid x\n" + facets(n) + b"endsolid x\n").replace(b"\n", b" "),
    "facets without normals.stl": lambda n: (b"solid\n" + facets(n) + b"endsolid\n").replace(b" normal 0 0 1", b""),
    "facets of nan(ind).stl": lambda n: (b"solid\n" + facets(n) + b"endsolid\n").replace(b"0 0 1", b"-nan(ind) 0 0"),
    "empty solids.stl": nested,
    "a solid a facet.stl": lambda n: b"".join(
        b"solid %d\n%sendsolid\n" % (i, FACET % (i % 9)) for i in range(n // 125)),
    "comments.stl": lambda n: b"# comment\n" * (n // 10) + b"solid\n" + FACET % 1 + b"endsolid\n",
    "a promise.stl": lambda n: bytes(80) + b"\xff" * 4 + bytes(n),
    "a promise.ply": lambda n: PLY % (b"binary_little_endian", 10**17) + LIST % (10**17, b"uchar") + bytes(n),
    "lists of 0.ply": lambda n: PLY % (b"binary_little_endian", 1) + LIST % (n, b"uchar") + bytes(12 + n),
    "long lists.ply": lambda n: PLY % (b"ascii", 1) + LIST % (9, b"uint") + b"0 0 0\n" + b"999999 " + b"0 " * (n // 2),
    "garbage.ply": lambda n: PLY % (b"ascii", 9) + LIST % (9, b"uchar") + words(n),
    "garbage.obj": words,
    "keywords.obj": lambda n: b"g a\n" * (n // 4),
    "vertices.obj": lambda n: b"v 1 2 3\n" * (n // 8) + b"f 1 2 3\n",
    "stars of 100 corners.off": stars,
    "combs of 9000 corners.obj": comb,
    "loose facets.stl": lambda n: stl(np.random.default_rng(1).random((n // 50, 3, 3))),
    "an unwelded surface.stl": unwelded,
    "shells apart.stl": lambda n: tetrahedra(n, 1000),
    "shells heaped on each other.stl": lambda n: tetrahedra(n, 5),
}  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mb", type=int, default=40)
    parser.add_argument("--only", default="", help="part of the names of the files")
    args = parser.parse_args()
    size = args.mb * 1_000_000
    print("| file | MB | seconds | MiB | outcome |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name, make in ((n, m) for n, m in CASES.items() if args.only in n):
            path = Path(folder) / name
            path.write_bytes(make(size))
            found = subprocess.run([sys.executable, "-c", READ, str(path)], capture_output=True, text=True, timeout=600)
            text = found.stdout.strip() or "failed: " + found.stderr.strip().splitlines()[-1]
            print(f"| `{name}` | {path.stat().st_size / 1e6:.0f} | {text} |", flush=True)
            path.unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main())
