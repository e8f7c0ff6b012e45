"""Checkpoints of closed loops: a folder from which a run that was killed resumes.

==================  ===============================================================================
``state.npz``       digests of the inputs, the number of steps done, what the next step depends on,
                    and the list of the other files with their checksums
``steps-N.npz``     outcome and record of some steps from step N on; written once
``lock``            held by the process that writes; the operating system releases it
==================  ===============================================================================

Every checkpoint writes one more file of steps and then replaces the state, so that the folder is complete at
any moment, and the effort does not grow with the length of the run. The files hold plain numbers and texts;
see :mod:`opfmodel.data.archive`.
"""

from __future__ import annotations

import hashlib
import re
import time as clock
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from opfmodel.data.archive import packed, unpacked
from opfmodel.data.writing import remove_temporaries, replace
from opfmodel.errors import ResultError, ResultWarning, listed, shown
from opfmodel.network.bounds import integer, number_within
from opfmodel.plan import Initial
from opfmodel.plan.recall import Memory
from opfmodel.simulation.controller import Controller
from opfmodel.simulation.inputs import changed
from opfmodel.simulation.plants.base import Plant, Step
from opfmodel.simulation.run import Run
from solvers.interrupt import deferred

if TYPE_CHECKING:
    from filelock import BaseFileLock

__all__ = ["Checkpoint", "Keeper", "Saved"]

_SCHEMA = 1  # increase it to refuse older files
_STATE, _LOCK = "state.npz", "lock"
_FILES = re.compile(r"state\.npz|steps-[0-9]+\.npz")
_SECONDS = 30.0
_CLOSE = 1e-6  # relative and in physical units: initial states that a solver found on another machine


class Saved(NamedTuple):
    """What a checkpoint holds.

    Attributes
    ----------
    inputs
        Digests of the inputs, see :func:`opfmodel.simulation.inputs`.
    initial
        State at the first step.
    steps, plans
        Outcome of the steps that were done, and the records of their plans.
    state
        State at the next step.
    controller, plant
        What they remember.
    files
        First step, number of steps and checksum of each file of steps.
    """

    inputs: dict[str, Any]
    initial: Initial | None
    steps: list[Step]
    plans: list[dict[str, Any]]
    state: Initial | None
    controller: Memory
    plant: Memory
    files: list[tuple[int, int, str]]


