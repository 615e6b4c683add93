"""Programs: built from their source once, then from the intermediate code that was kept of them."""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np
import pyopencl as cl
import pytest

from rasterslice import programs, toolchain
from rasterslice.device import Device

SOURCE = "__kernel void twice(__global int *a) { int i = get_global_id(0); a[i] *= 2; }"
OPTIONS = ["-cl-std=CL1.2"]


@pytest.fixture
def device() -> Device:
    found = Device()
    found._opened.built.result()  # its own program is no part of this
    if "pocl 3." not in found.identity.lower():
        pytest.skip("intermediate code is kept of PoCL 3 only")
    return found


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """Give a folder of its own to what is kept; the list tells from what programs are made."""
    built, says = programs._built, list[str]()

    def watched(context: object, options: list[str], *parts: object) -> object:
        says.append("source" if len(parts) == 1 else "code")
        return built(context, options, *parts)

    monkeypatch.setattr(programs, "_built", watched)
    monkeypatch.setattr(toolchain, "ensure_cache", lambda: tmp_path)
    return says


def doubled(device: Device, identity: str | None = None, source: str = SOURCE) -> list[int]:
    program = programs.build(device._context, device._opened.device, identity or device.identity, source, OPTIONS)
    host = np.arange(4, dtype=np.int32)
    buffer = cl.Buffer(device._context, cl.mem_flags.COPY_HOST_PTR, hostbuf=host)
    program.kernel("twice")(device._queue, (4,), None, buffer)
    cl.enqueue_copy(device._queue, host, buffer)
    return list(host.tolist())


def text_of(device: Device, source: str) -> bytes:
    head, flags = [device.identity, device._opened.device.version], sorted(programs.cpu_flags())
    return "\0".join([*head, *flags, *OPTIONS, source]).encode()


def kept(folder: Path) -> Path:
    (path,) = (folder / "rasterslice").glob("kernels-*")
    return path


def test_the_second_program_is_made_of_what_was_kept(device: Device, made: list[str], tmp_path: Path) -> None:
    assert doubled(device) == [0, 2, 4, 6]
    assert made == ["source", "code"]
    assert kept(tmp_path).stat().st_mode & 0o777 == 0o600
    made.clear()
    assert doubled(device) == [0, 2, 4, 6]
    assert made == ["code"]


@pytest.mark.parametrize(
    "spoil",
    [lambda d: b"", lambda d: d[:30], lambda d: d[:-1], lambda d: d + b"\0", lambda d: d[:-9] + b"?" + d[-8:],
     lambda d: b"another " + d[8:]],
    ids=["empty", "head", "short", "long", "changed", "foreign"],
)  # fmt: skip
def test_a_damaged_file_is_made_anew(device: Device, made: list[str], tmp_path: Path, spoil) -> None:
    doubled(device)
    path = kept(tmp_path)
    whole = path.read_bytes()
    path.write_bytes(spoil(whole))
    made.clear()
    assert doubled(device) == [0, 2, 4, 6]
    assert made == ["source", "code"]
    assert path.read_bytes() == whole


def test_a_file_of_another_source_does_not_count(device: Device, made: list[str], tmp_path: Path) -> None:
    """Names of files are short, and two sources may have one."""
    doubled(device)
    path = kept(tmp_path)
    other = SOURCE.replace("*= 2", "+= a[i] + 0")
    path.rename(path.with_name(f"kernels-{zlib.crc32(text_of(device, other)):08x}"))
    made.clear()
    assert doubled(device, source=other) == [0, 2, 4, 6]
    assert made == ["source", "code"]


def test_code_that_the_compiler_refuses_is_thrown_away(device: Device, made: list[str], tmp_path: Path) -> None:
    doubled(device)
    path = kept(tmp_path)
    key = b"_" + 32 * b"0"
    assert programs._keep(path, text_of(device, SOURCE), key.decode(), b"BC\xc0\xde" + bytes(range(1, 200)) + key)
    made.clear()
    assert doubled(device) == [0, 2, 4, 6]
    assert made == ["code", "source"]
    assert not path.exists()


def test_without_code_to_keep_the_source_will_do(
    device: Device, made: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(toolchain, "pocl_cache", lambda: tmp_path / "none")
    assert doubled(device) == [0, 2, 4, 6]
    assert made == ["source"]
    assert not (tmp_path / "rasterslice").exists()


def test_where_nothing_can_be_kept_the_source_will_do(device: Device, made: list[str], tmp_path: Path) -> None:
    (tmp_path / "rasterslice").write_text("a file where the folder should be")
    assert doubled(device) == [0, 2, 4, 6]
    assert made == ["source"]


def test_another_processor_has_its_own(device: Device, made: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    doubled(device)
    monkeypatch.setattr(programs, "cpu_flags", lambda: {"sse2"})
    made.clear()
    assert doubled(device) == [0, 2, 4, 6]
    assert made == ["source", "code"]


def test_other_platforms_always_have_the_source(device: Device, made: list[str], tmp_path: Path) -> None:
    assert doubled(device, "Another Platform OpenCL 3.0 device 1.0") == [0, 2, 4, 6]
    assert made == ["source"]
    assert not (tmp_path / "rasterslice").exists()


def test_kernels_of_one_name_are_not_mixed_up(device: Device, made: list[str], tmp_path: Path) -> None:
    """PoCL has one place for the kernels of a name, whatever intermediate code they are of."""
    for source in (SOURCE, SOURCE.replace("*= 2", "*= 3"), SOURCE.replace("*= 2", "= 7")):
        made.clear()
        first, again = doubled(device, source=source), doubled(device, source=source)
        assert first == again == {"2": [0, 2, 4, 6], "3": [0, 3, 6, 9], "7": [7] * 4}[source.split("=")[-1][1]]
        assert made == ["source", "code", "code"]


def test_kept_code_must_hold_the_names_that_it_is_kept_with(device: Device, made: list[str], tmp_path: Path) -> None:
    doubled(device)
    path = kept(tmp_path)
    _, code = programs._read(path, text_of(device, SOURCE))
    assert programs._keep(path, text_of(device, SOURCE), "_" + 32 * "0", code)
    made.clear()
    assert doubled(device) == [0, 2, 4, 6]
    assert made == ["source", "code"]


def test_refused_code_that_cannot_be_thrown_away_does_no_harm(
    device: Device, made: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    doubled(device)
    path, key = kept(tmp_path), b"_" + 32 * b"0"
    assert programs._keep(path, text_of(device, SOURCE), key.decode(), b"BC\xc0\xde" + bytes(range(1, 200)) + key)

    def refuse(self: Path, missing_ok: bool = False) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "unlink", refuse)
    made.clear()
    assert doubled(device) == [0, 2, 4, 6]
    assert made == ["code", "source"]
