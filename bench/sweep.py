"""How cost grows: with pitch, facets, layers and the size of a batch.

    python bench/sweep.py [--only pitch,facets,layers,batch] [--repeats 3]

Each row is the command, process start to last byte, with scaffold, fill, spool and table; medians of the repeats, which
take the rows of a table in turn. Facets: the statue of 4000 to 1 M facets as it comes, and of 9 M by cutting its
facets into nine, which leaves its shape as it is.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from pathlib import Path

import numpy as np
from race import parameter_file, write_stl
from stages import SHARED, Cost, apart, compile_package, measure

from rasterslice.intake import read_mesh

STATUE = SHARED / "models" / "lucy_1M.ply"
#: Runs a job with a given batch and consumes its layers, because the command has no switch for it.
BATCH = """
import sys
from rasterslice import slicer
for _ in slicer.prepare(sys.argv[1], batch=int(sys.argv[2])).layers(): pass
"""


def nine_million(mesh: Path, target: Path) -> Path:
    """Write a statue of 1 M facets as binary STL of 9 M: each facet is cut into nine at the thirds of its edges."""
    corner = read_mesh(mesh).triangles.astype(np.float64)
    lattice = {(i, j): (corner[:, 0] * (3 - i - j) + corner[:, 1] * i + corner[:, 2] * j) / 3
               for i in range(4) for j in range(4 - i)}  # fmt: skip
    cut = [((i, j), (i + 1, j), (i, j + 1)) for i in range(3) for j in range(3 - i)]
    cut += [((i + 1, j), (i + 1, j + 1), (i, j + 1)) for i in range(2) for j in range(2 - i)]
    record = np.zeros(9 * len(corner), [("normal", "<f4", 3), ("vertices", "<f4", (3, 3)), ("attribute", "<u2")])
    for n, places in enumerate(cut):
        record["vertices"][n::9] = np.stack([lattice[p] for p in places], axis=1)
    target.write_bytes(b"\0" * 80 + np.uint32(len(record)).tobytes() + record.tobytes())
    return target


def job(folder: Path, name: str, mesh: Path, pitch: float, thickness: float = 0.4) -> list[str]:
    """Return the command of a job of its own."""
    place = folder / name
    place.mkdir(exist_ok=True)
    path = parameter_file(mesh, pitch, place)
    path.write_text(path.read_text().replace("\n0.4\n", f"\n{thickness:g}\n"))
    return [sys.executable, "-m", "rasterslice", str(path), "-o", str(place / "out"), "--quiet"]


def table(title: str, rows: dict[str, list[str]], repeats: int, base: str) -> None:
    """Time the rows in turn and print them, as ratios of one of them too."""
    costs: dict[str, list[Cost]] = {name: [] for name in rows}
    for i in range(repeats + 1):
        for name, command in rows.items():
            cost = measure(command)
            if i:
                costs[name].append(cost)
    middle = {n: [statistics.median(getattr(c, k) for c in runs) for k in ("wall", "cpu")] for n, runs in costs.items()}
    print(f"\n| {title} | wall s | CPU s | peak MiB | wall ratio | CPU ratio |\n|---|---|---|---|---|---|")
    for name, (wall, cpu) in middle.items():
        peak = max(c.peak_mib for c in costs[name])
        ratios = f"{wall / middle[base][0]:.2f} | {cpu / middle[base][1]:.2f}"
        print(f"| {name} | {wall:.2f} | {cpu:.2f} | {peak:.0f} | {ratios} |", flush=True)


def main() -> None:
    """Sweep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="pitch,facets,layers,batch")
    parser.add_argument("--repeats", type=int, default=3)
    args = parser.parse_args()
    wanted = args.only.split(",")
    compile_package()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if "pitch" in wanted:
            rows = {f"{p:g}": job(folder, f"p{p:g}", STATUE, p) for p in (0.5, 0.2, 0.1, 0.05)}
            table("pitch, mm", rows, args.repeats, "0.2")
        if "facets" in wanted:
            one, many = apart(write_stl, STATUE, folder / "1M.stl"), apart(nine_million, STATUE, folder / "9M.stl")
            small = {p.stem: p for p in sorted((SHARED / "models").glob("lucy_*")) if "1M" not in p.stem}
            meshes = {**small, "1M": one, "9M": many}
            table("facets", {n: job(folder, n, m, 0.2) for n, m in meshes.items()}, args.repeats, "1M")
        if "layers" in wanted:
            rows = {f"{t:g}": job(folder, f"t{t:g}", STATUE, 0.2, t) for t in (0.8, 0.4, 0.2, 0.1)}
            table("thickness, mm", rows, args.repeats, "0.4")
        if "batch" in wanted:
            path = parameter_file(STATUE, 0.2, folder)
            rows = {str(n): [sys.executable, "-c", BATCH, str(path), str(n)] for n in (1, 2, 4, 8, 16, 24, 48)}
            table("layers in a batch", rows, args.repeats, "24")


if __name__ == "__main__":
    main()
