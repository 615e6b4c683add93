"""The commands beside slicing: each reads its arguments, calls one function, prints."""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from .errors import UsageError
from .printout import device_lines, summary_lines
from .terminal import INTERRUPTED, fail, failure, show, warn

_WORST = (INTERRUPTED, 1, 5, 3, 2, 6, 0)  # exit codes of several runs: the first of these is that of all


_as_written = partial(argparse.RawDescriptionHelpFormatter, width=80)  # else each argument asks the terminal


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, as every other error; every command has the same two switches."""

    def __init__(self, prog: str, **settings: Any) -> None:
        super().__init__(prog, allow_abbrev=False, formatter_class=_as_written, **settings)
        self._negative_number_matcher = re.compile(r"-\.?[0-9]")  # -1,2 and -1e3 are values, no options
        self.add_argument("--json", action="store_true", help="print the manifest, or the list, as JSON")
        self.add_argument("--quiet", action="store_true", help="print nothing but errors")

    def format_help(self) -> str:
        """Return the help, as wide as the terminal."""
        self.formatter_class = argparse.RawDescriptionHelpFormatter
        return super().format_help()

    def error(self, message: str) -> NoReturn:
        """Raise what is wrong with the arguments."""
        raise UsageError(f"{message}; see {self.prog} --help")


def names(text: str) -> tuple[str, ...]:
    """Return names that stand between commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def each(paths: list[Path], args: argparse.Namespace, work: Callable[[Path], dict[str, Any]]) -> int:
    """Work on several files one after the other, whatever becomes of each; print a summary; return the worst code."""
    runs: list[dict[str, Any]] = []
    for path in paths:
        start, error, code, done = time.perf_counter(), None, 0, dict[str, Any]()
        try:
            done = work(path)
            if not args.quiet and not args.json:
                show(done["result"], args, lambda _, lines=done["lines"]: [*lines, *[""][len(paths) == 1 :]])  # type: ignore[misc]
        except BrokenPipeError:
            raise
        except (Exception, KeyboardInterrupt) as caught:
            error, code = failure(caught)
            fail(error, code)
        seconds = round(time.perf_counter() - start, 3)
        runs.append({"file": str(path), "exit_code": code, "error": error, "seconds": seconds, **done})
        if code == INTERRUPTED:
            break
    worst = next((code for code in _WORST if any(run["exit_code"] == code for run in runs)), 1)
    for run in runs:
        run.pop("lines", None)
    if args.json or len(paths) > 1:
        show({"runs": runs, "exit_code": worst}, args, lambda summary: summary_lines(summary, len(paths)))
    return worst


def _add_units(parser: Parser, default: str | None = None) -> None:
    parser.add_argument("--units", choices=("mm", "cm", "m", "inch"), default=default, help="of files that name none")


def info(argv: list[str]) -> int:
    """Say what meshes are like."""
    parser = Parser("rasterslice info", description="Say what meshes are like, and what is wrong with them.")
    parser.add_argument("meshes", metavar="MESH", nargs="+", type=Path, help="mesh file")
    _add_units(parser, "mm")
    parser.add_argument("--lenient", action="store_true", help="read the whole facets of a file that is cut short")
    args = parser.parse_args(argv)
    from . import survey

    def look(path: Path) -> dict[str, Any]:
        report = survey.survey_file(path, args.units, args.lenient)
        warn(report["notes"], args.quiet)
        return {"result": report, "lines": survey.report_lines(report)}

    return each(args.meshes, args, look)


def init(argv: list[str]) -> int:
    """Write a parameter file."""
    parser = Parser("rasterslice init", description="Write a parameter file that slices meshes as they are.")
    parser.add_argument("meshes", metavar="MESH", nargs="+", type=Path, help="mesh file; several make one part")
    parser.add_argument("-o", "--out", metavar="FILE", type=Path, help="default <stem of the first mesh>.txt beside it")
    _add_units(parser)
    parser.add_argument("--lenient", action="store_true", help="take the whole facets of a file that is cut short")
    args = parser.parse_args(argv)
    from . import starter

    target = args.out or args.meshes[0].with_suffix(".txt")
    notes = starter.write_starter(args.meshes, target, args.lenient, args.units)
    warn(notes, args.quiet)
    show({"params": str(target)}, args, lambda _: [str(target)])
    return 0


def export(argv: list[str]) -> int:
    """Write more exports from a finished folder."""
    parser = Parser("rasterslice export", description="Write more exports from a finished folder.")
    parser.add_argument("folder", metavar="DIR", type=Path, help="what rasterslice wrote")
    parser.add_argument("--to", metavar="F,F", type=names, required=True, help="see rasterslice --help")
    args = parser.parse_args(argv)
    if not args.to:
        parser.error("--to names no export")
    from . import export, job

    manifest = job.export_more(args.folder, args.to)
    warn(manifest["warnings"], args.quiet)
    made = [f.path(manifest["name"]) for f in export.find(args.to)]
    show(manifest, args, lambda _: [str(args.folder / name) for name in made])
    return 0


def preview(argv: list[str]) -> int:
    """Write one picture, coarsely and quickly."""
    parser = Parser("rasterslice preview", description="Slice coarsely and write one picture.")
    parser.add_argument("source", metavar="MESH|PARAMS.txt", type=Path, help="a mesh, or a parameter file (.txt)")
    parser.add_argument("-o", "--out", metavar="PNG", type=Path, help="the picture; default <stem>.preview.png")
    _add_units(parser)
    parser.add_argument("--html", action="store_true", help="also write the layer viewer, one HTML file")
    parser.add_argument("--full", action="store_true", help="slice as the parameters say, not coarser")
    parser.add_argument("--device", metavar="S", help="part of the name of an OpenCL device")
    args = parser.parse_args(argv)
    from .report.preview import preview

    made = preview(args.source, out=args.out, html=args.html, full=args.full, device=args.device, units=args.units)
    warn(made["warnings"], args.quiet)
    stages = ", ".join(f"{name} {seconds:.2f}" for name, seconds in made["seconds"].items())
    show(made, args, lambda m: [*m["files"], f"{m['layers']} slices; seconds: {stages}"])
    return 0


def check(argv: list[str]) -> int:
    """Compare what another program wrote."""
    parser = Parser("rasterslice check", description="Compare what another program wrote with ours, layer by layer.")
    from .check import command, table

    command.add_arguments(parser)
    result, code = command.run(args := parser.parse_args(argv))
    show(result, args, table.lines)
    return code


def devices(argv: list[str]) -> int:
    """List the OpenCL devices."""
    parser = Parser("rasterslice devices", description="List the OpenCL devices.")
    args = parser.parse_args(argv)
    from . import platforms

    show(platforms.list_devices(), args, device_lines)
    return 0


#: What stands after ``rasterslice``, and is no parameter file.
COMMANDS: dict[str, Callable[[list[str]], int]] = {
    "devices": devices, "export": export, "info": info, "init": init, "preview": preview, "check": check,
}  # fmt: skip
