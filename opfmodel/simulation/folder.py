"""The folder of a run: what may be written there, and what in it can be continued."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from opfmodel.errors import ResultError, listed
from opfmodel.results.store import read_summary
from opfmodel.simulation.checkpoint import Checkpoint
from opfmodel.simulation.inputs import changed

__all__ = ["CHECKPOINT", "prepare"]

CHECKPOINT = "checkpoint"
"""Name of the folder of checkpoints in that of a run."""


def prepare(
    folder: Path, inputs: Mapping[str, str], resume: bool = False, force: bool = False
) -> dict[str, Any] | None:
    """See that a run may be written to a folder.

    Parameters
    ----------
    inputs
        Digests of the inputs of the run, see :func:`opfmodel.simulation.inputs`.
    resume
        Whether to continue the run in the folder.
    force
        Whether to start again whatever the folder holds.

    Returns
    -------
    dict or None
        The summary of the run in the folder if that is to be continued and has ended.

    Raises
    ------
    ResultError
        The folder holds what would be lost: results of other inputs, which the message
        names, or a run that can be continued.
    """
    checkpoint = Checkpoint(folder / CHECKPOINT)
    if force:
        checkpoint.remove()
        return None
    try:
        held = checkpoint.inputs() if checkpoint.exists else None
        summary = read_summary(folder) if held is None else None
    except ResultError as error:
        raise ResultError(f"{error}; --force starts again") from error
    known = held if summary is None else summary.get("inputs")
    if known is None and summary is None:
        return None
    differing = ["inputs that are not recorded"]
    if isinstance(known, Mapping):
        differing = changed(known, inputs)
    if differing:
        raise ResultError(
            f"{folder}: holds results of other inputs, which differ in {listed(differing)}; choose another "
            "folder with --out, or replace them with --force"
        )
    if held is not None and not resume:
        raise ResultError(
            f"{folder}: holds a run that has not ended; continue it with --resume, or start again with "
            "--force"
        )
    interrupted = summary is not None and str(summary.get("termination")).startswith("interrupted")
    return summary if resume and not interrupted else None
