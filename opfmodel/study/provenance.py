"""What a result was made with: versions, machine, state of the repository."""

from __future__ import annotations

import os
import platform
import subprocess
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from opfmodel import plugins

__all__ = ["machine", "revision", "versions"]

# What computes numbers; a new version of any of them makes a new result.
_PACKAGES = (
    "opfmodel",
    "casadi",
    "clarabel",
    "cvxpy",
    "highspy",
    "numpy",
    "osqp",
    "piqp",
    "powerio",
    "qpsolvers",
    "scipy",
    "scs",
)


@cache
def versions() -> dict[str, str]:
    """Versions of the installed packages that a result depends on, those of plugins included."""
    origins = {plugin.origin for sort in plugins.GROUPS for plugin in plugins.plugins(sort).values()}
    found = {}
    for package in sorted({*_PACKAGES, *origins}):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue  # optional, or a plugin outside any distribution
    return found


@cache
def machine() -> dict[str, Any]:
    """The machine of this process."""
    return {
        "host": platform.node(),
        "system": platform.platform(),
        "processor": platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
    }


def revision(folder: Path) -> str | None:
    """Git revision of a folder, with ``+`` if files there were changed; None outside a repository.

    Git is told not to run the program that a repository may name to watch its files, nor to lock the
    repository, in which its owner may be at work.
    """
    try:
        commit = _git(folder, "rev-parse", "HEAD")
        changed = _git(folder, "status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.SubprocessError):
        return None  # no git, no repository, or no commit in it
    return commit + ("+" if changed else "")


def _git(folder: Path, *arguments: str) -> str:
    git = ["git", "--no-optional-locks", "-c", "core.fsmonitor=false", "-C", str(folder)]
    done = subprocess.run([*git, *arguments], capture_output=True, check=True, timeout=60)
    return done.stdout.decode("utf-8", "backslashreplace").strip()
