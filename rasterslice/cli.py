"""The command line: reads arguments, calls one function, prints; computes nothing."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import math
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from . import __version__
from .errors import UsageError
from .terminal import INTERRUPTED, drop_stdout, fail, failure, progress, show, signals, warn

_WORST = (INTERRUPTED, 1, 5, 3, 2, 6, 4, 0)  # exit codes of several runs: the first of these is that of all

_EPILOG = """other commands:
  rasterslice init MESH... [-o FILE] write a parameter file that slices a mesh as it is
  rasterslice info MESH... [--json]  say what a mesh is like, and what is wrong with it
  rasterslice devices [--json]       list the OpenCL devices
  rasterslice export DIR --to F,F    write more exports from a finished folder
  rasterslice preview MESH|PARAMS    one picture, quickly; --html for the viewer
  rasterslice check PARAMS.txt --against FILE    compare what another program wrote, layer by layer
  rasterslice cobra simulate DIR     play a Cobra export: time, lengths, joints, beads
  rasterslice cobra serve|send DIR --port PORT    hand it to the controller by Kermit, or line by line

exports: sheet html report svg svg-single cli cli-binary gcode fab dxf csv npz tiff png cobra
exit codes: 0 done, 1 internal error, 2 usage, 3 model, 5 device, 6 check disagrees, 130 interrupted; of several
  files, the worst"""


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, as every other error; every command has the same two switches."""

    def __init__(self, prog: str, **settings: Any) -> None:
        super().__init__(prog, allow_abbrev=False, formatter_class=argparse.RawDescriptionHelpFormatter, **settings)
        self.add_argument("--json", action="store_true", help="print the manifest, or the list, as JSON")
        self.add_argument("--quiet", action="store_true", help="print nothing but errors")

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message}; see {self.prog} --help")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # NumPy starts threads that nothing here has work for
    with signals(last=argv is None):
        try:
            return _dispatch(list(sys.argv[1:] if argv is None else argv))
        except BrokenPipeError:  # the reader of our output had enough, and the work is done
            drop_stdout()
            return 0
        except (Exception, KeyboardInterrupt) as error:
            return fail(*failure(error))


def _dispatch(argv: list[str]) -> int:
    command = argv[0] if argv else ""
    commands = {
        "devices": _devices, "export": _export, "info": _info, "init": _init, "preview": _preview, "check": _check,
    }  # fmt: skip
    if command in commands:
        return commands[command](argv[1:])
    if command == "cobra" and not Path(command).is_file():
        from .cobra.command import run

        return run(argv[1:], _Parser, show, lambda text: print(text, file=sys.stderr, flush=True))
    return _slice(argv)


def _slice(argv: list[str]) -> int:
    args = _slice_parser().parse_args(argv)
    if len(args.params) == 1:
        done = _run(args.params[0], args, args.out)
        show(done["result"], args, lambda _: done["lines"])
        return 0
    if args.out is not None and not args.dry_run:
        with contextlib.suppress(OSError):  # what is wrong with it, each run will say
            args.out.mkdir(exist_ok=True)
    return _each(args.params, args, lambda path: _run(path, args, args.out and args.out / f"{path.stem}.slices"))


def _run(path: Path, args: argparse.Namespace, out: Path | None) -> dict[str, Any]:
    """Slice one parameter file, or plan it; return the manifest or the plan, and what to print."""
    from . import job, params

    settings = params.read_params(path)
    changes = {name: getattr(args, name) for name in ("pitch", "export") if getattr(args, name) is not None}
    if args.lenient:
        changes["lenient"] = True
    settings = dataclasses.replace(settings, **changes)
    if args.dry_run:
        plan = job.dry_run(settings, args.device, out)
        warn(plan["warnings"], args.quiet)
        return {"result": plan, "lines": _plan_lines(plan)}
    start = time.perf_counter()
    folder = job.out_folder(settings, out)
    if args.taken.get(folder) == path:
        raise UsageError(f"{path}: is named twice; name it once")
    if folder in args.taken:
        raise UsageError(f"{path}: its output folder {folder} is that of {args.taken[folder]}; run it with another -o")
    args.taken[folder] = path
    with progress(not args.quiet and not args.no_progress and sys.stderr.isatty()) as bar:
        manifest = job.run(settings, out=folder, device=args.device, progress=bar)
    warn(manifest["warnings"], args.quiet)
    seconds = time.perf_counter() - start
    return {"result": manifest, "lines": _result_lines(manifest, folder, seconds), "folder": str(folder)}


