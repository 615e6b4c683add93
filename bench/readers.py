"""Times the reading of one mesh in four formats, beside every reader that is installed here.

    python bench/readers.py [MESH] [--repeats 3] [--folder DIR]

MESH is written once as binary and ASCII STL and PLY. Every reading is a process of its own; the time is that of the
call, after the imports and with the file in the page cache; the least of the repeats counts, and the peak memory is
what the system says of the process, interpreter and imports included.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from rasterslice.intake import read_mesh
from rasterslice.weld import vertex_ids

MESH = Path(__file__).resolve().parents[2] / "shared" / "models" / "lucy_1M.ply"
FORMATS = ("binary.stl", "binary.ply", "ascii.stl", "ascii.ply")
REACH = {"binary.stl": 0.05, "binary.ply": 0.1, "ascii.stl": 1.5, "ascii.ply": 0.5}  # seconds

#: package: (statements before the clock, the call, formats)
READERS = {
    "rasterslice": ("from rasterslice.intake import read_mesh", "len(read_mesh(path).triangles)", FORMATS),
    "trimesh": ("import trimesh", "len(trimesh.load(path, process=False).faces)", FORMATS),
    "stl": ("from stl import mesh, Mode; m = Mode.ASCII if 'ascii' in path else Mode.BINARY",
            "len(mesh.Mesh.from_file(path, calculate_normals=False, mode=m).vectors)", ("binary.stl", "ascii.stl")),
    "meshio": ("import meshio", "len(meshio.read(path).cells_dict['triangle'])", FORMATS),
    "open3d": ("import open3d", "len(open3d.io.read_triangle_mesh(path).triangles)", FORMATS),
}  # fmt: skip

CHILD = """
import sys, time, json, pathlib
path = sys.argv[1]
{setup}
start = time.perf_counter()
count = {call}
seconds = time.perf_counter() - start
status = pathlib.Path("/proc/self/status").read_text()
peak = int(status.split("VmHWM:")[1].split()[0]) / 1024
print(json.dumps([count, seconds, peak]))
"""


def write(mesh: Path, folder: Path) -> None:
    """Write the mesh in four formats, as programs do: nine digits, shared vertices in PLY."""
    triangles = read_mesh(mesh).triangles
    ids, first = vertex_ids(triangles)
    vertices = triangles.reshape(-1, 3)[first]
    rows = np.zeros(len(triangles), [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    rows["v"] = triangles
    count = np.uint32(len(triangles)).tobytes()
    (folder / "binary.stl").write_bytes(b"binary".ljust(80) + count + rows.tobytes())
    faces = np.zeros(len(ids), [("n", "u1"), ("v", "<i4", 3)])
    faces["n"], faces["v"] = 3, ids
    head = f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
    head += f"element face {len(ids)}\nproperty list uchar int vertex_indices\nend_header\n"
    (folder / "binary.ply").write_bytes(
        ("ply\nformat binary_little_endian 1.0\n" + head).encode() + vertices.astype("<f4").tobytes() + faces.tobytes()
    )
    with (folder / "ascii.ply").open("w") as file:
        file.write("ply\nformat ascii 1.0\n" + head)
        file.writelines(f"{x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in vertices.tolist())
        file.writelines(f"3 {a} {b} {c}\n" for a, b, c in ids.tolist())
    form = " facet normal %.8e %.8e %.8e\n  outer loop\n" + "   vertex %.8e %.8e %.8e\n" * 3 + "  endloop\n endfacet\n"
    with (folder / "ascii.stl").open("w") as file:
        file.write("solid lucy\n")
        file.writelines(form % (0, 0, 1, *t) for t in triangles.reshape(-1, 9).tolist())
        file.write("endsolid lucy\n")


def measure(package: str, path: Path, repeats: int) -> tuple[int, float, float] | str:
    """Return facets, seconds and peak MiB, or why there are none."""
    setup, call, formats = READERS[package]
    if path.name not in formats:
        return "-"
    results = []
    root = str(Path(__file__).resolve().parents[1])
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([root, os.environ.get("PYTHONPATH", "")])}
    for _ in range(repeats):
        command = [sys.executable, "-c", CHILD.format(setup=setup, call=call), str(path)]
        done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
        if done.returncode:
            return done.stderr.strip().splitlines()[-1][:40] if done.stderr.strip() else f"exit {done.returncode}"
        results.append(json.loads(done.stdout.splitlines()[-1]))
    return results[0][0], min(r[1] for r in results), min(r[2] for r in results)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh", type=Path, nargs="?", default=MESH)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--folder", type=Path, help="where the four files are kept; default a temporary one")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = args.folder or Path(scratch)
        if not all((folder / name).exists() for name in FORMATS):
            folder.mkdir(exist_ok=True)
            write(args.mesh, folder)
        readers = [name for name in READERS if name == "rasterslice" or importlib.util.find_spec(name)]
        print("seconds (peak MiB); not installed: " + (", ".join(sorted(READERS.keys() - readers)) or "none"))
        print(f"{'':12}{'MB':>6}{'reach':>7}{'limit':>7}" + "".join(f"{name:>18}" for name in readers))
        for name in FORMATS:
            path = folder / name
            size = path.stat().st_size
            found = [measure(reader, path, args.repeats) for reader in readers]
            facets = found[0][0] if isinstance(found[0], tuple) else 0
            limit = 1.5 * max(size, 36 * facets) / 2**20 + 100
            cells = [f"{f[1]:.3f} ({f[2]:.0f})" if isinstance(f, tuple) else f for f in found]
            print(f"{name:12}{size / 1e6:6.0f}{REACH[name]:7.2f}{limit:7.0f}" + "".join(f"{c:>18}" for c in cells))


if __name__ == "__main__":
    main()
