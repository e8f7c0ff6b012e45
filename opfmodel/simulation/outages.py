"""Outages that happen in a closed loop: what trips, when, and from when on the controller knows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.errors import IncompatibleError, ModelError, shown
from opfmodel.horizon import Horizon
from opfmodel.network.arrays import OUTAGES, PerUnitNetwork
from opfmodel.network.bounds import integer, number_within
from opfmodel.plan import MultiStage
from opfmodel.plan.outages import COSTS, STATUS, check_whole, lost_fields, status_at, without
from opfmodel.plan.security import Security, rating_after

__all__ = ["Outage", "Outages"]

Array = npt.NDArray[np.float64]

_SAME = 1e-6  # relative
_ONE = Horizon.chain(1)


@dataclass(frozen=True)
class Outage:
    """A component that trips in a closed loop, and returns.

    Parameters
    ----------
    component
        Name of a branch, generator, storage, renewable, DC line or connection.
    step
        Step of the loop at whose beginning it trips.
    hours
        How long it is out of service, a multiple of the step of the loop.

    Examples
    --------
    >>> import opfmodel as om
    >>> om.NominalPlant().with_outages([om.Outage("4-5", step=12, hours=3)]).outages.components
    ('4-5',)
    """

    component: str
    step: int
    hours: float

    def __post_init__(self) -> None:
        if not isinstance(self.component, str):
            raise ModelError(f"outages: component = {shown(self.component)}: must be a name", "component")
        integer(f"outages: {self.component}: step", self.step, at_least=0)
        number_within(f"outages: {self.component}: hours", self.hours, above=0)

    def steps(self, length: float) -> range:
        """Return the steps of the loop in which it is out, for steps of a length in hours."""
        return range(self.step, self.step + round(self.hours / length))


@dataclass(frozen=True)
class Outages:
    """The outages of a closed loop and the response to them.

    Attributes
    ----------
    events
        The outages.
    known
        Steps after the trip until the controller knows.
    minutes
        Time in which units respond in the steps in which it does not; that of its security, else 15 min, by
        default.
    rating
        Multiple of the rating of a branch that applies in these steps, if it has no emergency rating; that of
        its security, else 1, by default.
    """

    events: tuple[Outage, ...] = ()
    known: int = 1
    minutes: float | None = None
    rating: float | None = None

    def __post_init__(self) -> None:
        for event in self.events:
            if not isinstance(event, Outage):
                raise ModelError(f"outages: {shown(event)}: must be an object of class Outage")
        integer("known", self.known, at_least=0)
        if self.minutes is not None:
            number_within("minutes", self.minutes, above=0)
        if self.rating is not None:
            number_within("rating", self.rating, above=0)

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the components that trip."""
        return tuple(dict.fromkeys(event.component for event in self.events))

    def of(self, problem: MultiStage) -> Outages:
        """Return the outages with the response that the security of a problem declares.

        Raises
        ------
        ModelError
            An outage does not fit the problem.
        SecurityError
            Components that are out at the same time split the grid.
        """
        self.check(problem)
        secure = problem.security or Security()
        return replace(
            self,
            minutes=secure.minutes if self.minutes is None else self.minutes,
            rating=secure.rating if self.rating is None else self.rating,
        )

    def check(self, problem: MultiStage) -> None:
        """Raise an error unless the outages fit a problem, which must declare them; see :meth:`of`."""
        length, taken = problem.step, dict[tuple[str, int], int]()
        for number, event in enumerate(self.events):
            at = ("outages", number)
            if event.component not in problem.outages:
                raise ModelError(
                    f"outages: {event.component!r}: the problem does not declare this outage; create it by "
                    f"MultiStage(..., outages=[{event.component!r}])",
                    *at,
                )
            whole = round(event.hours / length)
            if whole < 1 or abs(event.hours / length - whole) > _SAME * whole:
                raise ModelError(
                    f"outages: {event.component}: hours = {event.hours:g}: must be a multiple of the step of "
                    f"{length:g} h",
                    *at, "hours",
                )  # fmt: skip
            for step in event.steps(length):
                if (event.component, step) in taken:
                    raise ModelError(
                        f"outages: {event.component}: step = {event.step}: it is already out in step {step}",
                        *at, "step",
                    )  # fmt: skip
                taken[event.component, step] = number
        for number, event in enumerate(self.events):
            out = self.out(event.step, length)
            check_whole(out, problem.peak, f"outages in step {event.step}", "outages", number)

    def out(self, time: int, length: float) -> tuple[str, ...]:
        """Return the components that are out of service in a step."""
        return tuple(event.component for event in self.events if time in event.steps(length))

    def told(self, time: int, length: float) -> tuple[str, ...]:
        """Return those of which the controller knows."""
        return tuple(event.component for event in self.events if time in event.steps(length)[self.known :])

    def surprising(self, time: int, length: float) -> bool:
        """Return whether a component is out of which the controller does not know."""
        return len(self.out(time, length)) > len(self.told(time, length))

    def changed(self, time: int, length: float) -> tuple[str, ...]:
        """Return the components that trip or return at the beginning of a step."""
        now, before = set(self.out(time, length)), set(self.out(time - 1, length))
        return tuple(sorted(now ^ before))

    def network(self, problem: MultiStage, time: int) -> PerUnitNetwork:
        """Return the network of a problem in one step, with what is then out of service.

        Where the controller does not know, branches have their emergency rating. A unit whose status
        changes has no ramp limit.
        """
        network = problem.window(time, 1)
        if not self.events:
            return network
        series: dict[tuple[str, str], Array] = {}
        if self.surprising(time, problem.step):
            branch, multiple = network.branch, 1.0 if self.rating is None else self.rating
            series["branch", "rating"] = rating_after(branch.rating, branch.emergency_rating, multiple)
        units = network.generator
        moved = np.isin(units.names, self.changed(time, problem.step))[:, None]
        series["generator", "ramp"] = np.where(moved, np.inf, units.ramp)
        status = self.status(network, time, problem.step)
        fields = lost_fields(network, _ONE, self.components)
        return network.with_series(without(series, network, status, fields))

    def status(self, network: PerUnitNetwork, time: int, length: float) -> dict[str, Array]:
        """Return the status in one step, ``(items, 1)`` by kind: 1 in service, 0 while it is out."""
        return status_at(network, _ONE, self.out(time, length))

    def without_costs(self, network: PerUnitNetwork, steps: range, length: float) -> PerUnitNetwork:
        """Return the network of some steps, in which units cost nothing while they are out."""
        if not self.events:
            return network
        fields = [key for key in lost_fields(network, _ONE, self.components) if key[1] in COSTS]
        columns = [self.status(network, time, length)["generator"] for time in steps]
        return network.with_series(without({}, network, {"generator": np.hstack(columns)}, fields))

    def summary(self, steps: int, length: float) -> dict[str, Any]:
        """Return the steps in which each component was out, of those that have been done."""
        if not self.events:
            return {}
        done = range(steps)
        out = {name: [time for time in done if name in self.out(time, length)] for name in self.components}
        return {"outages": out}

    def record(self, problem: MultiStage, time: int) -> dict[tuple[str, str], Array]:
        """Return what results record in a step: the status of the kinds that have outages."""
        if not self.events:
            return {}
        status = self.status(problem.arrays, time, problem.step)
        made = {
            (kind, f"{kind}_status"): values[:, 0]
            for kind, values in status.items()
            if set(self.components) & set(problem.arrays.tables[kind].names)
        }
        known = 0.0 if self.surprising(time, problem.step) else 1.0
        return {**made, ("", "outages_known"): np.array([known])}

    @property
    def described(self) -> dict[str, tuple[str, str]]:
        """Unit and description of each recorded quantity."""
        if not self.events:
            return {}
        return {
            **{f"{kind.kind}_status": STATUS for kind in OUTAGES},
            "outages_known": ("", "1 if the controller knew of all outages, else 0"),
        }

    def resumed(self, problem: MultiStage, time: int, state: Mapping[str, Array]) -> dict[str, Array]:
        """Return the state after a step, in which units that return are within their limits."""
        made = dict(state)
        lost = set(self.out(time, problem.step)) - set(self.told(time + 1, problem.step))
        units = problem.arrays.generator
        back = np.isin(units.names, sorted(lost))
        if not back.any():
            return made
        limits = problem.window(time, 1).generator
        for name, stem in (("pg", "p"), ("qg", "q")):
            if name in made:
                low, high = (limits.arrays[f"{stem}_{end}"][:, 0] * units.base_mva for end in ("min", "max"))
                made[name] = np.where(back, np.clip(made[name], low, high), made[name])
        return made


def outages_of(events: Iterable[Outage], known: int | None, follows: bool, **response: Any) -> Outages:
    """Return outages, of which the controller knows at once if the plant follows its plan."""
    if isinstance(events, str) or not isinstance(events, Iterable):
        raise ModelError(f"outages = {shown(events)}: must be a list of objects of class Outage")
    if known is None:
        known = 0 if follows else 1
    found = Outages(tuple(events), known, **response)
    if follows and known != 0:
        raise IncompatibleError(
            f"known = {known}: the plant follows plans, which must know of an outage at once: known = 0; "
            "power-flow and redispatch respond to others",
            "known",
        )
    return found
