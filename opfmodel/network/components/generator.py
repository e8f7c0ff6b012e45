"""Generators."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from opfmodel.errors import ComponentError
from opfmodel.network.component import Component, component
from opfmodel.network.components.capability import capability, check_capability
from opfmodel.network.costs import Cost, Polynomial
from opfmodel.network.fields import INF, at_bus, cost_of, flag, in_service, number, span

__all__ = ["Generator"]


@component
class Generator(Component):
    """A generating unit at a bus."""

    kind: ClassVar[str] = "generator"
    plural: ClassVar[str] = "generators"
    lost: ClassVar[Mapping[str, float]] = {"p_min": 0, "p_max": 0, "q_min": 0, "q_max": 0, "ramp": INF}
    governs: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "on": ("status", "p_min", "p_max", "q_min", "q_max", "ramp", "c0", "segment_offset", "starts")
    }

    bus: str = at_bus()
    p: tuple[float, float] = span("MW", averaged=True, description="(min, max) of active power.")
    q: tuple[float, float] = span("MVAr", (-INF, INF), description="(min, max) of reactive power.")
    ramp: float | None = number(
        "MW/h",
        None,
        at_least=0.0,
        optional=True,
        finite=False,
        description="Maximum change of active power; none for no limit.",
    )
    on: float = number(
        "",
        1.0,
        at_least=0.0,
        at_most=1.0,
        description="1 while it runs and 0 while it is shut down, usually a series; multiplies its limits.",
    )
    start_cost: float = number("$", 0.0, at_least=0.0, series=False, description="Cost of each start.")
    min_up: float = number(
        "h", 0.0, at_least=0.0, series=False, description="Minimum time for which it runs, in a commitment."
    )
    min_down: float = number(
        "h", 0.0, at_least=0.0, series=False, description="Minimum time between runs, in a commitment."
    )
    hours_on: float | None = number(
        "h",
        None,
        optional=True,
        series=False,
        description="For how long it has been running before step 0; negative: shut down; none if not known.",
    )
    cost: Cost = cost_of(Polynomial(), "Cost of active power: a Polynomial or PiecewiseLinear.")
    pg_set: float | None = number(
        "MW",
        None,
        optional=True,
        series=False,
        description="Set-point of active power in a power flow; none for 0, within the limits.",
    )
    qg_set: float | None = number(
        "MVAr",
        None,
        optional=True,
        series=False,
        description="Set-point of reactive power in a power flow; none for 0, within the limits.",
    )
    vm_set: float | None = number(
        "p.u.",
        None,
        above=0.0,
        optional=True,
        series=False,
        description="Set-point of the voltage at its bus in a power flow; none for 1, within its limits.",
    )
    regulates: bool = flag(
        True, "Whether the generator holds vm_set in a power flow; otherwise it injects qg_set."
    )
    participation: float | None = number(
        "",
        None,
        at_least=0.0,
        optional=True,
        series=False,
        description="Weight in the distributed slack of a power flow, relative to the other generators of "
        "its island; none for p_max if it regulates, else 0.",
    )
    capability: tuple[tuple[float, float], ...] | None = capability()
    in_service: bool = in_service()

    def check(self, name: str) -> None:
        """Raise :class:`ComponentError` if a field breaks a rule or no power is within all limits."""
        super().check(name)
        check_capability(name, self.capability, self.p, self.q)
        if self.hours_on == 0.0:
            rule = "must be positive if it has been running and negative if it has been shut down"
            raise ComponentError(name, "hours_on", self.hours_on, rule)

    @classmethod
    def at_start(cls, arrays: Mapping[str, npt.NDArray[Any]]) -> Mapping[str, npt.NDArray[np.float64]]:
        """Return whether each unit runs before step 0; NaN if it is not known."""
        hours = arrays["hours_on"]
        return {"on": np.where(np.isfinite(hours), hours > 0.0, np.nan)}

    @classmethod
    def in_stages(
        cls,
        arrays: Mapping[str, npt.NDArray[Any]],
        before: Mapping[str, npt.NDArray[np.float64]],
        hours: npt.NDArray[np.float64],
    ) -> Mapping[str, npt.NDArray[np.float64]]:
        """Return limits and constant costs, which are those of the part that runs, and the starts.

        A unit that starts up or shuts down may move by its minimum output if its ramp allows less.
        """
        on, ramp = arrays["on"], arrays["ramp"]
        started = np.abs(on - before["on"])
        made = {key: on * arrays[key] for key in ("p_min", "p_max", "c0")}
        with np.errstate(invalid="ignore"):  # no limit, and shut down
            made |= {
                key: np.nan_to_num(on * arrays[key], nan=0.0, posinf=INF, neginf=-INF)
                for key in ("q_min", "q_max")
            }
        made["segment_offset"] = on[arrays["segment_owner"]] * arrays["segment_offset"]
        made["ramp"] = ramp + started * np.maximum(arrays["p_min"] / hours - ramp, 0.0)
        made["status"] = arrays["status"] * (on > 0.0)
        made["starts"] = np.maximum(on - before["on"], 0.0)
        return made
