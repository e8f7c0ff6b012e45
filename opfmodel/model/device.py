"""The base class of devices."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from opfmodel.model.stage import Stage
from opfmodel.network.arrays import Table
from opfmodel.network.component import Component

if TYPE_CHECKING:
    from opfmodel.model.model import Model

__all__ = ["Device"]


class Device:
    """A kind of component that takes part in the power balance or in the cost; one class per file.

    Subclasses are registered by an entry point in the group ``opfmodel.devices``. They are convex:
    bounded variables, affine rows, cones and convex costs. Devices of components without a bus are declared
    after all others, so that they can refer to the quantities of these.

    Attributes
    ----------
    component
        The component class that the device models.
    planned_only
        Whether it is a commitment of plans, such as a reserve, which no plant enforces: reality may call it
        up.
    waste
        Published quantities that a relaxation can make larger than they physically are, such as losses. Where
        energy has no cost, a plant prices them.
    """

    component: type[Component]
    planned_only: ClassVar[bool] = False
    waste: ClassVar[tuple[str, ...]] = ()

    def declare(self, model: Model, table: Table) -> None:
        """Declare variables, limits, injections and intertemporal coupling for all components of the kind."""
        raise NotImplementedError

    def cost(self, stage: Stage) -> Any:  # noqa: ARG002 - for subclasses
        """Return the operating cost in $/h, one value per stage, or None; for symbols and for numbers."""
        return None
