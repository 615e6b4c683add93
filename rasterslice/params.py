"""The parameter file: sixteen entries in the order of the paper's Table 1, then ``key = value`` lines."""

from __future__ import annotations

import codecs
import re
from pathlib import Path
from typing import Any

from .errors import UsageError, counted
from .settings import SPECS, SWITCHED, Invalid, Params, shown

__all__ = ["Params", "read_params", "write_params"]

_MAX_BYTES = 1_000_000  # a parameter file is a page of text: whatever is larger is something else
_ENTRIES = {  # fields of a line: (what messages call it, comment)
    ("count",): ("number of files", "[int] number of mesh files (> 0): STL, PLY, OBJ, OFF, 3MF, GLB"),
    ("files",): ("file names", "[char char] file names, relative to this file"),
    ("inexact",): ("inexact", "[1/0] common vertices of adjacent facets are not identical"),
    ("option",): ("slicing option", "[1/2/3] 1: boundary paths, 2: boundary and fill paths, 3: 2D"),
    ("scaffolding",): ("scaffolding", "[1/0] scaffolding below overhangs"),
    ("tolerance",): ("tolerance", "[mm] tolerance (> 0)"),
    ("part_width", "support_width"): ("path widths", "[mm mm] path width of part and support (> 0)"),
    ("thickness",): ("slice thickness", "[mm] slice thickness (> 0)"),
    ("smooth_angle",): ("smooth angle", "[degrees] largest smooth angle between path segments (> 0)"),
    ("scaling",): ("scaling", "[1/0 Sx Sy Sz] scaling (> 0)"),
    ("rotation",): ("rotation", "[1/0 Rx Ry Rz] degrees about x, the new y, the new z"),
    ("translation",): ("translation", "[1/0 Tx Ty Tz] mm where the minimum goes, or cent, or orig"),
    ("part_fraction",): ("part fraction", "[min max] fraction of the height to slice (0 to 1)"),
    ("scaffold_subset",): ("scaffolding subset", "[min max] fraction of the height with scaffolding"),
    ("copies",): ("copies", "[p1 p2 p3] p3 copies in a grid of p1 x p2"),
    ("scaffold_buffer",): ("scaffolding buffer", "[mm] scaffolding buffer (>= 0)"),
}
_KEYS = {
    "pitch": "mm between pixels; a path width must hold two",
    "slice_position": "cutting height within a slice, 0 to 1",
    "fill_angles": "degrees, one ice layer after the other, over all slices",
    "fill_inset": "mm by which both ends of a fill line are shortened",
    "winding": "nonzero, positive or evenodd",
    "scaffold_union": "above: scaffold for the slices above; own: also for the slice itself",
    "part_layers_per_slice": "ice layers in each slice; the fill turns on each",
    "min_point_spacing": "mm between successive points of a path",
    "memory_mb": "memory budget, MB",
    "copy_gap": "mm between copies with their scaffolds; default the wider path width",
    "units": "of mesh files that do not name their own: mm, cm, m or inch",
    "lenient": "1/0: slice the whole facets of a mesh file that is cut short",
    "report": "1/0: count open edges, shells and every kind of damage of the mesh",
    "machine": "machine profile (TOML), relative to this file, for the robot's exports",
    "export": "what to write besides layers.csv",
}


def read_params(path: str | Path) -> Params:
    """Read and validate a parameter file.

    Parameters
    ----------
    path : str or Path
        UTF-8 text: sixteen lines, then ``key = value`` lines. A comment starts at ``%``, ``#`` or ``[``
        with blank space before it; names with blanks stand in double quotes.

    Returns
    -------
    Params
        Mesh files are relative to the folder of `path`.

    Raises
    ------
    UsageError
        ``file:line: message``.
    """
    path = Path(path)
    text = _read_text(path)
    where: dict[str, int] = {}
    values: dict[str, Any] = {"source": path}
    line = 0
    try:
        entries = iter(_ENTRIES)
        for line, raw in enumerate(re.split(r"\r\n|\r|\n", text.rstrip()), 1):
            words = _words(raw)
            if not words:
                continue
            names = next(entries, None)
            if names is None:
                names, found = _key_line(words, where)
            else:
                found = _entry_line(names, words)
            where.update(dict.fromkeys(names, line))
            values.update(found)
        missing = next(entries, None)
        if missing is not None:
            done = list(_ENTRIES).index(missing)
            raise UsageError(f"entry {done + 1} of {len(_ENTRIES)}, {_ENTRIES[missing][0]}, is missing")
        count, files = values.pop("count"), values["files"]
        if count != len(files):
            promised = counted(count, "file")
            raise Invalid(f"{promised} promised, {len(files)} named (quote names with blanks)", "files")
        values["files"] = tuple(path.parent / f for f in files)
        if "machine" in values:
            values["machine"] = (path.parent / values["machine"]).resolve()
            _check_machine(values["machine"])
        return Params(**values, lines=where)
    except UsageError as error:
        names = error.names if isinstance(error, Invalid) else ()
        line = next((where[n] for n in names if n in where), line)
        raise UsageError(f"{path}:{line}: {error}") from None


def _check_machine(path: Path) -> None:
    """Read the machine profile once, whether or not an export needs it: a wrong name must not go unnoticed."""
    from .profile import read_profile

    try:
        read_profile(path)
    except UsageError as error:
        raise Invalid(str(error), "machine") from None


