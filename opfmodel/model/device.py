"""The base class of devices."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt

from opfmodel.model.stage import NumericStage, Stage
from opfmodel.network.arrays import Table
from opfmodel.network.component import Component

if TYPE_CHECKING:
    from opfmodel.model.model import Model

__all__ = ["Device"]

Array = npt.NDArray[np.float64]


class Device:
    """A kind of component that takes part in the power balance or in the cost; one class per file.

    Subclasses are registered by an entry point in the group ``opfmodel.devices``. They are convex:
    bounded variables, affine rows, cones and convex costs. Devices of components without a bus are declared
    after all others, so that they can refer to the quantities of these.

    Attributes
    ----------
    component
        The component class that the device models.
    physical
        Whether it is a part of the grid. Plants model no others, such as limits over time on what is used and
        reserves that a plan keeps: what happens to these follows, by :meth:`follow`, or stays as planned.
    waste
        Published quantities that a relaxation can make larger than they physically are, such as losses. Where
        energy has no cost, a plant prices them.
    """

    component: type[Component]
    physical: ClassVar[bool] = True
    waste: ClassVar[tuple[str, ...]] = ()

    def declare(self, model: Model, table: Table) -> None:
        """Declare variables, limits, injections and intertemporal coupling for all components of the kind."""
        raise NotImplementedError

    def cost(self, stage: Stage) -> Any:  # noqa: ARG002 - for subclasses
        """Return the operating cost in $/h, one value per stage, or None; for symbols and for numbers."""
        return None

    def follow(self, stage: NumericStage) -> Mapping[str, Array]:  # noqa: ARG002 - for subclasses
        """Return the quantities of the device that follow from what was decided, by name, per unit.

        A program may state them as bounds, which need not be tight; plans report these values. In a plant the
        stage has what happened: the quantities of other devices, and the stocks of this one at the start, but
        no decisions of this one, for which values are returned as well.
        """
        return {}
