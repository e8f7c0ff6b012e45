"""The errors that this package raises on purpose."""

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
    """A program is ill-formed: a wrong shape, an unknown block, a bound that crosses another."""


class UnsupportedProgramError(SolverError):
    """A back end was asked to solve a program that it cannot represent."""


class UnknownSolverError(SolverError):
    """No back end of that name, or its library is not installed."""


class SolverOptionError(SolverError):
    """A back end refused one of the options it was given."""