def _each(paths: list[Path], args: argparse.Namespace, work: Callable[[Path], dict[str, Any]]) -> int:
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
        show({"runs": runs, "exit_code": worst}, args, lambda summary: _summary_lines(summary, len(paths)))
    return worst


def _summary_lines(summary: dict[str, Any], count: int) -> list[str]:
    runs = summary["runs"]
    good = sum(run["exit_code"] == 0 for run in runs)
    lines = [f"{good} of {count} files done" + (f", {len(runs) - good} failed" if good < len(runs) else "")]
    for run in runs:
        state = f"failed with exit code {run['exit_code']}" if run["exit_code"] else f"done in {run['seconds']:.1f} s"
        lines.append(f"  {run['file']}: {state}")
    return lines


def _slice_parser() -> argparse.ArgumentParser:
    parser = _Parser(
        "rasterslice",
        description="Slice a mesh for rapid freeze prototyping: contours, scaffold, deposition paths, fill.",
        epilog=_EPILOG,
    )
    parser.add_argument("params", metavar="PARAMS.txt", nargs="+", type=Path, help="parameter files, run in turn")
    parser.set_defaults(taken={})
    parser.add_argument("-o", "--out", metavar="DIR", type=Path, help="output folder; of several files, its parent")
    parser.add_argument("--pitch", metavar="MM", type=_positive, help="distance between pixels")
    parser.add_argument("--export", metavar="F,F", type=_names, help="what to write besides the layers")
    parser.add_argument("--device", metavar="S", help="part of the name of an OpenCL device")
    parser.add_argument("--dry-run", action="store_true", help="print grid, layers, memory, time; write nothing")
    parser.add_argument("--lenient", action="store_true", help="slice what is whole of a mesh file that is cut short")
    parser.add_argument("--no-progress", action="store_true", help="no progress bar")
    parser.add_argument("--version", action="version", version=f"rasterslice {__version__}")
    return parser


def _info(argv: list[str]) -> int:
    parser = _Parser("rasterslice info", description="Say what meshes are like, and what is wrong with them.")
    parser.add_argument("meshes", metavar="MESH", nargs="+", type=Path, help="mesh file")
    parser.add_argument("--units", choices=("mm", "cm", "m", "inch"), default="mm", help="of files that name none")
    parser.add_argument("--lenient", action="store_true", help="read the whole facets of a file that is cut short")
    args = parser.parse_args(argv)
    from . import survey

    def look(path: Path) -> dict[str, Any]:
        report = survey.survey_file(path, args.units, args.lenient)
        warn(report["notes"], args.quiet)
        return {"result": report, "lines": survey.report_lines(report)}

    return _each(args.meshes, args, look)


def _init(argv: list[str]) -> int:
    parser = _Parser("rasterslice init", description="Write a parameter file that slices meshes as they are.")
    parser.add_argument("meshes", metavar="MESH", nargs="+", type=Path, help="mesh file; several make one part")
    parser.add_argument("-o", "--out", metavar="FILE", type=Path, help="default <stem of the first mesh>.txt beside it")
    parser.add_argument("--lenient", action="store_true", help="take the whole facets of a file that is cut short")
    args = parser.parse_args(argv)
    from . import starter

    target = args.out or args.meshes[0].with_suffix(".txt")
    notes = starter.write_starter(args.meshes, target, args.lenient)
    warn(notes, args.quiet)
    show({"params": str(target)}, args, lambda _: [str(target)])
    return 0


