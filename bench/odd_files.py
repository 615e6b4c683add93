"""What becomes of the odd files of other projects: `init`, then a run, file by file.

    python bench/odd_files.py [FOLDER]

Prints the table of docs/odd-files.md: the report of the mesh, the exit code, layers, flags and warnings or the error;
warnings that only count the layers of a flag are left out. Then it counts the outcomes.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

from rasterslice.cli import main

ODD = Path(__file__).resolve().parents[2] / "shared" / "models" / "odd"
COUNTS = {
    "open_edges": "open", "nonmanifold_edges": "non-manifold", "inconsistent_edges": "inconsistent",
    "degenerate_facets": "degenerate", "duplicate_facets": "duplicate", "inverted_shells": "inverted",
}  # fmt: skip
COUNTED = re.compile(r"warning: \d+ of \d+ layers ")


def call(*argv: str) -> tuple[int, str, list[str]]:
    """Run a command; return its exit code, what it printed, and the lines of stderr."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(list(argv))
    return code, out.getvalue(), err.getvalue().splitlines()


def outcome(mesh: Path, folder: Path) -> str:
    """Return one row of the table."""

    def short(text: str) -> str:
        text = text.replace(str(mesh), "").removeprefix("rasterslice: error: ").removeprefix("rasterslice: warning: ")
        return text.removeprefix(": ").removeprefix(":").replace("|", "/")

    code, printed, said = call("info", str(mesh), "--json")
    if code:
        return f"| `{mesh.name}` | | {code}: {short(said[-1])} |"
    report = json.loads(printed)["runs"][0]["result"]
    found = ", ".join(f"{report[name]} {word}" for name, word in COUNTS.items() if report[name]) or "clean"
    params = folder / f"{mesh.name}.txt"
    code, _, said = call("init", str(mesh), "-o", str(params), "--quiet")
    if not code:
        code, printed, said = call(str(params), "--json", "--export", "", "--no-progress")
    if code:
        return f"| `{mesh.name}` | {report['facets']}; {found} | {code}: {short(said[-1])} |"
    manifest: dict[str, Any] = json.loads(printed)
    rows = (Path(params.with_suffix(".slices")) / "layers.csv").read_text().splitlines()[1:]
    flags = sorted({flag for row in rows for flag in row.split(",")[-1].split(";") if flag})
    text = f"{manifest['layers']} layers"
    text += f", {manifest['flagged_layers']} flagged {' '.join(flags)}" if flags else ""
    said = [line for line in said if not COUNTED.search(line)]
    return f"| `{mesh.name}` | {report['facets']}; {found} | {'; '.join([text, *map(short, said)])} |"


def count(rows: list[str]) -> str:
    """Return how many files came to which end."""
    ends = [row.split("|")[3].strip() for row in rows]
    sliced = [end for end in ends if re.match(r"\d+ layers", end)]
    odd = sum(end.split(" ", 1)[1] != "layers" for end in sliced)
    return f"{len(sliced)} slice ({odd} of them with flagged layers or warnings), {len(ends) - len(sliced)} are refused"


if __name__ == "__main__":
    source = Path(sys.argv[1]) if len(sys.argv) > 1 else ODD
    head = "| file | facets; what `info` counts | outcome (a number first: the exit code of the refusal) |"
    print(head + "\n|---|---|---|")
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for path in sorted(source.iterdir()):
            rows.append(outcome(path, Path(scratch)))
            print(rows[-1], flush=True)
    print(f"\n{count(rows)}")
