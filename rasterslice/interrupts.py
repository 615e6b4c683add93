"""Requests to end: what Ctrl-C and its kin do, and when they have to wait."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any, NoReturn

_held = 0  # blocks that nothing may break off
_asked = False  # to end, meanwhile
_end: Callable[[], NoReturn] | None = None  # what `signals` does about it


@contextlib.contextmanager
def signals(last: bool = False) -> Iterator[None]:
    """Let a polite request to end do what Ctrl-C does, so that nothing half-written stays.

    The first one counts: whoever presses Ctrl-C twice must not interrupt the tidying up. With `last`, nothing comes
    after this but the end of the process, which is not to be interrupted either.
    """
    global _asked, _end
    hook = sys.unraisablehook
    interrupted = False

    def end() -> NoReturn:
        global _asked
        nonlocal interrupted
        _asked, interrupted = False, True
        for number in before:
            signal.signal(number, signal.SIG_IGN)
        # Libraries that are stopped half-way through an import complain in finalizers: noise after the one line.
        sys.unraisablehook = lambda _: None
        raise KeyboardInterrupt

    def ask(signum: int, frame: FrameType | None) -> None:
        global _asked
        _asked = True
        if not _held:
            end()

    before: dict[int, Any] = {}
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        with contextlib.suppress(ValueError):  # not the main thread
            if number and signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                before[number] = signal.signal(number, ask)
    if before:
        _asked, _end = False, end
    try:
        yield
    finally:
        if not (last and interrupted):
            sys.unraisablehook = hook
            for number, handler in before.items():
                signal.signal(number, handler)


@contextlib.contextmanager
def unbroken() -> Iterator[None]:
    """Let a request to end wait until the end of a block.

    An import that is broken off may leave a lock behind for which another thread waits for ever, or a library half
    made, or swallow the interrupt; a wait for a future, too, may leave its lock behind, and then its thread never ends.
    """
    global _held
    if threading.current_thread() is not threading.main_thread():  # it gets no signals
        yield
        return
    _held += 1
    try:
        yield
    finally:
        _held -= 1
        if _asked and not _held and _end is not None:
            _end()
