"""The straight way through a PLY file gives what the general one gives, or stands aside."""

import sys
from pathlib import Path
from typing import Any

import meshfiles
import numpy as np
import pytest

from rasterslice import plyfile, plyplain
from rasterslice.plyhead import read_header

NATIVE, OTHER = ("<", ">") if sys.byteorder == "little" else (">", "<")
VERTICES, FACES = meshfiles.ball()


def both(path: Path, data: bytes, monkeypatch: pytest.MonkeyPatch) -> tuple[Any, Any]:
    """Return what the straight reader and the general one give."""
    path.write_bytes(data)
    plain = plyplain.read_plain(path, len(data), read_header(path, len(data), True))
    with monkeypatch.context() as patch:
        patch.setattr(plyfile, "read_plain", lambda *_: None)
        return plain, plyfile.read_ply(path, len(data), True)


@pytest.mark.parametrize("rows", [1, 7, 1 << 16])
@pytest.mark.parametrize(
    "settings",
    [{}, {"colour": True}, {"swap": True}, {"index": "uint"}, {"index": "ushort"}, {"length": "int"}, {"end": "\r\n"}],
    ids=str,
)
def test_it_gives_what_the_general_reader_gives(
    settings: dict[str, Any], rows: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plyplain, "_ROWS", rows)
    data = meshfiles.ply(VERTICES, FACES, order=NATIVE, **settings)
    plain, (vertices, faces, notes) = both(tmp_path / "a.ply", data, monkeypatch)
    assert notes == []
    for found, wanted in zip(plain, (vertices, faces), strict=True):
        assert found.dtype == wanted.dtype and found.tobytes() == wanted.tobytes()
    assert len(faces) == len(FACES)


@pytest.mark.parametrize(
    ("faces", "settings"),
    [
        (FACES, {"order": OTHER}),
        (FACES, {"order": ""}),
        (FACES, {"order": NATIVE, "real": "double"}),
        (FACES, {"order": NATIVE, "extra": True}),
        (FACES, {"order": NATIVE, "extra": True, "first": True}),
        (np.array([[0, 1, 2, 3], [3, 2, 1, 0]]), {"order": NATIVE}),
        ([*FACES.tolist()[:9], [0, 1, 2, 3]], {"order": NATIVE}),
        ([*FACES.tolist()[:9], [0, 1]], {"order": NATIVE}),
    ],
    ids=str,
)
def test_it_stands_aside(faces: Any, settings: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain, (_, found, _) = both(tmp_path / "a.ply", meshfiles.ply(VERTICES, faces, **settings), monkeypatch)
    assert plain is None and len(found)


def test_it_stands_aside_where_the_file_is_short(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = meshfiles.ply(VERTICES, FACES, order=NATIVE)
    for lost in (1, 13 * 5, 13 * (len(FACES) - 1)):
        plain, (_, faces, notes) = both(tmp_path / "a.ply", data[:-lost], monkeypatch)
        assert plain is None and len(faces) < len(FACES) and "cut short" in notes[0]


def test_what_is_left_over_is_noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = meshfiles.ply(VERTICES, FACES, order=NATIVE) + b"more"
    plain, (_, faces, notes) = both(tmp_path / "a.ply", data, monkeypatch)
    assert plain is None and len(faces) == len(FACES) and notes == ["4 bytes after the last element: ignored"]


def test_no_memory_is_taken_for_what_a_header_promises(tmp_path: Path) -> None:
    data = meshfiles.ply(VERTICES, FACES, order=NATIVE)
    data = data.replace(f"element face {len(FACES)}\n".encode(), f"element face {10**15}\n".encode())
    (tmp_path / "a.ply").write_bytes(data)
    assert plyplain.read_plain(tmp_path / "a.ply", len(data), read_header(tmp_path / "a.ply", len(data), True)) is None
    assert len(plyfile.read_ply(tmp_path / "a.ply", len(data), True)[1]) == len(FACES)
