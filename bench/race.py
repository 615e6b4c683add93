"""Races the whole job against polygon slicers on the same machine, in turns.

    python bench/race.py [MESH...] [--rounds 5] [--pitch 0.2] [--json results.jsonl]

The job: layers of 0.4 mm, paths of 1.5 mm, full fill, scaffold of 5 mm under every overhang; from process start to
the last byte. Peers: ``../shared/tools/vector_pipeline.py`` (simplified to 0.01 mm, two processes) and PrusaSlicer,
where they are there. Each round runs everyone once, so that a slow spell of the machine hits all; medians and ratios of
medians are printed. Before a time is printed, the areas of our layers are held against the exact ones.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
import platform
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from stages import PEER, SHARED, Cost, apart, compile_package, measure

from rasterslice.intake import read_mesh

MODELS = [SHARED / "models" / "lucy_1M.ply", SHARED / "models" / "lucy_4k.stl"]
# The same job: support under every overhang, solid fill, one perimeter.
PRUSA_SETTINGS = """
--export-gcode --layer-height 0.4 --first-layer-height 0.4 --nozzle-diameter 1.5 --perimeters 1 --extrusion-width 1.5
--first-layer-extrusion-width 1.5 --perimeter-extrusion-width 1.5 --external-perimeter-extrusion-width 1.5
--infill-extrusion-width 1.5 --solid-infill-extrusion-width 1.5 --top-infill-extrusion-width 1.5
--support-material-extrusion-width 1.5 --fill-pattern rectilinear --fill-density 100% --top-solid-layers 0
--bottom-solid-layers 0 --support-material --support-material-auto --support-material-threshold 89
--support-material-spacing 0 --support-material-interface-layers 0 --support-material-contact-distance 0
--support-material-xy-spacing 0 --support-material-style grid --support-material-pattern rectilinear --skirts 0
--brim-width 0 --bed-shape 0x0,600x0,600x600,0x600 --max-print-height 400
"""


def write_stl(mesh: Path, target: Path) -> Path:
    """Write a mesh as binary STL for the slicers that read nothing else."""
    triangles = read_mesh(mesh).triangles
    layout = np.dtype([("normal", "<f4", 3), ("vertices", "<f4", (3, 3)), ("attribute", "<u2")])
    record = np.zeros(len(triangles), layout)
    record["vertices"] = triangles
    target.write_bytes(b"\0" * 80 + np.uint32(len(triangles)).tobytes() + record.tobytes())
    return target


def parameter_file(mesh: Path, pitch: float, folder: Path) -> Path:
    """Write the job as a parameter file."""
    path = folder / "job.txt"
    off = ["0 0 0 0"] * 3  # scaling, rotation, translation
    lines = ["1", f'"{mesh}"', "0", "2", "1", "1e-4", "1.5 1.5", "0.4", "45", *off, "0 1", "0 1", "1 1 1", "5"]
    path.write_text("\n".join([*lines, f"pitch = {pitch:g}", ""]))
    return path


def quality(folder: Path) -> tuple[float, float]:
    """Return the worst area error of a layer, mm^2 a loop beyond 0.02 %, and the relative error of all together.

    The run fails when the second exceeds 0.002 %.
    """
    with (folder / "layers.csv").open() as file:
        rows = [r for r in csv.DictReader(file) if r["part_area_exact"]]
    columns = ("part_area", "part_area_exact", "part_contours")
    area, exact, loops = (np.array([float(r[k]) for r in rows]) for k in columns)
    total = abs(area.sum() / exact.sum() - 1.0) if len(rows) else math.nan
    if not total < 2e-5:
        raise SystemExit(f"quality: {len(rows)} layers with an exact area, all together off by {100 * total:.4f} %")
    return float(((np.abs(area - exact) - 2e-4 * exact) / np.maximum(loops, 1)).max()), float(total)


def racers(mesh: Path, pitch: float, folder: Path) -> dict[str, list[str]]:
    """Return the command of everyone who is there."""
    job = parameter_file(mesh, pitch, folder)
    stl = apart(write_stl, mesh, folder / "mesh.stl")
    ours = [sys.executable, "-m", "rasterslice", str(job), "-o", str(folder / "ours"), "--json"]
    found = {"rasterslice": ours}
    if PEER.exists():
        found["vector_pipeline"] = [sys.executable, str(PEER), str(mesh), "--simplify", "0.01", "--jobs", "2"]
    prusa = shutil.which("prusa-slicer")
    if prusa:
        found["prusa-slicer"] = [prusa, *PRUSA_SETTINGS.split(), "--output", str(folder / "out.gcode"), str(stl)]
    return found


def commit() -> str:
    """Return the commit that is measured."""
    run = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    return run.stdout.strip()


def race(mesh: Path, args: argparse.Namespace) -> None:
    """Run the rounds for one mesh and print its table."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        commands = racers(mesh, args.pitch, folder)
        measure(commands["rasterslice"])  # fills the kernel cache
        costs: dict[str, list[Cost]] = {who: [] for who in commands}
        for _ in range(args.rounds):
            for who, command in commands.items():
                if hasattr(os, "sync"):
                    os.sync()  # what one has left to be written to the disk is not charged to the next
                costs[who].append(measure(command))
        worst, total = quality(folder / "ours")
        volume = sum(float(r["part_area"]) for r in csv.DictReader((folder / "ours" / "layers.csv").open())) * 0.4e-3
    theirs = [re.search(r"part volume ([0-9.]+)", c.output) for c in costs.get("vector_pipeline", [])[:1]]
    print(f"\n{mesh.name}, pitch {args.pitch:g} mm, {args.rounds} rounds")
    print(f"area of a layer off by {worst:.4f} mm^2 a loop beyond 0.02 % at worst, of all by {100 * total:.5f} %")
    print(f"volume {volume:.2f} cm3" + (f", vector_pipeline {theirs[0][1]} cm3" if theirs and theirs[0] else ""))
    print("| who | wall s (all rounds) | CPU s | peak MiB | wall ratio | CPU ratio |\n|---|---|---|---|---|---|")
    ours = [statistics.median(getattr(c, k) for c in costs["rasterslice"]) for k in ("wall", "cpu")]
    for who, runs in costs.items():
        wall, cpu = (statistics.median(getattr(c, k) for c in runs) for k in ("wall", "cpu"))
        peak = max(c.peak_mib for c in runs)
        spread = f"{min(c.wall for c in runs):.2f} to {max(c.wall for c in runs):.2f}"
        ratios = f"{wall / ours[0]:.2f} | {cpu / ours[1]:.2f}"
        print(f"| {who} | {wall:.2f} ({spread}) | {cpu:.2f} | {peak:.0f} | {ratios} |")
        if args.json:
            record = {
                "mesh": mesh.name, "pitch": args.pitch, "who": who, "wall": [c.wall for c in runs],
                "cpu": [c.cpu for c in runs], "peak_mib": peak, "machine": platform.machine(), "cores": os.cpu_count(),
                "python": platform.python_version(), "commit": commit(),
            }  # fmt: skip
            with args.json.open("a") as file:
                file.write(json.dumps(record) + "\n")


def main() -> None:
    """Race on every mesh."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="*", type=Path, default=MODELS)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--pitch", type=float, default=0.2)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    compile_package()
    for mesh in args.meshes:
        race(mesh.resolve(), args)


if __name__ == "__main__":
    main()
