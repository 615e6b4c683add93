"""CPU seconds of every kernel for one mesh, beside the floor that memory sets.

    python bench/kernels.py [MESH] [--pitch 0.2] [--repeats 3]

Each kernel runs alone, between two waits, and the smallest of the repeats counts: the sum is less than a run takes.
The floor is bytes that have to be read and written once, over the bandwidth of a copy, measured first; buffers that
stay in a cache can beat it. "others" is Python, NumPy and the driver.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from stages import MESH

from rasterslice import batches, device, scaffold, slicer, sorting
from rasterslice import isoline as isolines
from rasterslice.grid import TILE
from rasterslice.params import Params

SLOT, PIECE, FACET, VERTEX = 512, 16, 12, 12


def bandwidth() -> float:
    """Return bytes per second of a copy, read and written."""
    a = np.zeros(1 << 26, np.uint8)
    b = a.copy()
    times = []
    for _ in range(7):
        start = time.perf_counter()
        np.copyto(b, a)
        times.append(time.perf_counter() - start)
    return 2 * a.nbytes / min(times)


def counted(found: Counter[str]) -> None:
    """Count what the stages work on, from now on."""
    place, distance, descend = sorting.place_pieces, batches.part_distance, scaffold.Union.descend
    finish, level_set = batches.scaffold_distance, isolines.isoline

    def placed(opened: Any, tally: Any) -> Any:
        made = place(opened, tally)
        tiles = tally.layers * tally.window.tiles
        found["segments"] += tally.items
        found["pieces"] += int(opened.get(made.start, tiles + 1, np.int32)[-1])
        found["tiles"] += tiles
        found["rows"] += tiles * TILE
        found["layers"] += tally.layers
        return made

    def part(*arguments: Any) -> Any:
        flags = distance(*arguments)
        found["part tiles"] += next(a for a in arguments if hasattr(a, "slots")).slots
        return flags

    def union(self: Any, near: Any, images: Any, layers: int) -> Any:
        above, read = descend(self, near, images, layers)
        return above, tallied("union tiles", above, read)

    def scaffolds(*arguments: Any) -> Any:
        return tallied("scaffold tiles", arguments[-2], finish(*arguments))

    def tallied(what: str, images: Any, read: Any) -> Any:
        def read_and_tally() -> Any:
            before = images.slots
            where = read()
            found[what] += images.slots - before
            return where

        return read_and_tally

    def level(opened: Any, grid: Any, images: Any, count: int, keys: Any, at: int, name: str, sharp: float) -> Any:
        made = level_set(opened, grid, images, count, keys, at, name, sharp)
        found[f"{name} tiles"] += keys.number
        start, end = (opened.get(buffer, count * grid.tiles, np.int32) for buffer in made[1:])
        found[f"{name} pieces"] += int((end - start).sum())
        return made

    sorting.place_pieces, batches.part_distance, scaffold.Union.descend = placed, part, union  # type: ignore[method-assign]
    batches.scaffold_distance, isolines.isoline, scaffold.isoline = scaffolds, level, level


def floors(n: Counter[str]) -> dict[str, int]:
    """Return the bytes that each kernel has to touch."""
    stored, cells = n["part tiles"] + n["scaffold tiles"], n["grown tiles"] + n["inset tiles"]
    level_pieces = n["grown pieces"] + n["inset pieces"]
    return {
        "find_levels": (VERTEX + 4) * n["vertices"],
        "count_segments": FACET * n["facets"] + 4 * n["vertices"],
        "emit_segments": FACET * n["facets"] + (VERTEX + 4) * n["vertices"] + (PIECE + 4) * n["segments"],
        "count_pieces": (PIECE + 4) * n["segments"] + 4 * n["tiles"],
        "sum_rows": 8 * n["rows"],
        "place_pieces": (PIECE + 4) * n["segments"] + PIECE * n["pieces"],
        "find_contacts": PIECE * n["pieces"] + 4 * n["tiles"],
        "part_distance": PIECE * n["pieces"] + 8 * n["tiles"] + (SLOT + 64) * n["part tiles"],
        "grow_union": PIECE * n["pieces"] + 8 * n["tiles"] + SLOT * (n["part tiles"] + n["union tiles"]),
        "count_isoline": SLOT * cells,
        "place_isoline": SLOT * cells + PIECE * level_pieces,
        "scaffold_distance": PIECE * n["grown pieces"] + 17 * n["tiles"] + SLOT * (stored + n["grown tiles"]),
        "isoline_area": SLOT * stored,
        "lost_area": SLOT * n["part tiles"] + PIECE * n["inset pieces"],
        "find_seeds": (SLOT + 32) * stored,
    }


def timed(mesh: Path, pitch: float, count: bool) -> tuple[dict[str, float], Counter[str], float]:
    """Run once; return CPU seconds and calls of each kernel, counts, and CPU seconds of everything."""
    spent: dict[str, float] = defaultdict(float)
    found: Counter[str] = Counter()
    run = device.Device.run

    def watched(self: device.Device, kernel: str, items: int, *arguments: object, group: int = 1) -> None:
        self.finish()
        start = time.process_time()
        run(self, kernel, items, *arguments, group=group)
        self.finish()
        spent[kernel] += time.process_time() - start
        found[f"calls {kernel}"] += 1

    if count:
        counted(found)
    device.Device.run = watched  # type: ignore[method-assign]
    start = time.process_time()
    slicing = slicer.prepare(Params(files=(mesh,), pitch=pitch))
    assert slicing._mesh is not None
    found["facets"], found["vertices"] = slicing.facets, len(slicing._mesh.vertices)
    for _ in slicing.layers():
        pass
    device.Device.run = run  # type: ignore[method-assign]
    return dict(spent), found, time.process_time() - start


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh", type=Path, nargs="?", default=MESH)
    parser.add_argument("--pitch", type=float, default=0.2)
    parser.add_argument("--repeats", type=int, default=3)
    args = parser.parse_args()
    timed(args.mesh, args.pitch, False)
    runs = [timed(args.mesh, args.pitch, False) for _ in range(args.repeats)]
    counts = timed(args.mesh, args.pitch, True)[1]
    best = {k: min(r[0][k] for r in runs) for k in runs[0][0]}
    speed, least = bandwidth(), floors(counts)
    print(f"{args.mesh.name}, pitch {args.pitch:g} mm; a copy moves {speed / 1e9:.1f} GB/s")
    print(", ".join(f"{n} {what}" for what, n in counts.items() if not what.startswith("calls")))
    print("\n| kernel | CPU s | calls | floor s | over floor |\n|---|---|---|---|---|")
    for kernel, seconds in sorted(best.items(), key=lambda item: -item[1]):
        floor = least.get(kernel, 0) / speed
        more = f"{floor:.4f} | {seconds / floor:.0f}" if floor else "|"
        print(f"| `{kernel}` | {seconds:.3f} | {counts['calls ' + kernel]} | {more} |")
    total = min(r[2] for r in runs)
    print(f"\nkernels {sum(best.values()):.2f} s, others {total - sum(best.values()):.2f} s of CPU, after imports")


if __name__ == "__main__":
    main()
