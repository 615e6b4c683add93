"""The command line: reads arguments, calls one function, prints; computes nothing."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import math
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from . import __version__, opencl
from .commands import COMMANDS, Parser, each, names
from .errors import UsageError
from .interrupts import signals, unbroken
from .printout import plan_lines, result_lines
from .terminal import drop_stdout, fail, failure, leave, progress, show, warn

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
exit codes: 0 done, 1 internal error, 2 usage, 3 model, 5 device, 6 check disagrees, 7 check cannot tell,
  130 interrupted; of several files, the worst"""

_HELD: list[object] = []  # until the process ends


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # NumPy starts threads that nothing here has work for
    last = argv is None
    if last:
        opencl.alone = True
    with signals(last=last):
        try:
            code = _dispatch(list(sys.argv[1:] if argv is None else argv))
        except BrokenPipeError:  # the reader of our output had enough, and the work is done
            drop_stdout()
            code = 0
        except (Exception, KeyboardInterrupt) as error:
            code = fail(*failure(error))
        if last:
            leave(code)
        return code


def _dispatch(argv: list[str]) -> int:
    command = argv[0] if argv else ""
    if command in COMMANDS:
        return COMMANDS[command](argv[1:])
    if command == "cobra" and not Path(command).is_file():
        from .cobra.command import run

        return run(argv[1:], Parser, show, lambda text: print(text, file=sys.stderr, flush=True))
    return _slice(argv)


def _slice(argv: list[str]) -> int:
    args = _slice_parser().parse_args(argv)
    if len(args.params) == 1:
        done = _run(args.params[0], args, args.out)
        show(done["result"], args, lambda _: done["lines"])
        return 0
    made = args.out is not None and not args.dry_run and not os.path.lexists(args.out)
    if made:
        with contextlib.suppress(OSError):  # what is wrong with it, each run will say
            args.out.mkdir()
    try:
        return each(args.params, args, lambda path: _run(path, args, args.out and args.out / f"{path.stem}.slices"))
    finally:
        if made:
            with contextlib.suppress(OSError):  # some run wrote into it
                args.out.rmdir()


def _run(path: Path, args: argparse.Namespace, out: Path | None) -> dict[str, Any]:
    """Slice one parameter file, or plan it; return the manifest or the plan, and what to print."""
    with unbroken():
        from . import opening

        opening.begin(args.device)  # what takes longest begins first, in a thread, and needs few imports
        import numpy  # noqa: F401  # the first of these: the device is not opened before it is there

        opening.give_way(args.device, 0.02)
        from .params import read_params
    settings = read_params(path)
    changes = {name: getattr(args, name) for name in ("pitch", "export") if getattr(args, name) is not None}
    if args.lenient:
        changes["lenient"] = True
    lines = {name: line for name, line in settings.lines.items() if name not in changes}
    settings = dataclasses.replace(settings, **changes, lines=lines)
    with unbroken():
        from . import reading

        if len(args.params) == 1:  # of several, one that is refused would be read beside the next
            reading.begin(settings)
        from . import job, slicer  # noqa: F401  # slicer beside the reading, and not to be broken off
    if args.dry_run:
        plan = job.dry_run(settings, args.device, out)
        warn(plan["warnings"], args.quiet)
        return {"result": plan, "lines": plan_lines(plan)}
    start = time.perf_counter()
    folder = job.out_folder(settings, out)
    if args.taken.get(folder) == path:
        raise UsageError(f"{path}: is named twice; name it once")
    if folder in args.taken:
        raise UsageError(f"{path}: its output folder {folder} is that of {args.taken[folder]}; run it with another -o")
    args.taken[folder] = path
    with progress(not args.quiet and not args.no_progress and sys.stderr is not None and sys.stderr.isatty()) as bar:
        held = _HELD if opencl.alone and len(args.params) == 1 else None
        manifest = job.run(settings, out=folder, device=args.device, progress=bar, held=held)
    warn(manifest["warnings"], args.quiet)
    seconds = time.perf_counter() - start
    return {"result": manifest, "lines": result_lines(manifest, folder, seconds), "folder": str(folder)}


def _slice_parser() -> argparse.ArgumentParser:
    parser = Parser(
        "rasterslice",
        description="Slice a mesh for rapid freeze prototyping: contours, scaffold, deposition paths, fill.",
        epilog=_EPILOG,
    )
    parser.add_argument("params", metavar="PARAMS.txt", nargs="+", type=Path, help="parameter files, run in turn")
    parser.set_defaults(taken={})
    parser.add_argument("-o", "--out", metavar="DIR", type=Path, help="output folder; of several files, its parent")
    parser.add_argument("--pitch", metavar="MM", type=_positive, help="distance between pixels")
    parser.add_argument("--export", metavar="F,F", type=names, help="what to write besides the layers")
    parser.add_argument("--device", metavar="S", help="part of the name of an OpenCL device")
    parser.add_argument("--dry-run", action="store_true", help="print grid, layers, memory, time; write nothing")
    parser.add_argument("--lenient", action="store_true", help="slice what is whole of a mesh file that is cut short")
    parser.add_argument("--no-progress", action="store_true", help="no progress bar")
    parser.add_argument("--version", action="version", version=f"rasterslice {__version__}")
    return parser


def _positive(text: str) -> float:
    with contextlib.suppress(ValueError):
        value = float(text)
        if value > 0 and math.isfinite(value):
            return value
    raise argparse.ArgumentTypeError(f"must be > 0 mm, got {text}")
