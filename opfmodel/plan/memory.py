"""Estimates of the memory that a problem, its time series and a run need, and their check."""

from __future__ import annotations

import os
from pathlib import Path

from opfmodel.errors import SizeError

__all__ = ["check_memory", "machine_bytes", "problem_bytes", "run_bytes", "series_bytes"]

MB, GB = 1_000_000, 1_000_000_000
# Measured on the 118-bus system with storage at every bus (589 components, 24 to 768 stages), compiled and
# solved by IPOPT: 2.0 MB per stage of AC, 1.0 MB of DC, 0.6 MB of copperplate. The
# lowest figure of each group is used, so a problem is refused only if it would certainly not fit.
_REACTIVE_BYTES = 3_300  # per component and stage, formulations with reactive power
_ACTIVE_BYTES = 1_000  # per component and stage, all others
_PARTS_BYTES = 250  # solved by windows: 0.16 MB per stage, in 8,760 stages of the 118-bus system
_SERIES_BYTES = 40  # per load and step: active and reactive demand, and temporary arrays of a rule
_STEP_BYTES, _STEP_COMPONENT_BYTES = 6_000, 30  # per step of a run, and per step and component
_UNKNOWN_MACHINE = 32 * GB  # if the system does not report it
_LIMITS_OF_CONTAINERS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def problem_bytes(components: int, stages: int, reactive: bool, in_parts: bool = False) -> int:
    """Estimate the memory needed to compile and solve a multi-stage problem.

    Parameters
    ----------
    components
        Number of components of all kinds.
    reactive
        Whether the formulation has reactive power.
    in_parts
        Whether the solver never holds the whole problem; see :func:`solvers.in_parts`.
    """
    each = _PARTS_BYTES if in_parts else _REACTIVE_BYTES if reactive else _ACTIVE_BYTES
    return components * stages * each


def series_bytes(loads: int, values: int) -> int:
    """Estimate the memory needed to generate the demand series of loads."""
    return loads * values * _SERIES_BYTES


def run_bytes(components: int, steps: int) -> int:
    """Estimate the memory needed to record the steps of a closed loop."""
    return steps * (_STEP_BYTES + components * _STEP_COMPONENT_BYTES)


def check_memory(what: str, needed: int) -> None:
    """Raise :class:`SizeError` if the machine has less memory than needed.

    Parameters
    ----------
    what
        Start of the message, which names the request: ``"horizon = 1,000,000"``.
    needed
        The estimate, bytes.
    """
    if needed <= 100 * MB:
        return
    available = machine_bytes()
    if needed > available:
        raise SizeError(
            f"{what}: needs about {_gigabytes(needed)} of memory; this machine has {_gigabytes(available)}"
        )


def machine_bytes() -> int:
    """Return the memory of the machine, or the part that the container or the shell allows."""
    known = [_physical(), *map(_limit_in, _LIMITS_OF_CONTAINERS), _limit_of_process()]
    return min((size for size in known if size is not None), default=_UNKNOWN_MACHINE)


def _gigabytes(size: int) -> str:
    return f"{max(size // GB, 1):,} GB"


def _physical() -> int | None:
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # Windows
        return None


def _limit_in(file: str) -> int | None:
    try:
        return int(Path(file).read_text(encoding="ascii"))
    except (OSError, ValueError):  # no such file, or no limit ("max")
        return None


def _limit_of_process() -> int | None:
    try:
        import resource
    except ImportError:  # Windows
        return None
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if limit == resource.RLIM_INFINITY else limit