def _export(argv: list[str]) -> int:
    parser = _Parser("rasterslice export", description="Write more exports from a finished folder.")
    parser.add_argument("folder", metavar="DIR", type=Path, help="what rasterslice wrote")
    parser.add_argument("--to", metavar="F,F", type=_names, required=True, help="see rasterslice --help")
    args = parser.parse_args(argv)
    if not args.to:
        parser.error("--to names no export")
    from . import export, job

    manifest = job.export_more(args.folder, args.to)
    warn(manifest["warnings"], args.quiet)
    made = [f.target.format(stem=manifest["name"]) for f in export.find(args.to)]
    show(manifest, args, lambda _: [str(args.folder / name) for name in made])
    return 0


def _preview(argv: list[str]) -> int:
    parser = _Parser("rasterslice preview", description="Slice coarsely and write one picture.")
    parser.add_argument("source", metavar="MESH|PARAMS.txt", type=Path, help="a mesh, or a parameter file (.txt)")
    parser.add_argument("-o", "--out", metavar="PNG", type=Path, help="the picture; default <stem>.preview.png")
    parser.add_argument("--html", action="store_true", help="also write the layer viewer, one HTML file")
    parser.add_argument("--full", action="store_true", help="slice as the parameters say, not coarser")
    parser.add_argument("--device", metavar="S", help="part of the name of an OpenCL device")
    args = parser.parse_args(argv)
    from .report.preview import preview

    made = preview(args.source, out=args.out, html=args.html, full=args.full, device=args.device)
    warn(made["warnings"], args.quiet)
    stages = ", ".join(f"{name} {seconds:.2f}" for name, seconds in made["seconds"].items())
    show(made, args, lambda m: [*m["files"], f"{m['layers']} slices; seconds: {stages}"])
    return 0


def _check(argv: list[str]) -> int:
    parser = _Parser("rasterslice check", description="Compare what another program wrote with ours, layer by layer.")
    from .check import command, table

    command.add_arguments(parser)
    result, code = command.run(args := parser.parse_args(argv))
    show(result, args, table.lines)
    return code


def _devices(argv: list[str]) -> int:
    parser = _Parser("rasterslice devices", description="List the OpenCL devices.")
    args = parser.parse_args(argv)
    from . import device

    show(device.list_devices(), args, _device_lines)
    return 0


def _plan_lines(plan: dict[str, Any]) -> list[str]:
    grid = plan["grid"]
    return [
        f"grid      {grid['width']} x {grid['height']} px of {grid['pitch']:g} mm",
        f"layers    {plan['layers']}, {plan['batch']} at a time",
        f"facets    {plan['facets']}",
        f"memory    {plan['image_mib']:.1f} MiB an image, budget {plan['memory_budget_mib']:.0f} MiB",
        f"device    {plan['device']}",
        f"time      about {plan['estimated_seconds']:.0f} s (crude)",
    ]


def _result_lines(manifest: dict[str, Any], out: Path, seconds: float) -> list[str]:
    size = "{width} x {height} px".format(**manifest["grid"])
    lines = [
        f"{manifest['layers']} layers of {size} in {seconds:.1f} s on {manifest['device']}",
        f"{out}: report.html, layers.csv, manifest.json, layers{os.sep}",
    ]
    files = [str(entry["path"]) for entry in manifest["files"]]
    for name in manifest["exports"]:
        inside = sum(path.startswith(name + "/") for path in files)
        lines.append(f"{out / name}" + (f"{os.sep} ({inside} files)" if inside else ""))
    if manifest["flagged_layers"]:
        n = manifest["flagged_layers"]
        lines.append(f"{n} layer{'s are' if n > 1 else ' is'} flagged: see the last column of layers.csv")
    return lines


def _device_lines(devices: list[dict[str, Any]]) -> list[str]:
    return [
        f"{d['name']}  [{d['kind']}, {d['platform']}, {d['memory_mb']} MB, {d['driver']}]"
        + ("" if d["usable"] else "  not usable")
        for d in devices
    ] or ["no OpenCL device"]


def _positive(text: str) -> float:
    with contextlib.suppress(ValueError):
        value = float(text)
        if value > 0 and math.isfinite(value):
            return value
    raise argparse.ArgumentTypeError(f"must be > 0 mm, got {text}")


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())
