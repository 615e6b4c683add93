"""What the command line prints, and how it ends: lines, JSON, a progress bar."""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from typing import Any

from .errors import RasterSliceError, UsageError

INTERRUPTED, INTERNAL = 130, 1
DEBUG = "RASTERSLICE_DEBUG"


def show(data: Any, args: argparse.Namespace, lines: Callable[[Any], list[str]]) -> None:
    """Print data to stdout: as JSON if asked for, else as lines, unless quiet."""
    if sys.stdout is None or (args.quiet and not args.json):
        return
    if args.json:
        import json  # few ask for it

        text = json.dumps(data, indent=1)
    else:
        text = "\n".join(lines(data))
    code = sys.stdout.encoding or "utf-8"
    try:  # a file name may hold what the terminal cannot show
        print(text.encode(code, "backslashreplace").decode(code), flush=True)
    except BrokenPipeError:
        raise
    except OSError as error:
        drop_stdout()
        raise UsageError(f"standard output: cannot be written: {error.strerror}; make room there") from error


def warn(warnings: list[str], quiet: bool) -> None:
    """Print warnings to stderr, one line each, unless quiet; they are in the manifest, too."""
    with contextlib.suppress(OSError):
        for warning in () if quiet else warnings:
            print(f"rasterslice: warning: {' '.join(warning.splitlines())}", file=sys.stderr, flush=True)


def fail(message: str, code: int) -> int:
    """Print an error to stderr, in one line; return its exit code."""
    with contextlib.suppress(OSError):
        print(f"rasterslice: error: {' '.join(message.splitlines())}", file=sys.stderr)
    return code


def leave(code: int) -> None:
    """End the process, unless somebody traces it: the system takes its memory back at once, Python piece by piece."""
    if sys.gettrace() is None and sys.getprofile() is None:
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            with contextlib.suppress(AttributeError, ValueError):  # no such signal, or not the main thread
                signal.signal(getattr(signal, name), signal.SIG_IGN)
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):  # gone, or closed
                if stream is not None:
                    stream.flush()
        os._exit(code)


def failure(error: BaseException) -> tuple[str, int]:
    """Return the message and the exit code of whatever ended a command."""
    if isinstance(error, RasterSliceError):
        return str(error), error.exit_code
    if isinstance(error, KeyboardInterrupt):
        return "interrupted", INTERRUPTED
    if isinstance(error, MemoryError):
        return "out of memory; use a larger --pitch or a smaller memory_mb", UsageError.exit_code
    if os.environ.get(DEBUG):
        traceback.print_exception(error)
    hint = f"please report it; {DEBUG}=1 shows where"
    return f"internal: {type(error).__name__}: {error}; {hint}", INTERNAL


def drop_stdout() -> None:
    """Keep Python from failing once more when it flushes at exit."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextlib.contextmanager
def progress(shown: bool) -> Iterator[Callable[[int, int], None] | None]:
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
