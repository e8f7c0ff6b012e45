"""How much memory a problem, its time series and a run need, and whether the machine has it."""

from __future__ import annotations

import os
from pathlib import Path

from opfmodel.errors import SizeError

__all__ = ["check_memory", "machine_bytes", "problem_bytes", "run_bytes", "series_bytes"]

MB, GB = 1_000_000, 1_000_000_000
# Measured on the 118-bus system with storage at every bus (589 components, 24 to 768 stages), compiled and
# solved by IPOPT: 2.3 MB per stage of AC, 2.8 MB of SOC, 1.0 to 1.9 MB of DC, 0.6 MB of copperplate. Of each
# sort the least counts, so that what is refused would not have fitted.
_REACTIVE_BYTES = 4_000  # per component and stage, where formulations have reactive power
_ACTIVE_BYTES = 1_000  # of the others
_SERIES_BYTES = 40  # per load and step: active and reactive demand, and what a rule draws on the way
_STEP_BYTES, _STEP_COMPONENT_BYTES = 6_000, 30  # per step of a run, and per step and component
_UNKNOWN_MACHINE = 32 * GB  # where the system does not tell
_LIMITS_OF_CONTAINERS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def problem_bytes(components: int, stages: int, reactive: bool) -> int:
    """Memory of a multi-stage problem that is solved.

    Parameters
    ----------
    components
        Number of components of all kinds.
    reactive
        Whether the formulation has reactive power.
    """
    return components * stages * (_REACTIVE_BYTES if reactive else _ACTIVE_BYTES)


def series_bytes(loads: int, values: int) -> int:
    """Memory of the demand of loads while rules make it."""
    return loads * values * _SERIES_BYTES


def run_bytes(components: int, steps: int) -> int:
    """Memory of what a closed loop keeps of its steps."""
    return steps * (_STEP_BYTES + components * _STEP_COMPONENT_BYTES)


def check_memory(what: str, needed: int) -> None:
    """Raise :class:`SizeError` if the machine has less memory than is needed.

    Parameters
    ----------
    what
        What is asked for, as the message begins: ``"horizon = 1,000,000"``.
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
    """Memory of the machine, or of it what the container or the shell allows."""
    known = [_physical(), *map(_limit_in, _LIMITS_OF_CONTAINERS), _limit_of_process()]
    return min((size for size in known if size is not None), default=_UNKNOWN_MACHINE)


def _gigabytes(size: int) -> str:
    return f"{max(size // GB, 1):,} GB"


def _physical() -> int | None:
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # Windows has none of it
        return None


def _limit_in(file: str) -> int | None:
    try:
        return int(Path(file).read_text(encoding="ascii"))
    except (OSError, ValueError):  # there is no such file, or no limit: "max"
        return None


def _limit_of_process() -> int | None:
    try:
        import resource
    except ImportError:  # Windows
        return None
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if limit == resource.RLIM_INFINITY else limit
