"""The folder of a study: one record per run, one table, one lock.

=====================  =========================================================================
``study.json``         the runs of the study as last started, by key, with their labels
``runs/KEY.json``      the record of one run
``results.parquet``    the table: a row per run
``lock``               held by the process that writes here, and by the system's doing only while it lives
=====================  =========================================================================

Only the process that holds the lock writes. Every file is written whole under a temporary name and
renamed, so that a reader needs no lock. The JSON files have a checksum, and a record the key of its
name; what has not is not trusted, and the run counts as not made.
"""

from __future__ import annotations

import json
import os
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from opfmodel.errors import ResultError, ResultWarning, StudyError, nearest
from opfmodel.results import remove_temporaries, replace
from opfmodel.study.execution import Record
from opfmodel.study.sealed import sealed, unsealed
from opfmodel.study.specification import Specification

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["Store", "read_table", "shown_columns", "untrusted"]

Row = dict[str, Any]

_FILES = re.compile(r"study\.json|results\.parquet")
_RECORDS = re.compile(r"[0-9a-f]{32}\.json")

_MOST_NAMED = 10

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
            The folder cannot be made or written, or its ``runs`` is a symbolic link.
        """
        from filelock import FileLock, Timeout

        with self._writing(self.folder):
            if self._runs.is_symlink():
                raise ResultError(f"{self._runs}: is a symbolic link; the records need a folder of their own")
            self._runs.mkdir(parents=True, exist_ok=True)
            lock = FileLock(self.folder / "lock", timeout=0)
            try:
                lock.acquire()
            except Timeout:
                raise StudyError(
                    f"{self.folder}: a study is running in this folder{self._owner()}; "
                    "wait until it has ended, or choose another folder"
                ) from None
        try:
            with self._writing(self.folder):
                remove_temporaries(self.folder, _FILES)
                remove_temporaries(self._runs, _RECORDS)
            yield
        finally:
            lock.release()

    def begin(self, specifications: Sequence[Specification], about: Mapping[str, Any]) -> None:
        """Write down which runs there are and who makes them."""
        rows = [{"key": s.key, "labels": s.labels} for s in specifications]
        self._write(self._index, {**about, "runs": rows})

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
            What is there is not what was written for this key.
        """
        path = self._record(key)
        if not os.path.lexists(path):
            return None
        content = unsealed(path)
        if content.get("key") != key:
            raise ResultError(f"{path}: the key inside is not that of its name")
        try:
            return Record(**content)
        except TypeError as error:
            raise ResultError(f"{path}: not the record of a run: {error}") from error

    def records(self, keys: Iterable[str]) -> tuple[dict[str, Record], list[str]]:
        """The records of runs by key, and why others that are there cannot be trusted."""
        found, faults = {}, []
        for key in dict.fromkeys(keys):
            try:
                record = self.read(key)
            except ResultError as error:
                faults.append(str(error))
                continue
            if record is not None:
                found[key] = record
        return found, faults

    def runs(self) -> list[tuple[Mapping[str, Any], str]]:
        """Labels and key of every run of the study as last started.

        Raises
        ------
        ResultError
            The folder holds no study, or what is there is not what was written.
        """
        if not os.path.lexists(self._index):
            raise ResultError(f"{self._index}: there is no such file; 'opfmodel study run' writes it")
        content = unsealed(self._index)
        try:
            return [(run["labels"], run["key"]) for run in content["runs"]]
        except (KeyError, TypeError) as error:
            raise ResultError(f"{self._index}: not a study of opfmodel: {error}") from error

    def index_fault(self) -> str | None:
        """Why the list of runs cannot be trusted, if there is one that cannot."""
        if os.path.lexists(self._index):
            try:
                self.runs()
            except ResultError as error:
                return str(error)
        return None

    def rows(self) -> tuple[list[Row], list[str]]:
        """A row per run of the study as last started, and why records cannot be trusted.

        Runs without a record that can be trusted have the status ``waiting``.

        Raises
        ------
        ResultError
            As for :meth:`runs`.
        """
        runs = self.runs()
        records, faults = self.records(key for _, key in runs)
        figures = [_figures(key, records.get(key)) for _, key in runs]
        taken = {name for each in figures for name in each}
        made = [
            {f"vary.{name}" if name in taken else name: label for name, label in labels.items()} | each
            for (labels, _), each in zip(runs, figures, strict=True)
        ]
        columns = dict.fromkeys(name for row in made for name in row)
        later = [name for name in columns if name.startswith(("time_", "provenance_"))]
        first = [name for name in columns if name not in later]
        return [{name: row.get(name) for name in (*first, *later)} for row in made], faults

    def write_table(self) -> None:
        """Write the table of all runs."""
        import pyarrow.parquet as pq

        table = _table(self.rows()[0])
        with self._writing(self.table):
            replace(self.table, lambda path: pq.write_table(table, path))

    @property
    def _index(self) -> Path:
        return self.folder / "study.json"

    @property
    def _runs(self) -> Path:
        return self.folder / "runs"

    def _record(self, key: str) -> Path:
        return self._runs / f"{key}.json"

    def _write(self, path: Path, content: Mapping[str, Any]) -> None:
        text = sealed(content)
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
            about = unsealed(self._index)
            return f" (process {about['process']} on {about['machine']['host']}, since {about['started']})"
        except (ResultError, KeyError, TypeError):
            return ""  # it has not come so far as to say so


def read_table(folder: str | Path) -> list[Row]:
    """The rows of a study's table, finished or not, from the records in its folder.

    A :class:`ResultWarning` names the records that cannot be trusted; their runs are ``waiting``.

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
    rows, faults = Store(Path(folder)).rows()
    if faults:
        warnings.warn(f"{untrusted(faults)}; their runs are shown as waiting", ResultWarning, stacklevel=2)
    return rows


def untrusted(faults: Sequence[str]) -> str:
    """How many records cannot be trusted, and the first of them with what is wrong."""
    more = len(faults) - _MOST_NAMED
    named = "; ".join(faults[:_MOST_NAMED]) + (f"; and {more} more" if more > 0 else "")
    return f"{len(faults)} record{'s' * (len(faults) > 1)} cannot be trusted ({named})"


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
