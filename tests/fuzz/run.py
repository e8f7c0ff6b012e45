"""Running of mutated inputs on a pool of worker processes, and what is made of how they end."""

from __future__ import annotations

import json
import os
import random
import re
import select
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any

import psutil

from .corpus import OUT, VALUE, Seed, seeds
from .mutate import Content, Mutation, Special, draw, mutated

__all__ = ["Case", "Outcome", "Pool", "Worker", "cases", "fuzz", "minimised", "place"]

CPU_SECONDS = 10.0
WALL_SECONDS = 120.0  # of a process that waits; the machine may be busy with others
MEGABYTES = 2_000.0
MOST_LINES, MOST_CHARACTERS = 500, 20_000  # of one line
STATUSES = ("accepted", "refused", "timed out", "crashed", "misbehaved")
FAULTS = STATUSES[2:]

_WORKER = Path(__file__).with_name("worker.py")
_PANIC = re.compile(
    r"Traceback \(most recent call last\)|Exception ignored in|panicked at|Fatal Python error"
)


@dataclass(frozen=True)
class Case:
    """One input: a seed, what is changed, and the command."""

    seed: Seed
    mutations: Sequence[Mutation]
    command: Sequence[str]

    @property
    def files(self) -> dict[str, Content]:
        """The files of the input."""
        return mutated(self.seed.files, self.mutations)

    def __str__(self) -> str:
        changes = ", ".join(f"{m.operator} in {m.file} ({m.seed})" for m in self.mutations)
        return f"{self.seed.kind} {self.seed.name}: {' '.join(self.command)}: {changes or 'unchanged'}"


@dataclass(frozen=True)
class Outcome:
    """How a command ended.

    Attributes
    ----------
    status
        One of :data:`STATUSES`.
    what
        For a fault: the same text for the same fault, whatever the input.
    detail
        Message, traceback or the end of standard error.
    """

    status: str
    what: str = ""
    detail: str = ""

    @property
    def fault(self) -> bool:
        """Whether opfmodel, not the input, is to blame."""
        return self.status in FAULTS


def place(files: Mapping[str, Content], folder: Path) -> None:
    """Write the files of an input."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        match content:
            case bytes():
                path.write_bytes(content)
            case Special.FOLDER:
                path.mkdir()
            case Special.PIPE:
                os.mkfifo(path)
            case Special.LOOP:
                path.symlink_to(path)
            case Special.DEVICE:
                path.symlink_to("/dev/zero")


class Worker:
    """A worker process and the folders that it uses."""

    def __init__(self, folder: Path, imports: Iterable[str] = ()) -> None:
        self.folder = folder
        self.imports = list(imports)
        self.process: subprocess.Popen[str] | None = None

    def run(self, files: Mapping[str, Content], command: Sequence[str]) -> Outcome:
        """Run a command on files."""
        process = self.process or self._start()  # it may write caches
        given, out = self.folder / "input", self.folder / "out"
        for folder in (given, out):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
        place(files, given)
        value = files.get("value", b"")
        text = os.fsdecode(value.replace(b"\0", b"")) if isinstance(value, bytes) else ""
        arguments = [text if word == VALUE else word.replace(OUT, str(out)) for word in command]
        before = _listing(self.folder, out)
        reply = self._ask(process, {"arguments": arguments, "folder": str(given), "out": str(out)})
        printed = [_read(self.folder / name) for name in ("stdout", "stderr")]
        written = sorted(_listing(self.folder, out) ^ before)
        return _judged(reply, *printed, written, as_json="--json" in command)

    def _ask(self, process: subprocess.Popen[str], request: Mapping[str, Any]) -> dict[str, Any]:
        """Send a request; return the reply, or how the process ended instead."""
        assert process.stdin is not None
        process.stdin.write(json.dumps(request) + "\n")
        process.stdin.flush()
        if reply := self._reply(process, CPU_SECONDS):
            return reply
        code = process.poll()
        large = code is None and _use(psutil.Process(process.pid))[1] > MEGABYTES
        if code is None:
            process.send_signal(signal.SIGUSR1)  # writes the stack on standard error
            time.sleep(0.5)
        self.stop()
        return {
            "ended": "too large" if large else "too long" if code is None else "",
            "code": code,
            "trace": "",
        }

    def _start(self) -> subprocess.Popen[str]:
        home = self.folder / "home"
        home.mkdir(parents=True, exist_ok=True)
        variables = {
            "HOME": str(home),
            "TMPDIR": str(home),
            "MPLBACKEND": "agg",
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
        process = subprocess.Popen(
            [sys.executable, "-P", str(_WORKER), *self.imports],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
            env={**os.environ, **variables, **threads}, errors="surrogateescape", cwd=home,
        )  # fmt: skip
        self.process = process
        if self._reply(process, 200.0) is None:
            raise RuntimeError("the worker process does not start")
        return process

    def _reply(self, process: subprocess.Popen[str], cpu_seconds: float) -> dict[str, Any] | None:
        """The reply of the process; None if it ends or takes too long."""
        assert process.stdout is not None
        watched = psutil.Process(process.pid)
        began, (before, _) = time.monotonic(), _use(watched)
        while not select.select([process.stdout], [], [], 0.25)[0]:
            used, megabytes = _use(watched)
            if (
                time.monotonic() - began > WALL_SECONDS
                or used > cpu_seconds + before
                or megabytes > MEGABYTES
            ):
                return None
        line = process.stdout.readline()
        if not line:
            process.wait()
            return None
        return dict(json.loads(line))

    def stop(self) -> None:
        """End the process."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            for stream in (self.process.stdin, self.process.stdout):
                if stream is not None:
                    stream.close()
            self.process = None


