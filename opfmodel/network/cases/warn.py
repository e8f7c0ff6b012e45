"""What the user of a network file should know."""

from __future__ import annotations

import warnings

from opfmodel.errors import CaseWarning, visible

__all__ = ["warn"]


def warn(message: str) -> None:
    """Warn of something remarkable in a file."""
    warnings.warn(visible(message), CaseWarning, stacklevel=3)