def _read_text(path: Path) -> str:
    try:
        if path.exists() and not path.is_file() and not path.is_dir():
            raise UsageError(f"{path}: cannot read the parameter file: it is not a file on disk")
        with path.open("rb") as file:
            data = file.read(_MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"{path}: cannot read the parameter file: {reason}") from None
    if len(data) > _MAX_BYTES or b"\0" in data:
        raise UsageError(f"{path}: not a parameter file, which is text of at most {_MAX_BYTES // 1000} kB")
    data = data.removeprefix(codecs.BOM_UTF8)
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise UsageError(f"{path}:{line}: not UTF-8 text; save it as UTF-8") from None


def _words(raw: str) -> list[str]:
    """Split a line at blanks, keep the quotes of quoted names, and drop the comment."""
    words = []
    for word in re.findall(r'"[^"]*"(?=\s|$)|\S+', raw):
        if word[0] in "%#[":
            break
        words.append(word)
    return words


def _value(word: str) -> int | float | str:
    """Return a word as the number it is, else as it is; `Params` says what is wrong with it."""
    if re.fullmatch(r"[+-]?[0-9]{1,300}", word):
        return int(word)
    if re.fullmatch(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?|[+-]?(nan|inf)", word, re.IGNORECASE):
        return float(word)
    return word


def _entry_line(names: tuple[str, ...], words: list[str]) -> dict[str, Any]:
    """Return the fields of one of the sixteen entries."""
    label, name = _ENTRIES[names][0], names[0]
    if name == "files":
        return {name: [w.strip('"') for w in words]}
    if re.match(r"[A-Za-z_]\w*=", "".join(words)):
        raise UsageError(f"expected {label}, got {shown(' '.join(words))}; key = value lines come after the "
                         f"{len(_ENTRIES)} entries")  # fmt: skip
    values = [_value(w) for w in words]
    if name in SWITCHED:
        if values[0] not in (0, 1):
            raise UsageError(f"{label} must begin with 0 (off) or 1 (on), got {shown(values[0])}")
        return {name: values[1:] if values[0] else None}
    count = SPECS[name].size if name in SPECS else 0
    if len(values) != (count or len(names)):
        wanted = count or len(names)
        raise UsageError(f"{label}: expected {wanted} value{'s' * (wanted > 1)}, got {len(values)}")
    if name == "count" and not (isinstance(values[0], int) and values[0] > 0):
        raise UsageError(f"{label} must be a whole number > 0, in digits, got {shown(values[0])}")
    return {name: values} if count else dict(zip(names, values, strict=True))


def _key_line(words: list[str], where: dict[str, int]) -> tuple[tuple[str], dict[str, Any]]:
    """Return the field of a ``key = value`` line."""
    key, equals, text = (part.strip() for part in " ".join(words).partition("="))
    if not equals:
        raise UsageError(f"expected key = value after the {len(_ENTRIES)} entries, got {shown(key)}")
    if key not in _KEYS:
        import difflib

        close = difflib.get_close_matches(key.lower(), _KEYS, 1)
        hint = f"did you mean {close[0]}?" if close else "known are " + ", ".join(_KEYS)
        raise UsageError(f"unknown key {shown(key)}; {hint}")
    if key in where:
        raise UsageError(f"{key} is given twice, first in line {where[key]}; remove one")
    if key == "machine" and text:
        return (key,), {key: text.strip('"')}
    values = [_value(w) for w in text.replace(",", " ").split()]
    if not values:
        raise UsageError(f"{key} needs a value")
    if key == "export":
        return (key,), {key: [str(w) for w in text.replace(",", " ").split()]}
    if key == "fill_angles":
        return (key,), {key: values}
    if len(values) > 1:
        raise UsageError(f"{key} takes 1 value, got {len(values)}")
    return (key,), {key: values[0]}


def write_params(params: Params) -> str:
    """Return a commented parameter file that reads back equal.

    Names of mesh files are relative to ``params.source`` where they lie beside or below it, else absolute.

    Raises
    ------
    UsageError
        When a file name cannot be written in a line of text.
    """
    lines = []
    for names, (_, comment) in _ENTRIES.items():
        if names == ("count",):
            text = str(len(params.files))
        elif names == ("files",):
            text = " ".join(_file_text(params, f) for f in params.files)
        elif names[0] in SWITCHED:
            value = getattr(params, names[0])
            text = "0 0 0 0" if value is None else "1 " + _text(value)
        else:
            text = " ".join(_text(getattr(params, n)) for n in names)
        lines.append(f"{text:<24} % {comment}")
    lines.append("")
    for key, comment in _KEYS.items():
        value = getattr(params, key)
        if isinstance(value, Path):
            value = _file_text(params, value)
        text = "" if value in (None, ()) else f"{key} = {_text(value)}"
        lines.append(f"{text:<32} % {comment}" if text else f"% {key} = ... : {comment}")
    return "\n".join(lines) + "\n"


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return " ".join(_text(v) for v in value)
    if isinstance(value, float):
        return f"{value:g}" if float(f"{value:g}") == value else repr(value)
    return str(int(value)) if isinstance(value, bool) else str(value)


def _file_text(params: Params, file: Path) -> str:
    folder = params.source.parent if params.source is not None else None
    inside = folder is not None and file.is_relative_to(folder)
    name = (file.relative_to(folder) if inside and folder is not None else file.absolute()).as_posix()
    if not name.isprintable() or '"' in name:
        raise UsageError(f"file name {name!r} cannot be written to a parameter file; rename it")
    return f'"{name}"' if " " in name or name[0] in "%#[" else name