@dataclass(frozen=True)
class Checkpoint:
    """Where a closed loop keeps what it needs to resume, and how often it writes it.

    Parameters
    ----------
    folder
        Folder of the files; created if necessary.
    steps
        Write after so many steps.
    seconds
        Write after a step that ends more than so many seconds after the last writing; 30 by default, if there
        is no number of steps. Both may be given.
    """

    folder: str | Path
    steps: int | None = None
    seconds: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.folder, str | Path):
            raise ResultError(f"checkpoint = {shown(self.folder)}: must be a folder or a Checkpoint")
        if self.steps is not None:
            integer("checkpoint: steps", self.steps, at_least=1)
        if self.seconds is not None:
            number_within("checkpoint: seconds", self.seconds, at_least=0)

    @property
    def path(self) -> Path:
        """The folder."""
        return Path(self.folder)

    @property
    def state(self) -> Path:
        """The file that is replaced at every writing."""
        return self.path / _STATE

    @property
    def exists(self) -> bool:
        """Whether there is a checkpoint in the folder."""
        return self.state.exists()

    def inputs(self) -> dict[str, Any]:
        """Return the digests of the inputs of the run in the folder.

        Raises
        ------
        ResultError
            There is none, or it is damaged.
        """
        return dict(self._head()["inputs"])

    def load(self) -> Saved | None:
        """Return what the folder holds; None if nothing.

        Raises
        ------
        ResultError
            A file is damaged, missing or of another version.
        """
        if not self.exists:
            return None
        head = self._head()
        try:
            files = [(int(first), int(many), str(checksum)) for first, many, checksum in head["files"]]
            parts = [_steps(self._part(*each)) for each in files]
            return Saved(
                inputs=dict(head["inputs"]),
                initial=head["initial"],
                steps=[step for steps, _ in parts for step in steps],
                plans=[plan for _, plans in parts for plan in plans],
                state=head["state"],
                controller=head["controller"],
                plant=head["plant"],
                files=files,
            )
        except (LookupError, TypeError, ValueError, AttributeError) as error:
            raise ResultError(f"{self.state}: not a checkpoint of opfmodel: {error!r}") from error

    def locked(self) -> BaseFileLock:
        """Create the folder and lock it for this process, until the lock is released or the process ends.

        Raises
        ------
        ResultError
            The folder cannot be created, or another process holds the lock.
        """
        from filelock import FileLock, Timeout

        lock = FileLock(self.path / _LOCK, timeout=0)
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            lock.acquire()
        except Timeout:
            raise ResultError(f"{self.path}: a run in another process writes to this checkpoint") from None
        except OSError as error:
            raise _unwritable(self, error) from error
        return lock

    def clear(self) -> None:
        """Delete the files of the checkpoint.

        Raises
        ------
        ResultError
            They cannot be deleted.
        """
        try:
            self.state.unlink(missing_ok=True)  # first: without it the others mean nothing
            if self.path.is_dir():
                remove_temporaries(self.path, _FILES)
                for path in list(self.path.iterdir()):
                    if _FILES.fullmatch(path.name):
                        path.unlink()
        except OSError as error:
            raise ResultError(f"{self.path}: cannot be deleted: {error.strerror or error}") from error

    def remove(self) -> None:
        """Delete the files of the checkpoint, and the folder if nothing else is in it.

        Raises
        ------
        ResultError
            They cannot be deleted, or another process writes them.
        """
        if self.path.is_dir():
            lock = self.locked()
            try:
                self.clear()
                with suppress(OSError):  # other files are not ours; the lock is while it is held
                    (self.path / _LOCK).unlink(missing_ok=True)
                    self.path.rmdir()
            finally:
                lock.release()

    def _head(self) -> dict[str, Any]:
        head = unpacked(self.state, "a checkpoint")
        if head.get("schema") != _SCHEMA:
            raise ResultError(f"{self.state}: not a checkpoint of schema version {_SCHEMA}")
        if not isinstance(head.get("inputs"), dict):
            raise ResultError(f"{self.state}: not a checkpoint of opfmodel: it has no inputs")
        return head

    def _part(self, first: int, many: int, checksum: str) -> dict[str, Any]:
        """Return the content of a file of steps, which must be the one that the state lists."""
        path = _part(self.path, first)
        content = unpacked(path, "a part of a checkpoint")
        if hashlib.sha256(path.read_bytes()).hexdigest() != checksum or len(content["plans"]) != many:
            raise ResultError(f"{path}: does not belong to {self.state}")
        return content


