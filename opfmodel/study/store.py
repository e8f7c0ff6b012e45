"""The folder of a study: one record per run, one table, one lock.

=====================  =========================================================================
``study.json``         the runs of the study as last started: keys and labels
``runs/KEY.json``      the record of one run
``runs/KEY/``          its trajectories and summary, if the study keeps trajectories
``results.parquet``    the table: a row per run
``lock``               held by the writing process; the operating system releases it
=====================  =========================================================================

Only the process that holds the lock writes. Every file is written completely under a temporary name
and then renamed; readers need no lock. JSON files have a checksum, and a record contains the key in
its file name. A file that fails either test is not trusted; the run of such a record counts as missing.
"""

from __future__ import annotations

import io
import json
import os
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from opfmodel.data.writing import remove_temporaries, replace
from opfmodel.errors import ResultError, ResultWarning, StudyError, listed, shown
from opfmodel.results.store import digest, load, unpack
from opfmodel.study.execution import Record
from opfmodel.study.sealed import sealed, unsealed
from opfmodel.study.specification import Specification

if TYPE_CHECKING:
    import pyarrow as pa
    import xarray as xr

__all__ = ["Store", "read_run", "read_table", "untrusted"]

Row = dict[str, Any]

_FILES = re.compile(r"study\.json|results\.parquet")
_RECORDS = re.compile(r"[0-9a-f]{32}\.json")
_KEPT = re.compile(r"trajectories\.nc|summary\.json")
_DIGEST = "provenance_trajectories_sha256"

_MOST_NAMED = 10

# First columns after the axes; present even before any run has finished.
_COLUMNS = ("key", "status", "termination", "error", "cost", "steps", "max_violation", "iterations")


