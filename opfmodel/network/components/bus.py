"""Buses."""

from __future__ import annotations

from typing import ClassVar

from opfmodel.network.component import Component, component
from opfmodel.network.fields import flag, in_service, number, span

__all__ = ["Bus"]


@component
class Bus(Component):
    """A node of the grid."""

    kind: ClassVar[str] = "bus"
    plural: ClassVar[str] = "buses"

    vm: tuple[float, float] = span(
        "p.u.", (0.9, 1.1), at_least=0.0, description="(min, max) of the voltage magnitude."
    )
    base_kv: float | None = number(
        "kV",
        None,
        above=0.0,
        optional=True,
        series=False,
        description="Nominal voltage; only used in network files.",
    )
    reference: bool = flag(False, "Whether this is the reference bus of its island, with angle zero.")
    va_set: float = number(
        "deg", 0.0, series=False, description="Angle of the reference bus in a power flow."
    )
    x: float | None = number(
        "", None, optional=True, series=False, description="Place on a map or a diagram, to the right."
    )
    y: float | None = number("", None, optional=True, series=False, description="Place, upwards.")
    in_service: bool = in_service()
