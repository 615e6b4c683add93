"""The program of the kernels, built from its source or from what the compiler made of that before.

PoCL looks through all of a source before it knows that it has compiled it (0.04 s of every start), and through next to
nothing of its own intermediate code. So that is kept: a file beside the other caches holds the source, what it was
built for, and the intermediate code, and counts only where all of them are as they should be.

PoCL 3 keeps the kernels of all intermediate code in one folder, by their names alone. So the name of each kernel ends
with a hash of all that it is made of; `Program.kernel` knows it.
"""

from __future__ import annotations

import contextlib
import re
import struct
import zlib
from pathlib import Path
from typing import Any, NamedTuple

from . import opencl, toolchain
from .processor import cpu_flags

_MAGIC = b"rslcode2"
_HEAD = struct.Struct("<8s32sIII")  # magic, hash of the text, bytes of the text, of the code, CRC-32 of both
_BITCODE = b"BC\xc0\xde"
_MOST_PROGRAMS = 500  # of PoCL's cache that are looked through


class Program(NamedTuple):
    """The kernels of a built program, and what their names end with."""

    kernels: dict[str, Any]
    ending: str

    def kernel(self, name: str) -> Any:
        """Return a kernel of the source by its name there."""
        return self.kernels[name + self.ending]


def build(context: Any, device: Any, identity: str, source: str, options: list[str]) -> Program:
    """Return the built program of a source.

    Parameters
    ----------
    context, device : Context, Device
        Of `opencl.load`.
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
        return Program(_built(context, options, source), "")
    # one home may serve machines whose processors have one name, but not the same instructions
    version = device.get_info(opencl.load().device_info.VERSION)
    text = "\0".join([identity, version, *sorted(cpu_flags()), *options, source]).encode()
    path = toolchain.ensure_cache() / "rasterslice" / f"kernels-{zlib.crc32(text):08x}"
    kept = _read(path, text)
    if kept is None:
        import hashlib

        ending = f"_{hashlib.sha256(text).hexdigest()[:32]}"
        kernels = _built(context, options, _renamed(source, ending))
        code = _find(ending.encode())
        if code is None or not _keep(path, text, ending, code):
            return Program(kernels, ending)
    else:
        ending, code = kept
    try:
        return Program(_built(context, options, [device], [code]), ending)
    except opencl.load().Error:
        with contextlib.suppress(OSError):
            path.unlink()
        return Program(_built(context, options, source), "")


def _renamed(source: str, ending: str) -> str:
    """Return a source whose kernels have names of their own."""
    names = re.findall(r"__kernel\s+void\s+(\w+)", source)
    return "".join(f"#define {name} {name}{ending}\n" for name in names) + source


def _built(context: Any, options: list[str], *parts: Any) -> dict[str, Any]:
    cl = opencl.load()
    program = cl._Program(context, *parts)
    try:
        program._build(" ".join(options).encode())
    except cl.Error:
        opencl.whole()  # whose errors say what the compiler said
        program.build(" ".join(options).encode())
    return opencl.kernels_of(program)


def _read(path: Path, text: bytes) -> tuple[str, bytes] | None:
    """Return the ending of names and the intermediate code that are kept for a text, if all is there and whole."""
    try:
        data = path.read_bytes()
        magic, key, size, rest, crc = _HEAD.unpack_from(data)
    except (OSError, struct.error):
        return None
    body = data[_HEAD.size :]
    whole = magic == _MAGIC and len(body) == size + rest and zlib.crc32(body, zlib.crc32(key)) == crc
    same = whole and body[:size] == text and body[size : size + 4] == _BITCODE and b"_" + key in body[size:]
    return (f"_{key.decode()}", body[size:]) if same else None


def _keep(path: Path, text: bytes, ending: str, code: bytes) -> bool:
    """Keep the intermediate code of a text; return whether that was possible."""
    key, body = ending[1:].encode(), text + code
    head = _HEAD.pack(_MAGIC, key, len(text), len(code), zlib.crc32(body, zlib.crc32(key)))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        toolchain.write_whole(path, head + body, 0o600)
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
