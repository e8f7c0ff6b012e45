"""Versions of the packages on which results depend."""

from __future__ import annotations

from functools import cache
from importlib.metadata import PackageNotFoundError, version

from opfmodel.plugins.registry import GROUPS, plugins

__all__ = ["versions"]

# Besides those of plugins; a new version of any of them is another input of a run.
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
    origins = {plugin.origin for sort in GROUPS for plugin in plugins(sort).values()}
    found = {}
    for package in sorted({*_PACKAGES, *origins}):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue  # optional, or a plugin outside any distribution
    return found
