"""What a check of the theory finds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

__all__ = ["Finding", "Verdict"]


class Verdict(StrEnum):
    """What the numbers say about a statement."""

    HOLDS = "holds"
    VIOLATED = "violated"
    UNDECIDED = "undecided"


@dataclass(frozen=True, repr=False)
class Finding:
    """The result of one check.

    Attributes
    ----------
    statement
        The statement that is tested, and where it stands in Faulwasser and Engelmann (2019).
    explanation
        What the verdict rests on.
    tolerance
        Tolerance of the comparison on which the verdict rests, in the unit of what is compared.
    figures
        The numbers, by name.
    """

    verdict: Verdict
    statement: str
    explanation: str
    tolerance: float
    figures: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"Finding({self.verdict.value}: {self.explanation})"

    def as_dict(self) -> dict[str, Any]:
        """Return the finding as plain values."""
        return {
            "verdict": self.verdict.value,
            "statement": self.statement,
            "explanation": self.explanation,
            "tolerance": self.tolerance,
            **self.figures,
        }
