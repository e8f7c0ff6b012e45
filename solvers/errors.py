"""Exceptions raised by this package."""

from __future__ import annotations

__all__ = [
    "ProgramError",
    "SolverError",
    "SolverOptionError",
    "UnknownSolverError",
    "UnsupportedProgramError",
]


class SolverError(Exception):
    """Base class of every error raised by :mod:`solvers`."""


class ProgramError(SolverError):
    """A program is ill-formed: a wrong shape, an unknown block, crossed bounds."""


class UnsupportedProgramError(SolverError):
    """A back end cannot represent the program."""


class UnknownSolverError(SolverError):
    """No back end or installed solver has the given name."""


class SolverOptionError(SolverError):
    """A solver rejected one of its options."""
