"""The program of the kernels, built from its source or from what the compiler made of that before.

PoCL looks through all of a source before it knows that it has compiled it (0.04 s of every start), and through next to
nothing of its own intermediate code. So that is kept: a file beside the other caches holds the source, what it was
built for, and the intermediate code, and counts only where all of them are as they should be.
"""

from __future__ import annotations

import struct
import warnings
import zlib
from pathlib import Path
from typing import Any

from . import toolchain

_MAGIC = b"rslcode1"
_HEAD = struct.Struct("<8sIII")  # magic, bytes of the text, bytes of the code, their CRC-32
_BITCODE = b"BC\xc0\xde"
_MOST_PROGRAMS = 500  # of PoCL's cache that are looked through


def build(context: Any, device: Any, identity: str, source: str, options: list[str]) -> Any:
    """Return the built program of a source.

    Parameters
    ----------
    context, device : pyopencl.Context, pyopencl.Device
    identity : str
        Platform, device and driver with their versions.
    source : str
    options : list of str
        For the compiler.

    Raises
    ------
    pyopencl.Error
        When the source cannot be built.
    """
    if "pocl 3." not in identity.lower():  # of others it is not known what they do with intermediate code
        return _built(context, options, source)
    text = "\0".join([identity, *options, source]).encode()
    path = toolchain.ensure_cache() / "rasterslice" / f"kernels-{zlib.crc32(text):08x}"
    code = _read(path, text)
    if code is None:
        import hashlib

        mark = f"source_{hashlib.sha256(text).hexdigest()}"
        program = _built(context, options, f"{source}\n__kernel void {mark}(void) {{}}\n")
        code = _find(mark.encode())
        if code is None or not _keep(path, text, code):
            return program
    import pyopencl as cl

    try:
        return _built(context, options, [device], [code])
    except cl.Error:
        path.unlink(missing_ok=True)
        return _built(context, options, source)


def _built(context: Any, options: list[str], *parts: Any) -> Any:
    import pyopencl as cl

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # compilers chat
        return cl.Program(context, *parts).build(options, cache_dir=False)  # type: ignore[arg-type]  # PoCL keeps its own cache


def _read(path: Path, text: bytes) -> bytes | None:
    """Return the intermediate code that is kept for a text, if it is there and whole."""
    try:
        data = path.read_bytes()
        magic, size, rest, crc = _HEAD.unpack_from(data)
    except (OSError, struct.error):
        return None
    body = data[_HEAD.size :]
    whole = magic == _MAGIC and len(body) == size + rest and zlib.crc32(body) == crc
    return body[size:] if whole and body[:size] == text and body[size : size + 4] == _BITCODE else None


def _keep(path: Path, text: bytes, code: bytes) -> bool:
    """Keep the intermediate code of a text; return whether that was possible."""
    body = text + code
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        toolchain.write_whole(path, _HEAD.pack(_MAGIC, len(text), len(code), zlib.crc32(body)) + body, 0o600)
    except OSError:
        return False
    return True


def _find(mark: bytes) -> bytes | None:
    """Return the intermediate code in PoCL's cache that names a kernel, newest first."""
    found = []
    for path in toolchain.pocl_cache().glob("*/*/program.bc"):
        try:
            found.append((path.stat().st_mtime_ns, path))
        except OSError:
            continue
    for _, path in sorted(found, reverse=True)[:_MOST_PROGRAMS]:
        try:
            code = path.read_bytes()
        except OSError:
            continue
        if code.startswith(_BITCODE) and mark in code:
            return code
    return None
