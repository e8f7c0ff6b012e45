"""Ctrl-C stops whatever runs and raises ``KeyboardInterrupt``, in CasADi's calls too.

So do SIGTERM and SIGHUP in a process that handles them as Python handles Ctrl-C::

    signal.signal(signal.SIGTERM, signal.default_int_handler)
"""

from __future__ import annotations

import contextlib
import io
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

__all__ = ["MARK", "STOPS", "deferred", "interruptible"]

Handler = Callable[[int, FrameType | None], object]

STOPS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""The signals that ask a process to end."""

MARK = "raises_keyboard_interrupt"
"""Attribute of signal handlers that raise ``KeyboardInterrupt``, for :func:`interruptible`."""


def _raises(handler: object) -> bool:
    return handler is signal.default_int_handler or getattr(handler, MARK, False)


@contextlib.contextmanager
def deferred() -> Iterator[None]:
    """Put off the handling of the signals that ask a process to end until the end of the block.

    It has no effect outside the main thread, and on signals that are ignored or end the process at once.
    """
    arrived: list[int] = []
    handlers = {number: signal.getsignal(number) for number in STOPS}
    ours = threading.current_thread() is threading.main_thread()
    handled = {number: handler for number, handler in handlers.items() if ours and callable(handler)}
    for number in handled:
        signal.signal(number, lambda signum, _: arrived.append(signum))
    try:
        yield
    finally:
        for number, handler in handled.items():
            signal.signal(number, handler)
        if arrived:
            handled[arrived[0]](arrived[0], None)


class _Watch:
    """A signal handler that remembers that it was called, in front of the handlers that raise."""

    def __init__(self, handlers: dict[int, Handler]) -> None:
        self.handlers = handlers
        self.pressed = False

    def __call__(self, signum: int, frame: FrameType | None) -> None:
        self.pressed = True
        self.handlers[signum](signum, frame)

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Handle Ctrl-C inside the block, and do not report what Python ignores of it in destructors."""

        def report(unraisable: UnraisableHookArgs) -> None:
            if not issubclass(unraisable.exc_type, KeyboardInterrupt):
                hook(unraisable)

        for number in self.handlers:
            signal.signal(number, self)
        hook, sys.unraisablehook = sys.unraisablehook, report
        try:
            yield
        finally:
            for number, handler in self.handlers.items():
                signal.signal(number, handler)
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
    known = {number: signal.getsignal(number) for number in STOPS}
    outer = next((handler for handler in known.values() if isinstance(handler, _Watch)), None)
    handlers = {
        number: handler for number, handler in known.items() if callable(handler) and _raises(handler)
    }
    ours = threading.current_thread() is threading.main_thread()
    if not ours or not (outer or handlers):
        yield
        return
    watch = outer or _Watch(handlers)
    captured = io.StringIO()
    try:
        with (
            contextlib.nullcontext() if outer else watch.installed(),
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
