"""Run measurements in separate processes and record the results and the machine."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import platform
import re
import resource
import statistics
import sys
import time
from collections.abc import Callable
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

__all__ = ["RESULTS", "arguments", "format_cell", "machine", "measure", "median", "report", "splice", "timed"]

RESULTS = Path(__file__).parent / "results"
PACKAGES = (
    "opfmodel",
    "casadi",
    "numpy",
    "scipy",
    "qpsolvers",
    "cvxpy",
    "clarabel",
    "osqp",
    "piqp",
    "highspy",
    "scs",
    "pypsa",
    "pandapower",
    "pypower",
    "pyomo",
)


def arguments(description: str) -> argparse.Namespace:
    """Parse the options that all benchmarks share."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument(
        "--repeat", type=int, default=3, help="runs of each measurement; the median is reported"
    )
    parser.add_argument("--quick", action="store_true", help="small sizes, as a smoke test")
    return parser.parse_args()


def timed(function: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds that a call takes, and its result."""
    began = time.perf_counter()
    result = function()
    return time.perf_counter() - began, result


def measure(
    function: Callable[..., dict[str, Any]],
    *args: Any,
    seconds: float | None = None,
    gigabytes: float | None = None,
) -> dict[str, Any]:
    """Call a function in a new process; return its result with the peak memory of the process in MB.

    Parameters
    ----------
    seconds, gigabytes
        Time after which the process is ended, and memory that it may use; by default there are no limits.
    """
    context = multiprocessing.get_context("spawn")
    receive, send = context.Pipe(duplex=False)
    process = context.Process(target=_child, args=(send, function, args, gigabytes))
    process.start()
    send.close()
    try:
        if not receive.poll(seconds):
            process.kill()
            process.join()
            return {"error": f"not done after {seconds:g} s"}
        result: dict[str, Any] = receive.recv()
    except EOFError:
        process.join()
        limited = "" if gigabytes is None else f", limited to {gigabytes:g} GB"
        return {"error": f"the process ended with status {process.exitcode}{limited}"}
    except BaseException:
        process.kill()
        raise
    process.join()
    return result


def _child(
    send: Any, function: Callable[..., dict[str, Any]], args: tuple[Any, ...], gigabytes: float | None
) -> None:
    if gigabytes is not None:
        most = int(gigabytes * 1e9)
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))
    try:
        result = function(*args)
    except Exception as error:
        result = {"error": f"{type(error).__name__}: {error}"}
    scale = 1 if sys.platform == "darwin" else 1024
    result["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * scale / 1e6
    send.send(result)
    send.close()


def median(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Median of every number over several runs of one measurement; what a run lacks is None."""
    if any("error" in run for run in runs):
        return next(run for run in runs if "error" in run)
    first = runs[0]
    return {
        key: statistics.median([run[key] for run in runs if run[key] is not None])
        if isinstance(value, int | float)
        else value
        for key, value in first.items()
    }


def machine() -> dict[str, Any]:
    """Processor, system and package versions of the measurements."""
    versions = {}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": platform.system(),
        "python": platform.python_version(),
        "versions": versions,
    }


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def report(name: str, rows: list[dict[str, Any]], goals: dict[str, Any] | None = None) -> None:
    """Print the rows as a table and write them, with the machine, to ``benchmarks/results``."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    table = [columns, *([format_cell(row.get(c)) for c in columns] for row in rows)]
    widths = [max(len(line[i]) for line in table) for i in range(len(columns))]
    for line in table:
        print(
            "  ".join(
                cell.rjust(w) if i else cell.ljust(w)
                for i, (cell, w) in enumerate(zip(line, widths, strict=True))
            )
        )
    for goal, value in (goals or {}).items():
        print(f"{goal}: {format_cell(value)}")
    RESULTS.mkdir(exist_ok=True)
    content = {
        "benchmark": name,
        "date": f"{date.today():%Y-%m-%d}",
        "machine": machine(),
        "rows": rows,
        "goals": goals or {},
    }
    (RESULTS / f"{name}.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def format_cell(value: Any) -> str:
    """Format a value for a table."""
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 1e5 else f"{value:,.2f}"
    return str(value)


def splice(page: Path, heading: str, text: str) -> None:
    """Replace the text between the comments ``heading`` and ``end`` of a page."""
    before = page.read_text(encoding="utf-8")
    pattern = re.compile(rf"(<!-- {re.escape(heading)} -->\n).*?(<!-- end -->\n)", re.DOTALL)
    assert pattern.search(before), f"{page}: no place for {heading!r}"
    after = pattern.sub(lambda found: f"{found[1]}{text.rstrip()}\n{found[2]}", before)
    page.write_text(after, encoding="utf-8")