def _use(process: psutil.Process) -> tuple[float, float]:
    """Processor time that a process has used, s, and the memory that it has now, MB; zero if it has ended."""
    try:
        times, memory = process.cpu_times(), process.memory_info()
    except psutil.Error:
        return 0.0, 0.0
    return float(times.user + times.system), memory.rss / 1e6


def _listing(folder: Path, without: Path) -> set[tuple[str, int, int]]:
    """Name, size and time of change of all files below a folder but those in another."""
    found = set()
    for parent, folders, files in os.walk(folder):
        if Path(parent) == without:
            folders.clear()
            continue
        for name in files:
            path = Path(parent) / name
            if path.parent != folder:  # what is printed
                status = path.lstat()
                found.add((str(path.relative_to(folder)), status.st_size, status.st_mtime_ns))
    return found


def _read(path: Path) -> str:
    return path.read_text(errors="replace") if path.exists() else ""


def _judged(
    reply: Mapping[str, Any], output: str, errors: str, changed: Sequence[object], as_json: bool
) -> Outcome:
    """The outcome of a command, from its exit status and from what it printed and wrote."""
    code, trace = reply["code"], reply["trace"]
    if ended := reply.get("ended"):
        where = f"{ended} at {_last_frame(errors)}"
        return Outcome("timed out" if ended == "too long" else "crashed", where, errors[-3000:])
    if trace or code not in (0, 1, 2) or _PANIC.search(errors):
        what = (
            _raised(trace)
            if trace
            else f"exit status {code}"
            if code not in (0, 1, 2)
            else "printed a traceback"
        )
        return Outcome("crashed", what, trace + errors[-3000:])
    if reply["megabytes"] > MEGABYTES:
        return Outcome("crashed", "too large", f"{reply['megabytes']} MB\n{errors[-3000:]}")
    for rule, kept in _rules(reply, output, errors, changed, as_json):
        if not kept:
            return Outcome("misbehaved", rule, f"{reply}\n{changed}\n{output[:500]}\n{errors[:2000]}")
    return Outcome("refused" if code == 2 else "accepted", "", errors)


