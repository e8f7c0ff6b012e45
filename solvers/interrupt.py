"""Ctrl-C during a solve: the solver stops and the interrupt is not lost."""

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
    """Raise ``KeyboardInterrupt`` on leaving if Ctrl-C was pressed inside.

    CasADi turns the interrupt into a failed solve and a warning on standard error; here it
    becomes an interrupt again. Outside the main thread, which receives no signals, nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    pressed = []

    def stop(signum: int, frame: FrameType | None) -> None:
        pressed.append(signum)
        signal.default_int_handler(signum, frame)

    before = signal.getsignal(signal.SIGINT)
    if before is not signal.default_int_handler:  # somebody else's handler, or ignored: leave it
        yield
        return
    signal.signal(signal.SIGINT, stop)
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            yield
    finally:
        signal.signal(signal.SIGINT, before)
        if not pressed:
            sys.stderr.write(said.getvalue())
    if pressed:
        raise KeyboardInterrupt