class Keeper:
    """Writes the checkpoints of a run.

    Parameters
    ----------
    checkpoint
        Where and how often.
    inputs
        Digests of the inputs of the run.

    Raises
    ------
    ResultError
        The folder cannot be created, another process writes there, or it holds a checkpoint that is damaged
        or of other inputs.
    """

    def __init__(self, checkpoint: Checkpoint, inputs: Mapping[str, str], initial: Initial | None) -> None:
        self.checkpoint, self.inputs, self.initial = checkpoint, dict(inputs), initial
        self._lock = checkpoint.locked()
        self._files: list[tuple[int, int, str]] = []
        self._now: dict[str, Any] = {}
        self._done = self._written = 0
        self._since = clock.perf_counter()
        self._failed = False
        try:
            self.saved = checkpoint.load()
            if self.saved is not None:
                self._check(self.saved)
        except BaseException:
            self._lock.release()
            raise
        if self.saved is not None:
            self.initial, self._files = self.saved.initial, self.saved.files
            self._done = self._written = len(self.saved.steps)

    def _check(self, saved: Saved) -> None:
        """Raise :class:`ResultError` unless a checkpoint is of the same inputs."""
        differing = changed(saved.inputs, self.inputs)
        if not _same_state(saved.initial, self.initial):
            differing.append("initial")
        if differing:
            raise ResultError(
                f"{self.checkpoint.path}: the checkpoint is of other inputs, which differ in "
                f"{listed(differing)}; restore them, or delete the checkpoint to start again"
            )

    def begin(self, run: Run, controller: Controller, plant: Plant) -> tuple[int, Initial | None]:
        """Put back what the checkpoint holds, or write the first one; return the next step and its state.

        Raises
        ------
        ResultError
            The folder cannot be written.
        """
        saved = self.saved
        if saved is None:
            self.checkpoint.clear()
            self._now = {"state": self.initial, "controller": controller.memory(), "plant": plant.memory()}
            try:
                self._replace(run)
            except OSError as error:
                self._lock.release()
                self.checkpoint.remove()
                raise _unwritable(self.checkpoint, error) from error
            return 0, self.initial
        run.steps[:], run.plans[:] = saved.steps, saved.plans
        controller.recall(saved.controller)
        plant.recall(saved.plant)
        self._now = {"state": saved.state, "controller": saved.controller, "plant": saved.plant}
        self.saved = None
        return len(saved.steps), saved.state

    def step(self, run: Run, state: Initial, controller: Controller, plant: Plant) -> None:
        """Note a step that is complete, and write a checkpoint if one is due."""
        now = {"state": state, "controller": controller.memory(), "plant": plant.memory()}
        self._now, self._done = now, len(run.steps)
        often = self.checkpoint
        seconds = _SECONDS if often.steps is None and often.seconds is None else often.seconds
        many, long = self._done - self._written, clock.perf_counter() - self._since
        if (often.steps is not None and many >= often.steps) or (seconds is not None and long >= seconds):
            self.write(run)

    def write(self, run: Run) -> None:
        """Write a checkpoint of the last complete step; a full disk only makes a warning.

        Signals that ask the process to end are handled afterwards.
        """
        if self._done == self._written and not self._failed:
            return
        with deferred():
            self._since = clock.perf_counter()
            try:
                self._replace(run)
                self._failed = False
            except OSError as error:
                if not self._failed:
                    text = f"{_unwritable(self.checkpoint, error)}; it holds the first {self._written} steps"
                    warnings.warn(f"{text}, and the run goes on", ResultWarning, stacklevel=3)
                self._failed = True

    def end(self, run: Run) -> None:
        """Write what is not written yet, and let other processes continue the run.

        Signals that ask the process to end are ignored meanwhile: the run ends anyway.
        """
        try:
            with suppress(KeyboardInterrupt):
                self.write(run)
        finally:
            self._lock.release()

    def _replace(self, run: Run) -> None:
        first, last = self._written, self._done
        contents, files = {}, list(self._files)
        if last > first:
            part = packed(_parted(run.steps[first:last], run.plans[first:last]))
            contents[_part(self.checkpoint.path, first)] = part
            files.append((first, last - first, hashlib.sha256(part).hexdigest()))
        head = {"schema": _SCHEMA, "inputs": self.inputs, "initial": _plain(self.initial), "files": files}
        contents[self.checkpoint.state] = packed({**head, **self._now, "state": _plain(self._now["state"])})
        replace(contents)  # in this order
        self._files, self._written = files, last


def _part(folder: Path, first: int) -> Path:
    return folder / f"steps-{first}.npz"


def _unwritable(checkpoint: Checkpoint, error: OSError) -> ResultError:
    return ResultError(f"{checkpoint.path}: the checkpoint cannot be written: {error.strerror or error}")


def _plain(state: Initial | None) -> dict[str, Any] | None:
    """Return a state as plain data."""
    if state is None:
        return None
    return {name: None if v is None else np.asarray(v, dtype=float) for name, v in state.items()}


def _same_state(one: Initial | None, other: Initial | None) -> bool:
    one, other = _plain(one) or {}, _plain(other) or {}
    return one.keys() == other.keys() and all(
        (values is None and other[name] is None)
        or (values is not None and other[name] is not None and _close(values, other[name]))
        for name, values in one.items()
    )


def _close(one: Any, other: Any) -> bool:
    return one.shape == other.shape and np.allclose(one, other, rtol=_CLOSE, atol=_CLOSE, equal_nan=True)


def _parted(steps: Sequence[Step], plans: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return steps and the records of their plans as plain data; what describes them is stored once."""
    texts: list[dict[str, Any]] = []
    made = []
    for step in steps:
        if step.described not in texts:
            texts.append(dict(step.described))
        made.append(
            {
                "values": [[kind, name, values] for (kind, name), values in step.values.items()],
                "state": _plain(step.state),
                "described": texts.index(dict(step.described)),
                "formulation": step.formulation,
                "status": step.status,
                "solved": step.solved,
            }
        )
    return {"described": texts, "steps": made, "plans": list(plans)}


def _steps(content: Mapping[str, Any]) -> tuple[list[Step], list[dict[str, Any]]]:
    """Return what :func:`_parted` took."""
    texts = [{name: (unit, text) for name, (unit, text) in each.items()} for each in content["described"]]
    made = [
        Step(
            values={(kind, name): values for kind, name, values in each["values"]},
            state=each["state"],
            described=texts[each["described"]],
            formulation=each["formulation"],
            status=each["status"],
            solved=each["solved"],
        )
        for each in content["steps"]
    ]
    return made, list(content["plans"])
