"""Provenance of results: machine, and state of the repository."""

from __future__ import annotations

import os
import platform
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

__all__ = ["machine", "revision"]


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
