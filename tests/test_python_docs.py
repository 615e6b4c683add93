"""The page about Python is true: its blocks run, and make its pictures."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import cv2

DOCS = Path(__file__).parents[1] / "docs"


def test_the_blocks_run_and_make_the_pictures(tmp_path: Path) -> None:
    spec = importlib.util.spec_from_file_location("make_pictures", DOCS / "make_pictures.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    made = module.run(tmp_path)
    assert [path.name for path in made] == ["depth.png", "shapes.png"]
    page = (DOCS / "python.md").read_text(encoding="utf-8")
    for path in made:
        assert f"(pictures/{path.name})" in page
        assert (DOCS / "pictures" / path.name).exists()
        assert cv2.imread(str(path)).std() > 10
