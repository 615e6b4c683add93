"""Damages mesh files at random and reads them: a clean mesh or a one-line error, soon, and in little memory.

    python bench/fuzz.py [--cases 10000] [--seed 1] [--others]

`--others` adds the formats that trimesh reads. Memory of the process is limited to 2 GB; a case that takes longer than
5 s counts as a hang. Exits with 1 at the first surprise, and leaves the file that caused it.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import random
import resource
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from rasterslice.errors import ModelError
from rasterslice.intake import read_mesh
from rasterslice.survey import survey

LIMIT_SECONDS, LIMIT_BYTES = 5.0, 2 << 30
TESTS = Path(__file__).resolve().parents[1] / "tests"


def flip(raw: bytearray, rng: random.Random) -> None:
    for _ in range(rng.randint(1, 8)):
        raw[rng.randrange(len(raw))] = rng.randrange(256)


def bits(raw: bytearray, rng: random.Random) -> None:
    raw[rng.randrange(len(raw))] ^= 1 << rng.randrange(8)


def cut(raw: bytearray, rng: random.Random) -> None:
    del raw[rng.randrange(len(raw)) :]


def remove(raw: bytearray, rng: random.Random) -> None:
    at = rng.randrange(len(raw))
    del raw[at : at + rng.randint(1, 200)]


def insert(raw: bytearray, rng: random.Random) -> None:
    at = rng.randrange(len(raw))
    raw[at:at] = rng.randbytes(rng.randint(1, 60))


def duplicate(raw: bytearray, rng: random.Random) -> None:
    at = rng.randrange(len(raw))
    raw[at:at] = raw[at : at + rng.randint(1, 500)] * rng.randint(1, 3)


def digits(raw: bytearray, rng: random.Random) -> None:
    places = [i for i, c in enumerate(raw[:2000]) if 48 <= c < 58]
    if places:
        at = rng.choice(places)
        raw[at:at] = bytes(rng.choice(b"0123456789.e-+") for _ in range(rng.randint(1, 12)))


DAMAGES: list[Callable[[bytearray, random.Random], None]] = [flip, bits, cut, remove, insert, duplicate, digits]


def seeds(others: bool) -> dict[str, bytes]:
    """Return one small file of every format and variant."""
    sys.path.insert(0, str(TESTS))
    import meshfiles  # of the tests

    return meshfiles.variants(others)


def check(path: Path, rng: random.Random) -> str:
    """Read a file; return what became of it, or raise."""
    try:
        mesh = read_mesh(path, lenient=rng.random() < 0.5)
    except ModelError as error:
        if "\n" in str(error) or not str(error).startswith(str(path)):
            raise RuntimeError(f"not one line that names the file: {str(error)!r}") from error
        return "refused"
    if not (np.isfinite(mesh.triangles).all() and len(mesh.triangles) and np.isfinite(mesh.low).all()):
        raise RuntimeError("a mesh that is not finite, or empty")
    survey(mesh)
    return "read with notes" if mesh.notes else "read"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--others", action="store_true")
    args = parser.parse_args()
    warnings.simplefilter("error")
    files, rng = seeds(args.others), random.Random(args.seed)
    counts: dict[str, collections.Counter[str]] = {name: collections.Counter() for name in files}
    slowest, start = 0.0, time.perf_counter()
    resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))
    with tempfile.TemporaryDirectory() as folder:
        for case in range(args.cases):
            name = list(files)[case % len(files)]
            raw = bytearray(files[name])
            for _ in range(rng.choice((1, 1, 1, 2, 3))):
                if raw:
                    rng.choice(DAMAGES)(raw, rng)
            path = Path(folder) / name
            path.write_bytes(raw)
            began = time.perf_counter()
            try:
                counts[name][check(path, rng)] += 1
            except Exception as error:
                kept = Path(tempfile.gettempdir()) / f"fuzz-{args.seed}-{case}-{name}"
                kept.write_bytes(raw)
                print(f"case {case}, {name}: {type(error).__name__}: {error}; kept as {kept}")
                raise
            slowest = max(slowest, time.perf_counter() - began)
            if slowest > LIMIT_SECONDS:
                print(f"case {case}, {name}: took {slowest:.1f} s")
                return 1
            with contextlib.suppress(OSError):
                path.unlink()
    for name, found in counts.items():
        print(f"{name:24} " + ", ".join(f"{count} {what}" for what, count in sorted(found.items())))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    seconds = time.perf_counter() - start
    print(f"{args.cases} cases in {seconds:.0f} s, the slowest {slowest:.2f} s, peak {peak:.0f} MiB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
