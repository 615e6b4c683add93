#!/usr/bin/env python3
"""Measure trajectory, export and simulation, in seconds of CPU; fails where ordering does not halve the travel.

bench/trajectory.py DIR      an output folder, sliced with --export cobra for the comparison of beads
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from rasterslice.cobra.bundle import read_bundle, write_bundle
from rasterslice.cobra.command import simulation
from rasterslice.cobra.records import RecordWriter
from rasterslice.folder import read_manifest
from rasterslice.profile import read_profile
from rasterslice.spool import open_result
from rasterslice.trajectory import Planner


def two_million(paths, target, profile):
    """Write the paths as often as makes 2 million points; return the time and the points."""
    start = time.process_time()
    with RecordWriter(target, "Y", profile) as writer:
        while writer.points < 2_000_000:
            for path in paths:
                writer.add(path)
                if writer.points >= 2_000_000:
                    break
    return time.process_time() - start, writer.points


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    args = parser.parse_args()
    layers, settings = open_result(args.folder), (read_manifest(args.folder) or {})["settings"]
    profile = read_profile(Path(settings["machine"]) if settings.get("machine") else None)

    def planner():
        return Planner(profile, settings["thickness"], settings["slice_position"], settings["smooth_angle"],
                       settings["part_layers_per_slice"])

    start = time.process_time()
    plan = planner()
    paths = list(plan.toolpaths(layers))
    print(f"trajectory  {time.process_time() - start:.2f} s, {plan.tally.runs} runs")
    with tempfile.TemporaryDirectory() as scratch:
        start = time.process_time()
        with RecordWriter(Path(scratch) / "X.RSD", "X", profile) as writer:
            for path in paths:
                writer.add(path)
        seconds = time.process_time() - start
        print(f"records     {seconds:.2f} s, {writer.points} points")
        print("records     {:.2f} s, {} points".format(*two_million(paths, Path(scratch) / "Y.RSD", profile)))
        start = time.process_time()
        folder = Path(scratch) / "x.cobra"
        write_bundle(layers, folder, planner(), "x", (settings["part_width"], settings["support_width"]))
        print(f"export      {time.process_time() - start:.2f} s in all, with every check")
        start = time.process_time()
        report = simulation(read_bundle(folder), beads=False)
        print(f"simulation  {time.process_time() - start:.2f} s, {report['build_hours']} h of building")
    t = plan.tally
    print(f"travel      {t.travel / 1000:.1f} m, {t.file_travel / 1000:.1f} m in the order of the file")
    if t.travel > t.file_travel / 2:
        raise SystemExit("ordering saves less than half of the travel")


if __name__ == "__main__":
    main()
