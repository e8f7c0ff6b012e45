"""Ctrl-C during a solve stops the solver and raises ``KeyboardInterrupt``."""

from __future__ import annotations

import contextlib
import io
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType

__all__ = ["interruptible"]


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Raise ``KeyboardInterrupt`` on exit if Ctrl-C was pressed inside the block.

    CasADi turns the interrupt into a failed solve and a warning on standard error; this context
    manager drops the warning and restores the interrupt. It has no effect outside the main thread,
    as other threads receive no signals.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    pressed = []

    def stop(signum: int, frame: FrameType | None) -> None:
        pressed.append(signum)
        signal.default_int_handler(signum, frame)

    before = signal.getsignal(signal.SIGINT)
    if before is not signal.default_int_handler:  # a custom handler, or ignored: leave it
        yield
        return
    signal.signal(signal.SIGINT, stop)
    captured = io.StringIO()
    try:
        with contextlib.redirect_stderr(captured):
            yield
    finally:
        signal.signal(signal.SIGINT, before)
        if not pressed:
            sys.stderr.write(captured.getvalue())
    if pressed:
        raise KeyboardInterrupt
