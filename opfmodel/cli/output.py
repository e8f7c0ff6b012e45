"""The one module that prints: results on standard output, everything else on standard error."""

from __future__ import annotations

import ctypes
import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from typing import Any

from opfmodel.errors import CaseWarning, Fault, ProfileWarning, ResultWarning, visible

__all__ = [
    "WarningPrinter",
    "print_faults",
    "print_json",
    "print_line",
    "print_notes",
    "print_pairs",
    "print_table",
    "remark",
    "solver_output",
]

_MOST_WARNINGS = 100
_MOST_FAULTS = 20


def print_line(line: str) -> None:
    """Print a line of results."""
    print(visible(line))  # noqa: T201


def remark(line: str) -> None:
    """Print an error, a warning or a note."""
    print(visible(line), file=sys.stderr)  # noqa: T201


def print_faults(faults: Sequence[Fault]) -> None:
    """Print what is wrong, each on a line, with an excerpt of the file below; no more than a screen holds."""
    for fault in faults[:_MOST_FAULTS]:
        remark(f"error: {fault}")
        for line in fault.excerpt.splitlines():
            remark(line)
    if len(faults) > _MOST_FAULTS:
        remark(f"error: and {len(faults) - _MOST_FAULTS} more")


def print_notes(notes: Sequence[str]) -> None:
    """Print notes on what was left out of a network or chosen for it."""
    for note in notes:
        remark(f"note: {note}")


class WarningPrinter:
    """Prints the first warnings of opfmodel; those of libraries address developers and are dropped."""

    def __init__(self) -> None:
        self.left = _MOST_WARNINGS

    def __call__(self, message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
        """Print a warning; the parameters are those of :func:`warnings.showwarning`."""
        if issubclass(category, CaseWarning | ProfileWarning | ResultWarning):
            if self.left > 0:
                remark(f"warning: {message}")
            elif self.left == 0:
                remark("warning: further warnings are not shown")
            self.left -= 1


def print_json(result: Mapping[str, Any]) -> None:
    """Print a result as one JSON object on one line."""
    from opfmodel.results.store import finite

    text = json.dumps(finite(result), allow_nan=False)
    print_line(text.replace("\x7f", "\\u007f"))  # DEL is the one control character left as it is


def print_pairs(pairs: Mapping[str, str]) -> None:
    """Print names and values in two columns."""
    width = max(len(key) for key in pairs)
    for key, value in pairs.items():
        print_line(f"{key:<{width}}  {value}")


def print_table(
    columns: Sequence[str], rows: Sequence[Sequence[str]], *, numbers: bool = False, prose: bool = False
) -> None:
    """Print a table.

    Parameters
    ----------
    numbers
        Whether all columns but the first hold numbers, which are right-aligned.
    prose
        Whether the last column holds sentences, which wrap at the width of the terminal.
    """
    cells = [[[visible(line) for line in cell.splitlines()] for cell in row] for row in (columns, *rows)]
    if prose and sys.stdout.isatty():
        _print_wrapped(cells)
        return
    widths = [
        max((len(line) for row in cells for line in row[place]), default=0) for place in range(len(columns))
    ]
    for row in cells:
        for number in range(max(map(len, row))):
            line = (cell[number] if number < len(cell) else "" for cell in row)
            padded = (
                part.rjust(width) if numbers and place else part.ljust(width)
                for place, (part, width) in enumerate(zip(line, widths, strict=True))
            )
            print_line("  ".join(padded).rstrip())


def _print_wrapped(cells: Sequence[Sequence[Sequence[str]]]) -> None:
    """Print a table, whose last column wraps at the width of the terminal."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(color_system=None)
    table = Table(box=None, pad_edge=False)
    head, *rows = (["\n".join(cell) for cell in row] for row in cells)
    for place, column in enumerate(head):
        table.add_column(Text(column), no_wrap=place < len(head) - 1)
    for row in rows:
        table.add_row(*map(Text, row))  # square brackets in a cell are not markup
    with console.capture() as captured:
        console.print(table)
    for line in captured.get().splitlines():
        print_line(line.rstrip())


@contextmanager
def solver_output(verbose: bool) -> Iterator[None]:
    """Keep solver output off standard output, which is for results; if verbose, print it on standard error.

    Libraries write to the file descriptor, bypassing Python's stream.
    """
    sys.stdout.flush()
    kept = os.dup(1)
    with open(os.devnull, "w", encoding="utf-8") as nowhere:  # noqa: PTH123 - no path of a file
        shown = sys.stderr if verbose else nowhere
        os.dup2(2 if verbose else nowhere.fileno(), 1)
        try:
            with redirect_stdout(shown):
                yield
        finally:
            _flush_libraries()
            os.dup2(kept, 1)
            os.close(kept)


def _flush_libraries() -> None:
    """Flush the buffers of C libraries while their output is still redirected."""
    with suppress(OSError, TypeError):  # where CDLL(None) fails, nothing is buffered
        ctypes.CDLL(None).fflush(None)
