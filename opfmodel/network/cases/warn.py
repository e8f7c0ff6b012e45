"""Warnings about network files."""

from __future__ import annotations

import warnings

from opfmodel.errors import CaseWarning, visible

__all__ = ["warn"]


def warn(message: str) -> None:
    """Issue a :class:`CaseWarning`."""
    warnings.warn(visible(message), CaseWarning, stacklevel=3)