def _rules(
    reply: Mapping[str, Any], output: str, errors: str, changed: Sequence[object], as_json: bool
) -> Iterator[tuple[str, bool]]:
    """The rules that every command keeps, and whether this one did."""
    messages = [line for line in errors.splitlines() if line.startswith("error: ")]
    printed = output + errors
    yield "a refusal has an error message", (reply["code"] == 2) <= bool(messages)
    yield "no error without a refusal", (reply["code"] == 0) <= (not messages)
    own = [
        line for line in errors.splitlines() if not line.startswith("error: Invalid value for '--")
    ]  # typer's
    yield (
        "messages are opfmodel's own",
        not any("nput should be" in line or "pydantic" in line for line in own),
    )
    yield "few lines on standard error", errors.count("\n") <= MOST_LINES
    yield "short lines on standard error", max(map(len, errors.splitlines()), default=0) <= MOST_CHARACTERS
    yield "what is printed is printable", all(line.isprintable() for line in printed.split("\n"))
    yield "nothing is written elsewhere", not reply["written"] and not changed
    yield "nothing is started", not reply["started"]
    if as_json and output:
        yield "one JSON object", output.count("\n") == 1 and isinstance(json.loads(output), dict)


_FRAME = re.compile(r'File "([^"]+)", line (\d+)')


def _last_frame(text: str) -> str:
    """The innermost place in opfmodel, else anywhere, that a stack names."""
    frames = _FRAME.findall(text)
    own = [frame for frame in frames if "/opfmodel/" in frame[0] and "site-packages" not in frame[0]]
    file, line = (own or frames or [("", "0")])[0 if "most recent call first" in text else -1]
    return f"{file.rpartition('/opfmodel/')[2] or file}:{line}"


def _raised(trace: str) -> str:
    """Kind of an exception and its place."""
    lines = [line for line in trace.splitlines() if line and not line[0].isspace()]
    kind = next((line for line in reversed(lines) if re.match(r"[\w.<>]+(:|$)", line)), "").partition(":")[0]
    return f"{kind} at {_last_frame(trace)}"


# Drawing and running ----------------------------------------------------------------------------


def cases(chosen: Sequence[Seed], seed: object, number: int | None = None) -> Iterator[Case]:
    """Yield mutated inputs, without end unless a number is given; the seeds take turns."""
    drawn = 0
    while number is None or drawn < number:
        source = chosen[drawn % len(chosen)]
        rng = random.Random(f"{seed} {source.kind} {source.name} {drawn}")
        yield Case(source, draw(rng, source.targets), rng.choice(source.commands))
        drawn += 1


class Pool:
    """Worker processes, each used by one thread at a time.

    Parameters
    ----------
    folder
        Folder for the files of the workers.
    """

    def __init__(self, folder: Path, size: int, imports: Iterable[str] = ()) -> None:
        self.folder, self.size, self.imports = folder, size, list(imports)
        self.idle = [Worker(folder / str(n), self.imports) for n in range(size)]

    def __enter__(self) -> Pool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for worker in self.idle:
            worker.stop()

    def run(self, case: Case) -> Outcome:
        """Run one input; a fault counts only if it is repeated in a fresh process."""
        worker = self.idle.pop()
        try:
            outcome = worker.run(case.files, case.command)
            if outcome.fault:
                worker.stop()
                outcome = worker.run(case.files, case.command)
            return outcome
        finally:
            self.idle.append(worker)

    def each(self, inputs: Iterable[Case]) -> Iterator[tuple[Case, Outcome]]:
        """Run inputs side by side and yield them with their outcomes, in order of their ends."""
        lock, found, source = threading.Lock(), [], iter(inputs)

        def work() -> None:
            while True:
                with lock:
                    case = next(source, None)
                if case is None:
                    return
                found.append((case, self.run(case)))

        with ThreadPoolExecutor(self.size) as threads:
            running = [threads.submit(work) for _ in range(self.size)]
            while found or not all(thread.done() for thread in running):
                if found:
                    yield found.pop(0)
                else:
                    time.sleep(0.02)
            for thread in running:
                thread.result()