@dataclass(frozen=True)
class Store:
    """Access to the folder of a study."""

    folder: Path

    @property
    def table(self) -> Path:
        """The table of all runs."""
        return self.folder / "results.parquet"

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Lock the folder for this process.

        The operating system releases the lock when the process ends, however it ends.

        Raises
        ------
        StudyError
            Another process holds the lock.
        ResultError
            The folder cannot be created or written, or its ``runs`` is a symbolic link.
        """
        from filelock import FileLock, Timeout

        with self._writing(self.folder):
            if self._runs.is_symlink():
                raise ResultError(f"{self._runs}: is a symbolic link; must be a folder")
            self._runs.mkdir(parents=True, exist_ok=True)
            lock = FileLock(self.folder / "lock", timeout=0)
            try:
                lock.acquire()
            except Timeout:
                raise StudyError(
                    f"{self.folder}: a study is running in this folder{self._owner()}; "
                    "wait until it ends, or choose another folder"
                ) from None
        try:
            with self._writing(self.folder):
                remove_temporaries(self.folder, _FILES)
                remove_temporaries(self._runs, _RECORDS)
            yield
        finally:
            lock.release()

    def begin(self, specifications: Sequence[Specification], about: Mapping[str, Any]) -> None:
        """Write the list of runs, with the details of this start."""
        rows = [{"key": s.key, "labels": s.labels} for s in specifications]
        self._write(self._index, {**about, "runs": rows})

    def write(self, record: Record) -> None:
        """Write the record of a run, after its files, if any; those of an earlier record are deleted.

        Raises
        ------
        ResultError
            It cannot be written, for instance because the disk is full.
        """
        folder, provenance = self._files(record.key), dict(record.provenance)
        with self._writing(folder):
            if record.files or os.path.lexists(folder):
                if folder.is_symlink():
                    raise ResultError(f"{folder}: is a symbolic link; must be a folder")
                folder.mkdir(exist_ok=True)
                remove_temporaries(folder, _KEPT)
                unpack(record.files, folder)
        if record.files:
            provenance[_DIGEST] = digest(folder)
        parts = {"result": record.result, "times": record.times, "provenance": provenance}
        self._write(self._record(record.key), {"key": record.key, **parts})

    def keeps(self, record: Record) -> bool:
        """Whether the trajectories of a recorded run are there and undamaged; one without steps has none."""
        known = record.provenance.get(_DIGEST)
        return not record.result.get("steps") or (
            known is not None and known == digest(self._files(record.key))
        )

    def trajectories(self, record: Record) -> xr.Dataset:
        """Return the trajectories of a recorded run.

        Raises
        ------
        ResultError
            There are none, or they are damaged.
        """
        folder = self._files(record.key)
        if not record.result.get("steps"):
            raise ResultError(f"{self._record(record.key)}: the run completed no step")
        if _DIGEST not in record.provenance:
            raise ResultError(
                f"{folder}: the run kept no trajectories; with 'keep: trajectories' in the study, "
                "'opfmodel study run' repeats it"
            )
        if not self.keeps(record):
            raise ResultError(
                f"{folder}: the trajectories are missing or damaged; 'opfmodel study run' repeats the run"
            )
        return load(folder)

    def read(self, key: str) -> Record | None:
        """Return the record of a run, or None if there is none.

        Raises
        ------
        ResultError
            The file is not the record that was written for this key.
        """
        path = self._record(key)
        if not os.path.lexists(path):
            return None
        content = unsealed(path)
        if content.get("key") != key:
            raise ResultError(f"{path}: the key inside does not match the file name")
        if content.keys() != {"key", "result", "times", "provenance"}:
            raise ResultError(f"{path}: not the record of a run: it has {', '.join(content)}")
        record = Record(**content)
        for name, part in (
            ("result", record.result),
            ("times", record.times),
            ("provenance", record.provenance),
        ):
            if not isinstance(part, dict):
                raise ResultError(
                    f"{path}: not the record of a run: {name} = {shown(part)}: must be a mapping"
                )
        if not isinstance(status := record.result.get("status"), str):
            raise ResultError(f"{path}: not the record of a run: status = {shown(status)}: must be text")
        return record

    def records(self, keys: Iterable[str]) -> tuple[dict[str, Record], list[str]]:
        """Return the trusted records by key, and why others cannot be trusted."""
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
        """Return labels and key of every run of the study as last started.

        Raises
        ------
        ResultError
            The folder holds no study, or its list of runs cannot be trusted.
        """
        if not os.path.lexists(self._index):
            raise ResultError(f"{self._index}: no such file; 'opfmodel study run' creates it")
        content = unsealed(self._index)
        runs = content.get("runs")
        if not isinstance(runs, list) or not runs:
            raise ResultError(
                f"{self._index}: not a study of opfmodel: runs = {shown(runs)}: must be a list of runs"
            )
        for run in runs:
            if not _is_run(run):
                raise ResultError(
                    f"{self._index}: not a study of opfmodel: {shown(run)}: "
                    "must have labels and a key of 32 digits"
                )
        return [(run["labels"], run["key"]) for run in runs]

    def index_fault(self) -> str | None:
        """Return why the list of runs cannot be trusted; None if it can, or does not exist."""
        if os.path.lexists(self._index):
            try:
                self.runs()
            except ResultError as error:
                return str(error)
        return None

    def rows(self) -> tuple[list[Row], list[str]]:
        """Return a row per run of the study as last started, and why records cannot be trusted.

        Runs without a trusted record have the status ``waiting``.

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

        stream = io.BytesIO()
        pq.write_table(_table(self.rows()[0]), stream)
        with self._writing(self.table):
            replace({self.table: stream.getvalue()})

    @property
    def _index(self) -> Path:
        return self.folder / "study.json"

    @property
    def _runs(self) -> Path:
        return self.folder / "runs"

    def _record(self, key: str) -> Path:
        return self._runs / f"{key}.json"

    def _files(self, key: str) -> Path:
        return self._runs / key

    def _write(self, path: Path, content: Mapping[str, Any]) -> None:
        text = sealed(content)
        with self._writing(path):
            replace({path: text.encode()})

    @contextmanager
    def _writing(self, path: Path) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            kept, reason = self._kept(), f"{path}: results cannot be written: {error.strerror or error}"
            raise ResultError(
                f"{reason}; the {kept} finished runs in {self.folder} are kept, and the same command "
                "resumes the study"
                if kept
                else reason
            ) from error

    def _kept(self) -> int:
        """Return the number of trusted records in the folder, of this study or another."""
        names = os.listdir(self._runs) if os.path.isdir(self._runs) else []  # noqa: PTH112, PTH208 - any text
        found, _ = self.records(name.removesuffix(".json") for name in names if _RECORDS.fullmatch(name))
        return len(found)

    def _owner(self) -> str:
        """Describe the process that started last, for messages."""
        try:
            about = unsealed(self._index)
            return f" (process {about['process']} on {about['machine']['host']}, since {about['started']})"
        except (ResultError, KeyError, TypeError):
            return ""  # its list of runs is missing or damaged


