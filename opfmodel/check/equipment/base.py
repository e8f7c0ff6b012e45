"""What is checked of one kind of component."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, ClassVar

from opfmodel.check.trajectories import Array, Complex, Items
from opfmodel.network.component import Component

if TYPE_CHECKING:
    from opfmodel.check.checker import Checker

__all__ = ["Equipment"]


class Equipment:
    """Limits, power and cost of one kind of component, from its declaration; one class per file.

    Attributes
    ----------
    component
        The component class.
    checker
        The results, and where violations are recorded.
    items
        The components of the class that are in the results.
    """

    component: ClassVar[type[Component]]

    def __init__(self, checker: Checker) -> None:
        self.checker = checker
        self.items: Items = checker.reported(self.component)

    def check(self) -> None:
        """Record the violations of limits and of equations that couple the stages."""

    def power(self) -> Iterator[tuple[list[str], Complex]]:
        """Yield buses, and the complex power that is injected there, p.u., ``(buses, stages)``."""
        yield from ()

    def cost_rate(self) -> Array | float:
        """Return the operating cost in each stage, $/h."""
        return 0.0
