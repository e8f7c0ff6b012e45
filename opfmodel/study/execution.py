"""One run of a study: from a specification to a record."""

from __future__ import annotations

import json
import os
import threading
import time
import traceback
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from opfmodel.errors import CaseWarning, OpfmodelError, ProfileWarning, StudyError
from opfmodel.plugins.versions import versions
from opfmodel.results.store import Files, packed
from opfmodel.study.provenance import machine
from opfmodel.study.specification import Specification
from solvers import Sharing, SolverError

if TYPE_CHECKING:
    from opfmodel.scenario.results import Results

__all__ = ["Record", "execute", "failure", "release"]

_ONE_AT_A_TIME = threading.Lock()  # CasADi is not thread-safe
_SHARING = Sharing()  # among the runs of this process


@dataclass(frozen=True)
class Record:
    """The record of one run.

    Attributes
    ----------
    key
        Key of the specification.
    result
        Flat figures, determined by the key: ``status``, ``termination``, ``error``, ``cost``, ...
    times
        Durations in seconds; names begin with ``time_``.
    provenance
        Where, when and with what the run was made; names begin with ``provenance_``.
    files
        Files of the run by name, see :func:`opfmodel.results.store.packed`; empty unless it keeps
        trajectories, and when a record is read.
    """

    key: str
    result: Mapping[str, Any]
    times: Mapping[str, float]
    provenance: Mapping[str, Any]
    files: Files = field(default_factory=dict, repr=False)

    @property
    def failed(self) -> bool:
        """Whether the closed loop did not complete."""
        return bool(self.result["status"] != "done")


def execute(specification: Specification) -> Record:
    """Run the closed loop of a specification on a copy of its files.

    Returns
    -------
    Record
        If the run fails for any reason, its ``result`` has an ``error``.

    Raises
    ------
    KeyboardInterrupt
        The user pressed Ctrl-C; an unfinished run leaves no record.
    """
    began = time.perf_counter()
    with _ONE_AT_A_TIME, _SHARING.active(starts=specification.starts_warm):
        before = _SHARING.assembled, _SHARING.shared
        try:
            figures, files = _figures(specification)
        except (Exception, SystemExit) as error:  # plugins may raise anything; the study continues
            return failure(specification, error, time.perf_counter() - began)
    counted = {
        "provenance_programs_assembled": _SHARING.assembled - before[0],
        "provenance_programs_shared": _SHARING.shared - before[1],
    }
    times = {f"time_{name}": value for name, value in figures.items() if "seconds" in name}
    result = {name: value for name, value in figures.items() if "seconds" not in name}
    return Record(
        specification.key,
        result,
        {**times, "time_total_seconds": time.perf_counter() - began},
        _provenance(specification) | counted,
        files,
    )


def release() -> None:
    """Forget the functions that the runs of this process share."""
    _SHARING.clear()


def failure(specification: Specification, error: BaseException, seconds: float | None = None) -> Record:
    """Return the record of a run that ended with an exception."""
    owned = isinstance(error, OpfmodelError | SolverError)
    message = str(error) if owned else f"{type(error).__name__}: {error}"
    message = message.encode("utf-8", "backslashreplace").decode()  # file names may contain any bytes
    detail = {} if owned else {"provenance_traceback": "".join(traceback.format_exception(error))}
    return Record(
        specification.key,
        {"status": "error", "termination": "an exception", "error": message},
        {} if seconds is None else {"time_total_seconds": seconds},
        {**_provenance(specification), **detail},
    )


def _figures(specification: Specification) -> tuple[dict[str, Any], Files]:
    """Return the figures of a run, and its files if the study keeps them."""
    from opfmodel.scenario import load_scenario
    from opfmodel.scenario.results import results_of

    _same_versions(specification)
    inputs = specification.inputs
    with inputs.unpacked() as (copy, path), warnings.catch_warnings():
        for category in (CaseWarning, ProfileWarning):  # already reported when the study was read
            warnings.simplefilter("ignore", category)
        try:
            scenario = load_scenario(path, specification.variant, specification.overrides)
            run = scenario.simulate()
        except OpfmodelError as error:
            # name the original files: the result must not depend on the location of the copy
            raise OpfmodelError(str(error).replace(str(copy), str(inputs.root))) from error
    if run.interrupted:
        raise KeyboardInterrupt
    results = results_of(scenario, run)
    figures = _flat(run.summary())
    counted = [plan["iterations"] for plan in run.plans if plan["iterations"] is not None]
    figures["iterations"] = sum(counted) if counted else None
    figures["error"] = None if run.status == "done" else f"{run.status}: {run.termination}"
    if results.report is not None:
        figures["max_violation"] = results.report.max_violation
        figures["unchecked"] = ", ".join(results.report.unchecked) or None
    return figures, _files(results) if specification.keeps_trajectories else {}


def _files(results: Results) -> Files:
    import dask

    # on a worker, xarray would lock the file across the cluster, which fails for a file in memory
    with dask.config.set(scheduler="synchronous"):
        return packed(results.data, results.summary)[0]


def _same_versions(specification: Specification) -> None:
    """Raise an error if the installed versions differ from those in the key."""
    here = versions()
    for package, wanted in specification.versions.items():
        if here.get(package) != wanted:
            found = here.get(package, "none")
            raise StudyError(
                f"the worker on {machine()['host']} has {package} {found}; the study requires {wanted}"
            )


def _flat(figures: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Flatten mappings to dotted names, NumPy values to Python values, and other nested data to JSON."""
    flat: dict[str, Any] = {}
    for name, value in figures.items():
        plain = value.tolist() if isinstance(value, np.generic | np.ndarray) else value
        if (
            isinstance(plain, Mapping)
            and plain
            and not any(isinstance(v, Mapping | list) for v in plain.values())
        ):
            flat |= _flat(plain, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = (json.dumps(plain) if plain else None) if _is_nested(plain) else plain
    return flat


def _is_nested(value: Any) -> bool:
    return isinstance(value, Mapping | list | tuple)


def _provenance(specification: Specification) -> dict[str, Any]:
    return {
        "provenance_finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "provenance_process": os.getpid(),
        **{f"provenance_{name}": value for name, value in machine().items()},
        "provenance_versions": json.dumps(specification.versions),
    }
