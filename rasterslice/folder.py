"""The output folder: which ones are ours, and how a finished one takes its place.

Everything is written into a hidden folder beside the target, ``.<name>.part-<pid>``, and renamed when it is
complete, so that a target either holds a whole result or is what it was before.
"""

from __future__ import annotations

import itertools
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping, Set
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .errors import UsageError
from .interrupts import unbroken

PROGRAM = "rasterslice"
MANIFEST = "manifest.json"
MOST_MANIFEST = 64 << 20  # bytes; JSON can take 20 times as much memory

FileEntry = dict[str, str | int]


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """Return the manifest of a folder that is ours, else None.

    Raises
    ------
    UsageError
        When it is too large to be read, or nested so deeply that it is none of ours.
    """
    import json  # a run needs it at its end

    path = folder / MANIFEST
    try:
        size = path.stat().st_size
        if size > MOST_MANIFEST:
            limit = f"at most {MOST_MANIFEST / 1e6:.0f} MB are read"
            raise UsageError(f"{path}: {size / 1e6:.0f} MB, {limit}; slice again into another folder")
        manifest = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return None
    except RecursionError:
        raise UsageError(f"{path}: nested too deeply for a manifest; slice again into another folder") from None
    ours = isinstance(manifest, dict) and manifest.get("program") == PROGRAM
    return manifest if ours else None


def check_target(target: Path, inputs: Iterable[Path] = ()) -> None:
    """Refuse a target that must not be replaced; costs nothing, so call it before computing.

    Parameters
    ----------
    target : Path
        The folder to be made or replaced.
    inputs : iterable of Path
        Files that are being read, which a replaced folder would take with it.

    Raises
    ------
    UsageError
        When the target is a file, a folder that is not ours, holds an input, or has no parent.
    """
    try:
        target.is_dir(), os.lstat(target)
    except FileNotFoundError:
        pass
    except OSError as error:
        raise UsageError(f"{target}: cannot be the output folder: {error.strerror}; name another with -o") from None
    if target.is_dir():
        if read_manifest(target) is None:
            raise UsageError(
                f"{target}: this folder exists and has no {MANIFEST} of {PROGRAM}, so it is not replaced; "
                "name another with -o"
            )
        for path in inputs:
            if target.resolve() in path.resolve().parents:
                raise UsageError(f"{target}: replacing this folder would delete the input {path}; name another with -o")
    elif os.path.lexists(target):
        raise UsageError(f"{target}: the output must be a folder, and this is a file; name another with -o")
    elif not target.parent.is_dir():
        raise UsageError(f"{target}: the folder {target.parent} does not exist; make it, or name another with -o")


@contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """Give an empty folder that becomes the target when the block ends without an exception.

    Any exception, an interrupt included, removes the new folder and leaves the target as it was.
    """
    scratch = _unused(target, "part")
    try:
        with writing(target):
            scratch.mkdir()
        yield scratch
        with writing(target):
            _swap(scratch, target)
    except BaseException:
        remove(scratch)
        raise


@contextmanager
def writing(target: Path) -> Iterator[None]:
    """Turn a failed write (disk full, no permission) into one line for the user."""
    try:
        yield
    except OSError as error:
        raise UsageError(
            f"{target}: cannot be written: {error.strerror or error}; make room or permission there, "
            "or name another folder with -o"
        ) from error


def remove(folder: Path) -> None:
    """Delete a folder, if it is there; an interrupt comes through only when that is done."""
    try:
        shutil.rmtree(folder, ignore_errors=True)
    except KeyboardInterrupt:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def link_all(source: Path, target: Path, but: Set[str]) -> None:
    """Give a folder the files of another, shared where the disk can, except some names at its top."""

    def left_out(folder: str, names: list[str]) -> set[str]:
        return {name for name in names if name in but} if Path(folder) == source else set()

    shutil.copytree(source, target, symlinks=True, ignore=left_out, copy_function=_link, dirs_exist_ok=True)


def seal(
    folder: Path, pattern: str = "**/*", sealed: Iterable[FileEntry] = (), sums: Mapping[str, str] | None = None
) -> list[FileEntry]:
    """Force the files of a folder to the disk; return path, size and SHA-256 of each, by path.

    Parameters
    ----------
    folder : Path
    pattern : str
        Which files, as for ``Path.glob``; the manifest is left out.
    sealed : iterable of FileEntry
        What an earlier call returned: those files are not touched again, and stand among the others.
    sums : mapping, optional
        SHA-256 by the names of files of which it is known.
    """
    entries = {str(entry["path"]): entry for entry in sealed}
    paths = {p.relative_to(folder).as_posix(): p for p in folder.glob(pattern) if p.is_file()}
    names = [name for name in paths if name not in entries and name != MANIFEST]
    with ThreadPoolExecutor(4) as pool:  # hashing and fsync both release the GIL
        made = pool.map(lambda name: _seal_file(paths[name], name, (sums or {}).get(paths[name].name)), names)
        entries.update(zip(names, made, strict=True))
    return [entries[name] for name in sorted(entries, key=lambda name: name.split("/"))]


def file_entry(path: Path) -> FileEntry:
    """Return path, size and SHA-256 of a file."""
    with unbroken():
        import hashlib  # loads OpenSSL, for which slicing need not wait
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        return {"path": str(path), "bytes": os.fstat(file.fileno()).st_size, "sha256": digest}


def write_manifest(folder: Path, manifest: dict[str, Any]) -> None:
    """Write ``manifest.json``, which makes a folder complete, and force it to the disk."""
    import json

    with (folder / MANIFEST).open("wb") as file:
        file.write((json.dumps(manifest, indent=1, allow_nan=False) + "\n").encode("ascii"))
        file.flush()
        os.fsync(file.fileno())


def _seal_file(path: Path, name: str, digest: str | None) -> FileEntry:
    with path.open("rb" if os.name == "posix" else "rb+") as file:  # Windows syncs only what is open for writing
        os.fsync(file.fileno())
    if digest is not None:
        return {"path": name, "bytes": path.stat().st_size, "sha256": digest}
    return {**file_entry(path), "path": name}


def _link(source: str, target: str) -> None:
    try:
        os.link(source, target, follow_symlinks=False)
    except (OSError, NotImplementedError):
        shutil.copy2(source, target, follow_symlinks=False)


def _unused(target: Path, what: str) -> Path:
    """Return a free hidden name beside the target, so that a rename stays on one disk."""
    for n in itertools.count():
        path = target.with_name(f".{target.name}.{what}-{os.getpid()}" + (f"-{n}" if n else ""))
        if not os.path.lexists(path):
            return path
    raise AssertionError("unreachable")


def _swap(scratch: Path, target: Path) -> None:
    """Put the new folder in the place of the old one, or leave the old one there."""
    if not os.path.lexists(target):
        os.rename(scratch, target)
    else:
        check_target(target)  # it may have appeared, or changed hands, while we computed
        old = _unused(target, "old")
        try:
            os.rename(target, old)
            os.rename(scratch, target)
        except BaseException:
            if old.exists() and not os.path.lexists(target):
                os.rename(old, target)
            raise
        remove(old)
    _sync_folder(target.parent)


def _sync_folder(folder: Path) -> None:
    """Make a rename last through a power cut, where folders can be synced."""
    if os.name == "posix":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