def minimised(pool: Pool, case: Case, outcome: Outcome) -> Case:
    """Leave out the mutations that the fault does not need."""
    for mutation in case.mutations:
        shorter = replace(case, mutations=[m for m in case.mutations if m is not mutation])
        found = pool.run(shorter)
        if (found.status, found.what) == (outcome.status, outcome.what):
            case = shorter
    return case


# Counting and keeping ---------------------------------------------------------------------------


@dataclass
class Report:
    """Counts of inputs by kind and outcome, and the faults found."""

    seed: str
    counts: dict[str, Counter[str]] = field(default_factory=dict)
    faults: dict[str, int] = field(default_factory=dict)

    def add(self, case: Case, outcome: Outcome) -> bool:
        """Count an input; return whether it shows a fault not seen before."""
        self.counts.setdefault(case.seed.kind, Counter())[outcome.status] += 1
        if not outcome.fault:
            return False
        name = f"{outcome.status}: {outcome.what}"
        self.faults[name] = self.faults.get(name, 0) + 1
        return self.faults[name] == 1

    def as_dict(self) -> dict[str, Any]:
        """Return the counts for a JSON file."""
        rows = {kind: {status: found[status] for status in STATUSES} for kind, found in self.counts.items()}
        return {"seed": self.seed, "counts": rows, "faults": self.faults}

    def markdown(self) -> str:
        """Return the counts as a Markdown table."""
        rows = [("input", "inputs", *STATUSES)]
        rows += [
            (kind, str(found.total()), *(str(found[status]) for status in STATUSES))
            for kind, found in self.counts.items()
        ]
        total = sum(self.counts.values(), Counter())
        rows.append(("all", str(total.total()), *(str(total[status]) for status in STATUSES)))
        lines = ["| " + " | ".join(row) + " |" for row in rows]
        return "\n".join([lines[0], "| --- |" + " ---: |" * (len(rows[0]) - 1), *lines[1:]]) + "\n"


def keep(case: Case, outcome: Outcome, folder: Path) -> Path:
    """Save an input that shows a fault, with the command that repeats it."""
    name = re.sub(r"\W+", "-", f"{case.seed.kind}-{outcome.what}")[:80].strip("-")
    target = folder / name
    shutil.rmtree(target, ignore_errors=True)
    place(case.files, target / "input")
    about = {"command": list(case.command), "mutations": [asdict(m) for m in case.mutations]}
    about |= {"seed": case.seed.name, "kind": case.seed.kind, "status": outcome.status, "what": outcome.what}
    (target / "case.json").write_text(json.dumps(about, indent=1) + "\n")
    (target / "detail.txt").write_text(f"{case}\n\n{outcome.detail}\n", errors="replace")
    return target


def fuzz(
    kinds: Sequence[str],
    seed: object,
    seconds: float,
    folder: Path,
    workers: int = 2,
    number: int | None = None,
) -> Report:
    """Run mutated inputs of each kind for an equal time, or a fixed number of each.

    Faults are shortened and saved below the folder.
    """
    report = Report(str(seed))
    for kind in kinds:
        chosen = seeds(kind)
        imports = dict.fromkeys(module for source in chosen for module in source.imports)
        with Pool(folder / "workers", workers, imports) as pool:
            list(pool.each(Case(s, (), s.commands[0]) for s in chosen[:1] * workers))  # starts the processes
            end = time.monotonic() + seconds / len(kinds)
            inputs = cases(chosen, seed, number)
            timed = inputs if number is not None else _until(end, inputs)
            new = [pair for pair in pool.each(timed) if report.add(*pair)]
            for case, outcome in new:
                shorter = minimised(pool, case, outcome)
                kept = keep(shorter, outcome, folder / "faults")
                print(f"{outcome.status}: {outcome.what}: {kept}", flush=True)  # noqa: T201
        print(kind, dict(report.counts[kind]), flush=True)  # noqa: T201
    return report


def _until(end: float, inputs: Iterator[Case]) -> Iterator[Case]:
    for case in inputs:
        if time.monotonic() > end:
            return
        yield case
