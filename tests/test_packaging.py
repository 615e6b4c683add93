"""The kernels are found in a wheel, a source archive and a checkout."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
KERNELS = {path.name for path in (ROOT / "kernels").glob("*.cl")}
LEFT_OUT = shutil.ignore_patterns(".*", "__pycache__", "*.egg-info", "build", "dist", "*.slices")


@pytest.fixture(scope="module")
def archives(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return a wheel and a source archive, built from a copy so that the checkout stays clean."""
    folder = tmp_path_factory.mktemp("archives")
    shutil.copytree(ROOT, folder / "source", ignore=LEFT_OUT)
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(folder / "source")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    (wheel,), (archive,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    return wheel, archive


def test_there_are_kernels() -> None:
    assert {"common.cl"} < KERNELS


def test_wheel_holds_kernels(archives: tuple[Path, Path]) -> None:
    with zipfile.ZipFile(archives[0]) as wheel:
        names = wheel.namelist()
    found = {name for name in names if name.startswith("rasterslice/kernels/")}
    assert found == {f"rasterslice/kernels/{name}" for name in KERNELS}
    assert "rasterslice/py.typed" in names
    viewer = {f"rasterslice/export/viewer/{p.name}" for p in (ROOT / "rasterslice/export/viewer").iterdir()}
    assert len(viewer) >= 8
    assert viewer <= set(names)
    assert not [name for name in names if name.split("/")[0] in ("tests", "bench", "kernels")]


def test_source_archive_holds_kernels_and_tests(archives: tuple[Path, Path]) -> None:
    with tarfile.open(archives[1]) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {f"kernels/{name}" for name in KERNELS} <= names
    assert {"tests/test_packaging.py", "LICENSE", "README.md", "CHANGELOG.md", "pyproject.toml"} <= names


def test_kernels_of_a_wheel_are_found(archives: tuple[Path, Path], tmp_path: Path) -> None:
    with zipfile.ZipFile(archives[0]) as wheel:
        wheel.extractall(tmp_path)
    code = "import rasterslice.sources as d; print(d.__file__); print(d.kernel_source('common'))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env={"PYTHONPATH": str(tmp_path)}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(str(tmp_path))
    assert (ROOT / "kernels" / "common.cl").read_text(encoding="utf-8") in done.stdout


@pytest.mark.parametrize("name", sorted(KERNELS))
def test_kernels_of_this_checkout_are_found(name: str) -> None:
    from rasterslice.sources import kernel_source

    assert kernel_source(name.removesuffix(".cl")) == (ROOT / "kernels" / name).read_text(encoding="utf-8")
