"""Ctrl-C stops whatever runs and raises ``KeyboardInterrupt``, in CasADi's calls too."""

from __future__ import annotations

import contextlib
import io
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

__all__ = ["interruptible"]


class _Watch:
    """A signal handler that remembers that it was called."""

    def __init__(self) -> None:
        self.pressed = False

    def __call__(self, signum: int, frame: FrameType | None) -> None:
        self.pressed = True
        signal.default_int_handler(signum, frame)

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Handle Ctrl-C inside the block, and do not report what Python ignores of it in destructors."""

        def report(unraisable: UnraisableHookArgs) -> None:
            if not issubclass(unraisable.exc_type, KeyboardInterrupt):
                hook(unraisable)

        before, hook = signal.signal(signal.SIGINT, self), sys.unraisablehook
        sys.unraisablehook = report
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)
            sys.unraisablehook = hook


@contextlib.contextmanager
def interruptible(*, quiet: bool = False) -> Iterator[None]:
    """Raise ``KeyboardInterrupt`` on exit if Ctrl-C was pressed inside the block.

    CasADi loses the interrupt where it calls Python to convert an argument, and turns it into a
    failed solve, or an error of another type, elsewhere. Python loses it in destructors and callbacks.
    Blocks may be nested; every one restores the interrupt, the innermost first. They have no effect
    outside the main thread, which alone receives signals, or under a custom handler.

    Parameters
    ----------
    quiet
        Whether to drop what the block writes to standard error if Ctrl-C was pressed, which is
        CasADi's warning.
    """
    before = signal.getsignal(signal.SIGINT)
    nested = isinstance(before, _Watch)
    ours = threading.current_thread() is threading.main_thread()
    if not ours or not (nested or before is signal.default_int_handler):
        yield
        return
    watch = before if isinstance(before, _Watch) else _Watch()
    captured = io.StringIO()
    try:
        with (
            contextlib.nullcontext() if nested else watch.installed(),
            contextlib.redirect_stderr(captured) if quiet else contextlib.nullcontext(),
        ):
            yield
    except Exception as error:
        if watch.pressed:
            raise KeyboardInterrupt from error
        raise
    finally:
        if not watch.pressed:
            sys.stderr.write(captured.getvalue())
    if watch.pressed:
        raise KeyboardInterrupt
