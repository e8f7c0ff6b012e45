"""A process that runs commands of opfmodel one after another and reports how each ended.

It is started with the names of modules to import first. Requests and replies are lines of JSON on standard
input and output: a request has ``arguments``, ``folder`` (of the input, the working directory) and ``out``
(where the command may write); a reply has ``code``, ``trace``, ``megabytes``, ``written`` and ``started``.
What the command prints goes to ``stdout`` and ``stderr`` beside the folder.
"""

from __future__ import annotations

import faulthandler
import importlib
import json
import os
import platform
import resource
import signal
import sys
import traceback
import warnings
from pathlib import Path
from typing import Any

MB = 1_000_000
MOST_ADDRESSES = 6_000 * MB  # libraries reserve much more than they use, which the caller limits
MOST_OUTPUT = 20 * MB
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_PATHS = {"os.mkdir": (0,), "os.remove": (0,), "os.rmdir": (0,), "os.rename": (0, 1), "os.link": (1,), "os.symlink": (1,), "os.truncate": (0,), "os.chmod": (0,)}  # fmt: skip
_STARTS = {"subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork", "pty.spawn", "socket.connect", "ctypes.dlopen"}  # fmt: skip


class Watch:
    """An audit hook that notes where a command writes and what it starts."""

    def __init__(self) -> None:
        self.out: Path | None = None
        self.written: set[str] = set()
        self.started: set[str] = set()
        sys.addaudithook(self)

    def __call__(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.out is None:
            return
        if event == "open":
            path, _, flags = arguments
            if not isinstance(path, int) and isinstance(flags, int) and flags & _WRITING:
                self.note(path)
        elif event in _PATHS:
            for place in _PATHS[event]:
                self.note(arguments[place])
        elif event in _STARTS and not (event == "ctypes.dlopen" and not arguments[0]):
            self.started.add(f"{event}: {str(arguments[0])[:100]}")

    def note(self, path: Any) -> None:
        """Note a path unless it is inside the folder for output."""
        if isinstance(path, int):
            return
        found = os.path.abspath(os.fsdecode(path))  # noqa: PTH100 - links stay
        if found != os.devnull and not Path(found).is_relative_to(self.out or "/"):
            self.written.add(found)


def run(arguments: list[str]) -> tuple[int | None, str]:
    """Run a command; return its exit status, or None and the traceback of what it raised."""
    from opfmodel.cli import main

    sys.argv = ["opfmodel", *arguments]
    try:
        with warnings.catch_warnings():
            main()
    except SystemExit as stop:
        return (stop.code, "") if isinstance(stop.code, int) else (None, f"SystemExit: {stop.code!r}")
    except BaseException:
        return None, traceback.format_exc()


def redirect(folder: Path) -> None:
    """Send standard output and standard error to files beside a folder, from their beginning."""
    for number, stream in ((1, sys.stdout), (2, sys.stderr)):
        stream.flush()
        name = "stdout" if number == 1 else "stderr"
        descriptor = os.open(folder.parent / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
        os.dup2(descriptor, number)
        os.close(descriptor)


def peak() -> float:
    """Return the peak of the resident memory since the last call, MB."""
    status = Path("/proc/self/status").read_text()
    (kilobytes,) = (line.split()[1] for line in status.splitlines() if line.startswith("VmHWM"))
    Path("/proc/self/clear_refs").write_text("5")
    return int(kilobytes) / 1000


def limit() -> None:
    """Limit the address space beyond what is in use now, and the size of files."""
    status = Path("/proc/self/status").read_text()
    (kilobytes,) = (line.split()[1] for line in status.splitlines() if line.startswith("VmSize"))
    resource.setrlimit(resource.RLIMIT_AS, (int(kilobytes) * 1024 + MOST_ADDRESSES,) * 2)
    resource.setrlimit(resource.RLIMIT_FSIZE, (MOST_OUTPUT,) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def serve() -> None:
    """Answer requests until standard input ends."""
    requests, replies = os.fdopen(os.dup(0), "r"), os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    faulthandler.enable()
    faulthandler.register(signal.SIGUSR1)
    for module in sys.argv[1:]:
        importlib.import_module(module)
    importlib.import_module("opfmodel.cli")
    platform.processor()  # asks the system once, in a process
    limit()
    watch = Watch()
    replies.write("{}\n")
    replies.flush()
    for line in requests:
        request = json.loads(line)
        folder = Path(request["folder"])
        os.chdir(folder)
        redirect(folder)
        peak()
        watch.written, watch.started, watch.out = set(), set(), Path(request["out"])
        code, trace = run(request["arguments"])
        watch.out = None
        sys.stdout.flush()
        sys.stderr.flush()
        reply = {"code": code, "trace": trace, "megabytes": peak()}
        reply |= {"written": sorted(watch.written), "started": sorted(watch.started)}
        replies.write(json.dumps(reply) + "\n")
        replies.flush()


if __name__ == "__main__":
    serve()
