"""The folder of a study: one record per run, one table, one lock.

=====================  =========================================================================
``study.json``         the runs of the study as last started, by key, with their labels
``runs/KEY.json``      the record of one run
``results.parquet``    the table: a row per run
``lock``               held by the process that writes here, and by the system's doing only while it lives
=====================  =========================================================================

Only the process that holds the lock writes. Every file is written whole under a temporary name and
renamed, so that a reader needs no lock.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from opfmodel.errors import ResultError, StudyError, nearest
from opfmodel.results import replace
from opfmodel.study.execution import Record
from opfmodel.study.specification import Specification

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["Store", "read_table", "shown_columns"]

Row = dict[str, Any]

# The first columns after those that vary, there even while no run has finished.
_COLUMNS = ("key", "status", "termination", "error", "cost", "steps", "max_violation", "iterations")


@dataclass(frozen=True)
class Store:
    """Reads and writes the folder of a study."""

    folder: Path

    @property
    def table(self) -> Path:
        """The table of all runs."""
        return self.folder / "results.parquet"

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the folder for this process alone.

        The lock is the operating system's: it ends with the process, however that dies.

        Raises
        ------
        StudyError
            Another process holds it.
        ResultError
            The folder cannot be made or written.
        """
        from filelock import FileLock, Timeout

        with self._writing(self.folder):
            self._runs.mkdir(parents=True, exist_ok=True)
            lock = FileLock(self.folder / "lock", timeout=0)
            try:
                lock.acquire()
            except Timeout:
                raise StudyError(
                    f"{self.folder}: a study is running in this folder{self._owner()}; "
                    "wait until it has ended, or choose another folder"
                ) from None
            for left in (
                *self.folder.glob(".*.json.*"),
                *self.folder.glob(".*.parquet.*"),
                *self._runs.glob(".*"),
            ):
                left.unlink()  # what a killed process was writing
        try:
            yield
        finally:
            lock.release()

    def begin(self, specifications: Sequence[Specification], about: Mapping[str, Any]) -> None:
        """Write down which runs there are and who makes them."""
        rows = [{"key": s.key, "labels": s.labels} for s in specifications]
        self._write(self.folder / "study.json", {**about, "runs": rows})

    def write(self, record: Record) -> None:
        """Keep the record of a run.

        Raises
        ------
        ResultError
            It cannot be written, for instance because the disk is full.
        """
        self._write(self._record(record.key), asdict(record))

    def read(self, key: str) -> Record | None:
        """The record of a run, None if it has not been made.

        Raises
        ------
        ResultError
            The file is there but is no record.
        """
        path = self._record(key)
        try:
            return Record(**json.loads(path.read_text(encoding="utf-8")))
        except FileNotFoundError:
            return None
        except (OSError, ValueError, TypeError) as error:
            raise ResultError(f"{path}: not the record of a run; delete it to run again: {error}") from error

    def rows(self) -> list[Row]:
        """A row per run of the study as last started; runs without a record have the status ``waiting``.

        Raises
        ------
        ResultError
            The folder holds no study, or a damaged one.
        """
        path = self.folder / "study.json"
        try:
            runs = json.loads(path.read_text(encoding="utf-8"))["runs"]
            pairs = [(run["labels"], self.read(run["key"]), run["key"]) for run in runs]
        except FileNotFoundError:
            raise ResultError(f"{path}: there is no such file; 'opfmodel study run' writes it") from None
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ResultError(f"{path}: not a study of opfmodel: {error}") from error
        figures = [_figures(key, record) for _, record, key in pairs]
        taken = {name for each in figures for name in each}
        made = [
            {f"vary.{name}" if name in taken else name: label for name, label in labels.items()} | each
            for (labels, _, _), each in zip(pairs, figures, strict=True)
        ]
        columns = dict.fromkeys(name for row in made for name in row)
        later = [name for name in columns if name.startswith(("time_", "provenance_"))]
        first = [name for name in columns if name not in later]
        return [{name: row.get(name) for name in (*first, *later)} for row in made]

    def write_table(self) -> None:
        """Write the table of all runs."""
        import pyarrow.parquet as pq

        table = _table(self.rows())
        with self._writing(self.table):
            replace(self.table, lambda path: pq.write_table(table, path))

    @property
    def _runs(self) -> Path:
        return self.folder / "runs"

    def _record(self, key: str) -> Path:
        return self._runs / f"{key}.json"

    def _write(self, path: Path, content: Mapping[str, Any]) -> None:
        text = json.dumps(content, indent=1, default=str) + "\n"
        with self._writing(path):
            replace(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))

    @contextmanager
    def _writing(self, path: Path) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            kept = len(list(self._runs.glob("*.json"))) if os.path.isdir(self._runs) else 0  # noqa: PTH112 - any text
            raise ResultError(
                f"{path}: results cannot be written: {error.strerror or error}; "
                f"the {kept} finished runs in {self.folder} are kept, and the same command goes on from there"
                if kept
                else f"{path}: results cannot be written: {error.strerror or error}"
            ) from error

    def _owner(self) -> str:
        """Who said last that he works here."""
        try:
            about = json.loads((self.folder / "study.json").read_text(encoding="utf-8"))
            return f" (process {about['process']} on {about['machine']['host']}, since {about['started']})"
        except (OSError, ValueError, KeyError):
            return ""  # it has not come so far as to say so


def read_table(folder: str | Path) -> list[Row]:
    """The rows of a study's table, finished or not, from the records in its folder.

    Returns
    -------
    list of dict
        Columns in order: what varies, ``key``, figures that the key determines, ``time_...``,
        ``provenance_...``. A varied key that has the name of a figure is called ``vary.KEY``.

    Raises
    ------
    ResultError
        The folder holds no study.
    """
    return Store(Path(folder)).rows()


def shown_columns(rows: Sequence[Row], wanted: Sequence[str] | None = None) -> list[str]:
    """The wanted columns; by default what varies and the figures, where any run has one.

    Raises
    ------
    ResultError
        The table has no such column.
    """
    names = list(rows[0])
    for name in wanted or ():
        if name not in names:
            raise ResultError(f"the table has no column {name!r}; {nearest(name, names)}")
    if wanted:
        return list(wanted)
    aside = ("key", "termination", "diagnosis")
    return [
        name
        for name in names
        if name not in aside
        and not name.startswith(("time_", "provenance_"))
        and any(row[name] is not None for row in rows)
    ]


def _figures(key: str, record: Record | None) -> Row:
    """What a row has besides the labels of its run."""
    figures = dict.fromkeys(_COLUMNS) | {"key": key, "status": "waiting"}
    return figures if record is None else {**figures, **record.result, **record.times, **record.provenance}


def _table(rows: Sequence[Row]) -> pa.Table:
    import pyarrow as pa

    return pa.table({name: _column([row[name] for row in rows]) for name in (rows[0] if rows else ())})


def _column(values: list[Any]) -> pa.Array:
    """Values of one type as they are; of several types, such as 12 and "all", or beyond 64 bits, as JSON."""
    import pyarrow as pa

    kinds = {float if type(value) is int else type(value) for value in values if value is not None}
    if len(kinds) <= 1:
        try:
            return pa.array(values, None if kinds else pa.string())
        except (OverflowError, pa.ArrowInvalid):  # an integer that the column cannot hold exactly
            pass
    return pa.array([None if value is None else json.dumps(value) for value in values], pa.string())
