"""Signals that end a command as Ctrl-C does."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

__all__ = ["ended_by_signals"]

_MARK = "raises_keyboard_interrupt"  # solvers.interrupt.MARK, whose import takes longer than a command needs


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Raise ``KeyboardInterrupt`` on SIGTERM and SIGHUP, unless the process was started to ignore them.

    After SIGHUP there may be no terminal any more: what is then written to it is dropped.
    """
    terminals = [number for number in (1, 2) if _is_terminal(number)]

    def end(signum: int, frame: FrameType | None) -> None:
        if signum != signal.SIGTERM:
            for number in terminals:
                _drop(number)
        signal.default_int_handler(signum, frame)

    setattr(end, _MARK, True)
    stops = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    taken = [number for number in stops if signal.getsignal(number) is signal.SIG_DFL]
    for number in taken:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)


def _is_terminal(number: int) -> bool:
    try:
        return os.isatty(number)
    except OSError:  # closed
        return False


def _drop(number: int) -> None:
    """Let a file descriptor write to nowhere."""
    with suppress(OSError), open(os.devnull, "w", encoding="utf-8") as nowhere:  # noqa: PTH123 - no path of a file
        os.dup2(nowhere.fileno(), number)
