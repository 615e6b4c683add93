"""The command line: reads arguments, calls one function, prints; computes nothing."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import math
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from . import __version__
from .errors import RasterSliceError, UsageError

INTERRUPTED, INTERNAL = 130, 1
DEBUG = "RASTERSLICE_DEBUG"
_LATER = ("init", "info", "preview", "cobra")

_EPILOG = """other commands:
  rasterslice devices [--json]       list the OpenCL devices
  rasterslice export DIR --to F,F    write more exports from a finished folder
  rasterslice check PARAMS.txt --against FILE    compare what another program wrote, layer by layer

exports: sheet (contact sheet, PNG), svg (one drawing per layer)
exit codes: 0 done, 1 internal error, 2 usage, 3 model, 5 device, 6 check disagrees,
  130 interrupted"""


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
    with _signals():
        try:
            return _dispatch(list(sys.argv[1:] if argv is None else argv))
        except RasterSliceError as error:
            return _fail(str(error), error.exit_code)
        except KeyboardInterrupt:
            return _fail("interrupted", INTERRUPTED)
        except BrokenPipeError:  # the reader of our output had enough, and the work is done
            _drop_stdout()
            return 0
        except MemoryError:
            return _fail("out of memory; use a larger --pitch or a smaller memory_mb", UsageError.exit_code)
        except Exception as error:
            if os.environ.get(DEBUG):
                traceback.print_exc()
            hint = f"please report it; {DEBUG}=1 shows where"
            return _fail(f"internal: {type(error).__name__}: {error}; {hint}", INTERNAL)


def _dispatch(argv: list[str]) -> int:
    command = argv[0] if argv else ""
    if command == "devices":
        return _devices(argv[1:])
    if command == "export":
        return _export(argv[1:])
    if command == "check":
        return _check(argv[1:])
    if command in _LATER and not Path(command).exists():
        raise UsageError(f"the command '{command}' is not built yet; see rasterslice --help")
    return _slice(argv)


def _slice(argv: list[str]) -> int:
    args = _slice_parser().parse_args(argv)
    if len(args.params) > 1:
        raise UsageError(f"{len(args.params)} parameter files: slicing several is not built yet; name one")
    from . import job, params

    settings = params.read_params(args.params[0])
    changes = {name: getattr(args, name) for name in ("pitch", "export") if getattr(args, name) is not None}
    settings = dataclasses.replace(settings, **changes)
    if args.dry_run:
        plan = job.dry_run(settings, args.device)
        _warn(plan["warnings"], args.quiet)
        _show(plan, args, _plan_lines)
        return 0
    start = time.perf_counter()
    out = job.out_folder(settings, args.out)
    with _progress(not args.quiet and not args.no_progress and sys.stderr.isatty()) as progress:
        manifest = job.run(settings, out=out, device=args.device, progress=progress)
    _warn(manifest["warnings"], args.quiet)
    _show(manifest, args, lambda m: _result_lines(m, out, time.perf_counter() - start))
    return 0


def _slice_parser() -> argparse.ArgumentParser:
    parser = _Parser(
        "rasterslice",
        description="Slice a mesh for rapid freeze prototyping: contours, scaffold, deposition paths, fill.",
        epilog=_EPILOG,
    )
    parser.add_argument("params", metavar="PARAMS.txt", nargs="+", type=Path, help="parameter file")
    parser.add_argument("-o", "--out", metavar="DIR", type=Path, help="output folder; default <stem>.slices")
    parser.add_argument("--pitch", metavar="MM", type=_positive, help="distance between pixels")
    parser.add_argument("--export", metavar="F,F", type=_names, help="what to write besides the layers")
    parser.add_argument("--device", metavar="S", help="part of the name of an OpenCL device")
    parser.add_argument("--dry-run", action="store_true", help="print grid, layers, memory, time; write nothing")
    parser.add_argument("--no-progress", action="store_true", help="no progress bar")
    parser.add_argument("--version", action="version", version=f"rasterslice {__version__}")
    return parser


def _export(argv: list[str]) -> int:
    parser = _Parser("rasterslice export", description="Write more exports from a finished folder.")
    parser.add_argument("folder", metavar="DIR", type=Path, help="what rasterslice wrote")
    parser.add_argument("--to", metavar="F,F", type=_names, required=True, help="sheet, svg")
    args = parser.parse_args(argv)
    if not args.to:
        parser.error("--to names no export")
    from . import job

    manifest = job.export_more(args.folder, args.to)
    _show(manifest, args, lambda m: [str(args.folder / name) for name in m["exports"]])
    return 0


def _check(argv: list[str]) -> int:
    parser = _Parser("rasterslice check", description="Compare what another program wrote with ours, layer by layer.")
    from .check import command, table

    command.add_arguments(parser)
    result, code = command.run(args := parser.parse_args(argv))
    _show(result, args, table.lines)
    return code


def _devices(argv: list[str]) -> int:
    parser = _Parser("rasterslice devices", description="List the OpenCL devices.")
    args = parser.parse_args(argv)
    from . import device

    _show(device.list_devices(), args, _device_lines)
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
        f"{out}: layers.csv, manifest.json, layers{os.sep}",
    ]
    files = [str(entry["path"]) for entry in manifest["files"]]
    for name in manifest["exports"]:
        inside = sum(path.startswith(name + "/") for path in files)
        lines.append(f"{out / name}" + (f"{os.sep} ({inside} files)" if inside else ""))
    if manifest["flagged_layers"]:
        lines.append(f"{manifest['flagged_layers']} layers are flagged: see the last column of layers.csv")
    return lines


def _device_lines(devices: list[dict[str, Any]]) -> list[str]:
    return [
        f"{d['name']}  [{d['kind']}, {d['platform']}, {d['memory_mb']} MB, {d['driver']}]"
        + ("" if d["usable"] else "  not usable")
        for d in devices
    ] or ["no OpenCL device"]


def _show(data: Any, args: argparse.Namespace, lines: Callable[[Any], list[str]]) -> None:
    """Print data to stdout: as JSON if asked for, else as lines, unless quiet."""
    if sys.stdout is None or (args.quiet and not args.json):
        return
    text = json.dumps(data, indent=1) if args.json else "\n".join(lines(data))
    code = sys.stdout.encoding or "utf-8"
    try:  # a file name may hold what the terminal cannot show
        print(text.encode(code, "backslashreplace").decode(code), flush=True)
    except BrokenPipeError:
        raise
    except OSError as error:
        _drop_stdout()
        raise UsageError(f"standard output: cannot be written: {error.strerror}; make room there") from error


def _warn(warnings: list[str], quiet: bool) -> None:
    for warning in () if quiet else warnings:
        print(f"rasterslice: warning: {' '.join(warning.splitlines())}", file=sys.stderr)


def _fail(message: str, code: int) -> int:
    with contextlib.suppress(OSError):
        print(f"rasterslice: error: {' '.join(message.splitlines())}", file=sys.stderr)
    return code


def _drop_stdout() -> None:
    """Keep Python from failing once more when it flushes at exit."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _positive(text: str) -> float:
    with contextlib.suppress(ValueError):
        value = float(text)
        if value > 0 and math.isfinite(value):
            return value
    raise argparse.ArgumentTypeError(f"must be > 0 mm, got {text}")


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


@contextlib.contextmanager
def _progress(shown: bool) -> Iterator[Callable[[int, int], None] | None]:
    """Give a progress bar on stderr, or none."""
    if not shown:
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("preparing", total=None)

        def update(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total, description="writing" if done == total else "slicing")

        yield update


@contextlib.contextmanager
def _signals() -> Iterator[None]:
    """Let a polite request to end do what Ctrl-C does, so that nothing half-written stays."""
    hook = sys.unraisablehook

    def interrupt(signum: int, frame: FrameType | None) -> NoReturn:
        # Libraries that are stopped half-way through an import complain in finalizers: noise after the one line.
        sys.unraisablehook = lambda _: None
        raise KeyboardInterrupt

    before: dict[int, Any] = {}
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        with contextlib.suppress(ValueError):  # not the main thread
            if number and signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                before[number] = signal.signal(number, interrupt)
    try:
        yield
    finally:
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)
