"""Provenance of results: versions, machine, and state of the repository."""

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

# Packages that affect results; a new version of any of them changes the key of a run.
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
    """Return the versions of installed packages that affect results, including those of plugins."""
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
    """Describe the machine on which this process runs."""
    return {
        "host": platform.node(),
        "system": platform.platform(),
        "processor": platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
    }


def revision(folder: Path) -> str | None:
    """Return the git revision of a folder, with ``+`` if files were changed; None outside a repository.

    Git does not run the file-system monitor that a repository may configure, and does not lock the
    repository, in which its owner may be working.
    """
    try:
        commit = _git(folder, "rev-parse", "HEAD")
        changed = _git(folder, "status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.SubprocessError):
        return None  # no git, no repository, or no commit
    return commit + ("+" if changed else "")


def _git(folder: Path, *arguments: str) -> str:
    git = ["git", "--no-optional-locks", "-c", "core.fsmonitor=false", "-C", str(folder)]
    done = subprocess.run([*git, *arguments], capture_output=True, check=True, timeout=60)
    return done.stdout.decode("utf-8", "backslashreplace").strip()
