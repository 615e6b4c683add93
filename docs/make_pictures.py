"""Runs the blocks of docs/python.md on the example and puts the pictures that they make into docs/pictures/."""

from __future__ import annotations

import contextlib
import re
import shutil
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

DOCS = Path(__file__).resolve().parent


def blocks() -> list[str]:
    """Return the Python blocks of the page, in order."""
    return re.findall(r"```python\n(.*?)```", (DOCS / "python.md").read_text(encoding="utf-8"), re.DOTALL)


def run(folder: Path) -> list[Path]:
    """Run the blocks in a folder; return the pictures."""
    from rasterslice import job
    from rasterslice.params import read_params

    for name in ("params.txt", "body.ply"):
        shutil.copyfile(DOCS.parent / "examples" / name, folder / name)
    job.run(replace(read_params(folder / "params.txt"), export=("svg",)))
    names: dict[str, object] = {}
    with contextlib.chdir(folder):
        for block in blocks():
            exec(compile(block, "python.md", "exec"), names)
    return sorted(folder.glob("*.png"))


if __name__ == "__main__":
    (DOCS / "pictures").mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        for picture in run(Path(scratch)):
            print(shutil.copyfile(picture, DOCS / "pictures" / picture.name), file=sys.stderr)
