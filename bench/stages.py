"""Times the whole job by stage, as a user runs it, and optionally a polygon pipeline beside it.

    python bench/stages.py [MESH] [--pitch 0.2] [--repeats 3] [--peer]

The first run fills the kernel cache and is not counted. Every run is a process of its own: wall time, CPU seconds and
peak memory are those that the system reports for it.
"""

from __future__ import annotations

import argparse
import compileall
import csv
import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

SHARED = Path(__file__).resolve().parents[2] / "shared"
MESH = SHARED / "models" / "lucy_1M.ply"
PEER = SHARED / "tools" / "vector_pipeline.py"


class Cost(NamedTuple):
    """What one process took."""

    wall: float
    cpu: float
    peak_mib: float
    output: str


def compile_package() -> None:
    """Compile our modules, as pip does when it installs them: a checkout may be told not to keep bytecode."""
    compileall.compile_dir(str(Path(__file__).resolve().parents[1] / "rasterslice"), quiet=1)


def apart(function: Callable[[Path, Path], Path], source: Path, target: Path) -> Path:
    """Make a file in a process of its own: what a parent once held counts as the peak of its children."""
    child = multiprocessing.get_context("spawn").Process(target=function, args=(source, target))
    child.start()
    child.join()
    return target


def measure(command: list[str]) -> Cost:
    """Run a command and return its cost; end with its own words if it fails."""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        start = time.perf_counter()
        process = subprocess.Popen(command, stdout=out, stderr=err)
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        err.seek(0)
        if process.returncode:
            raise SystemExit(f"{' '.join(command)} ended with {process.returncode}:\n{err.read()}")
        return Cost(wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, out.read())


def parameters(args: argparse.Namespace) -> str:
    """Return the parameter file of the benchmark: upright, scaffold, fill."""
    return "\n".join(
        [
            "1", f'"{args.mesh.resolve()}"', "0", "2", "1", "1e-4", f"{args.width:g} {args.width:g}",
            f"{args.thickness:g}", "45", "0 0 0 0", "0 0 0 0", "0 0 0 0", "0 1", "0 1", "1 1 1",
            f"{args.buffer:g}", f"pitch = {args.pitch:g}", "",
        ]
    )  # fmt: skip


def ours(args: argparse.Namespace, folder: Path) -> tuple[list[Cost], list[dict[str, Any]]]:
    """Run rasterslice, once to warm the kernel cache and then `repeats` times."""
    params = folder / "params.txt"
    params.write_text(args.params.read_text() if args.params else parameters(args))
    command = [sys.executable, "-m", "rasterslice", str(params), "-o", str(folder / "out"), "--no-progress"]
    measure([*command, "--quiet"])
    costs, manifests = [], []
    for _ in range(args.repeats):
        costs.append(measure([*command, "--quiet"]))
        manifests.append(json.loads((folder / "out" / "manifest.json").read_text()))
    return costs, manifests


def worst_area(table: Path) -> str:
    """Return the layer whose area differs most from the exact one, by what the issue allows for."""
    with table.open(newline="") as file:
        rows = [r for r in csv.DictReader(file) if r["part_area"] and r["part_area_exact"]]
    if not rows:
        return "no layer has an exact area"
    area, exact, contours = (
        np.array([float(r[c]) for r in rows]) for c in ("part_area", "part_area_exact", "part_contours")
    )
    error = np.abs(area - exact)
    used = error / (2e-4 * exact + 0.03 * np.maximum(contours, 1))
    relative = error / np.maximum(exact, 1e-9)
    lines = []
    for what, i in zip(
        ("largest", "largest relative", "nearest its limit"),
        (error.argmax(), relative.argmax(), used.argmax()),
        strict=True,
    ):
        lines.append(
            f"area error, {what:<18} layer {rows[i]['layer']:>4}, z {rows[i]['z']}: {error[i]:.4f} of "
            f"{exact[i]:.4f} mm^2 ({100 * relative[i]:.4f} %), {100 * used[i]:.0f} % of the limit"
        )
    total = abs(area.sum() - exact.sum()) / exact.sum()
    return "\n".join([*lines, f"layers compared {len(rows)}, error of their area in all {100 * total:.5f} %"])


def show(costs: list[Cost], manifests: list[dict[str, Any]]) -> None:
    """Print the table of stages: the median of the runs, and the range."""
    first = manifests[0]
    grid = first["grid"]
    print(
        f"{first['layers']} layers of {grid['width']} x {grid['height']} px, {first['facets']} facets, "
        f"{first['device']}, batch {first['batch']}, {os.cpu_count()} cores, {len(costs)} runs"
    )
    print(f"{'stage':<24}{'median':>9}{'least':>9}{'most':>9}")
    rows = {name: [m["seconds"].get(name, 0.0) for m in manifests] for name in first["seconds"]}
    rows["process: wall s"] = [c.wall for c in costs]
    rows["process: cpu s"] = [c.cpu for c in costs]
    for name, values in rows.items():
        print(f"{name:<24}{np.median(values):>9.3f}{min(values):>9.3f}{max(values):>9.3f}")
    peaks = [c.peak_mib for c in costs]
    print(f"{'process: peak MiB':<24}{np.median(peaks):>9.0f}{min(peaks):>9.0f}{max(peaks):>9.0f}")


def peer(args: argparse.Namespace, own: list[Cost]) -> None:
    """Run the polygon pipeline as often and print the ratios of the medians."""
    command = [sys.executable, str(PEER), str(args.mesh), "--layer", str(args.thickness), "--width", str(args.width),
               "--buffer", str(args.buffer), "--simplify", "0.01", "--jobs", "2"]  # fmt: skip
    costs = [measure(command) for _ in range(args.repeats)]
    print(f"\npolygon pipeline, --simplify 0.01 --jobs 2\n{costs[-1].output.rstrip()}\n")
    print(f"{'':<24}{'ours':>9}{'peer':>9}{'ratio':>9}")
    for field, label in (("wall", "wall s"), ("cpu", "cpu s"), ("peak_mib", "peak MiB")):
        a, b = (float(np.median([getattr(c, field) for c in some])) for some in (own, costs))
        print(f"{label:<24}{a:>9.2f}{b:>9.2f}{b / a:>9.2f}")


def main() -> None:
    """Read the arguments, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh", type=Path, nargs="?", default=MESH)
    parser.add_argument("--params", type=Path, help="a parameter file instead; it names the mesh by an absolute path")
    parser.add_argument("--pitch", type=float, default=0.2)
    parser.add_argument("--thickness", type=float, default=0.4)
    parser.add_argument("--width", type=float, default=1.5)
    parser.add_argument("--buffer", type=float, default=5.0)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--peer", action="store_true", help="also run the polygon pipeline, and print ratios")
    args = parser.parse_args()
    compile_package()
    for needed in [args.params or args.mesh, *([PEER] if args.peer else [])]:
        if not needed.is_file():
            parser.error(f"{needed}: no such file")
    with tempfile.TemporaryDirectory(prefix="bench-stages-") as folder:
        costs, manifests = ours(args, Path(folder))
        show(costs, manifests)
        print(worst_area(Path(folder) / "out" / "layers.csv"))
    if args.peer:
        peer(args, costs)


if __name__ == "__main__":
    main()