def read_table(folder: str | Path) -> list[Row]:
    """Return the rows of a study's table, finished or not, from the records in its folder.

    A :class:`ResultWarning` names the records that cannot be trusted; their runs are ``waiting``.

    Returns
    -------
    list of dict
        Columns in order: the axes, ``key``, figures determined by the key, ``time_...``,
        ``provenance_...``. An axis that shares its name with a figure is called ``vary.NAME``.

    Raises
    ------
    ResultError
        The folder holds no study.
    """
    rows, faults = Store(Path(folder)).rows()
    if faults:
        warnings.warn(f"{untrusted(faults)}; their runs are shown as waiting", ResultWarning, stacklevel=2)
    return rows


def read_run(folder: str | Path, run: str | Mapping[str, Any]) -> xr.Dataset:
    """Return the trajectories of one run of a study that keeps them.

    Parameters
    ----------
    run
        Its key, as in the column ``key`` of the table, or its points on the axes that tell it apart from
        the other runs: ``{"controller.horizon": 12, "timing": "paper"}``.

    Raises
    ------
    ResultError
        No run or several runs fit, or the trajectories are missing or damaged.
    """
    store = Store(Path(folder))
    runs = store.runs()
    found = dict.fromkeys(key for labels, key in runs if _fits(run, labels, key))
    if len(found) != 1:
        axes = listed(dict.fromkeys(name for labels, _ in runs for name in labels)) or "none"
        fits = f"{len(found)} runs fit" if found else "no run fits"
        raise ResultError(f"{folder}: {shown(run)}: {fits}; give a key or points on the axes: {axes}")
    record = store.read(next(iter(found)))
    if record is None:
        raise ResultError(f"{folder}: {shown(run)}: has not run yet")
    return store.trajectories(record)


def _fits(run: str | Mapping[str, Any], labels: Mapping[str, Any], key: str) -> bool:
    """Whether a key or points on some axes are those of a run; 1 is not True."""
    if isinstance(run, str):
        return run == key
    return all(
        name in labels and labels[name] == label and isinstance(labels[name], bool) == isinstance(label, bool)
        for name, label in run.items()
    )


def untrusted(faults: Sequence[str]) -> str:
    """Describe how many records cannot be trusted, and what is wrong with the first of them."""
    more = len(faults) - _MOST_NAMED
    named = "; ".join(faults[:_MOST_NAMED]) + (f"; and {more} more" if more > 0 else "")
    return f"{len(faults)} record{'s' * (len(faults) > 1)} cannot be trusted ({named})"


def _is_run(run: object) -> bool:
    """Whether an entry of the list of runs has labels and a key, which is the name of a file."""
    if not isinstance(run, dict) or not isinstance(run.get("labels"), dict):
        return False
    key = run.get("key")
    return isinstance(key, str) and _RECORDS.fullmatch(f"{key}.json") is not None


def _figures(key: str, record: Record | None) -> Row:
    """Return the values of a row, except the labels of its run."""
    figures = dict.fromkeys(_COLUMNS) | {"key": key, "status": "waiting"}
    return figures if record is None else {**figures, **record.result, **record.times, **record.provenance}


def _table(rows: Sequence[Row]) -> pa.Table:
    import pyarrow as pa

    return pa.table({name: _column([row[name] for row in rows]) for name in (rows[0] if rows else ())})


def _column(values: list[Any]) -> pa.Array:
    """Convert values of one type to a column; mixed types and integers beyond 64 bits become JSON."""
    import pyarrow as pa

    kinds = {float if type(value) is int else type(value) for value in values if value is not None}
    if len(kinds) <= 1:
        try:
            return pa.array(values, None if kinds else pa.string())
        except (OverflowError, pa.ArrowInvalid):  # an integer that the column cannot hold exactly
            pass
    return pa.array([None if value is None else json.dumps(value) for value in values], pa.string())
