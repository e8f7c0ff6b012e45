"""Plants: what the grid does with a plan. ``docs/plants.md`` has the equations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from opfmodel.components import Generator, Load, Storage
from opfmodel.errors import ModelError, nearest
from opfmodel.model import Device, Elastic, Model, Stage
from opfmodel.network import PerUnitNetwork, Table
from opfmodel.objectives.base import Objective
from opfmodel.plan import End, MultiStage, Plan
from opfmodel.profiles.series import Profiles
from opfmodel.simulation.records import DESCRIBED, changes, excesses
from solvers import largest, total

__all__ = ["NominalPlant", "Plant", "PowerFlow", "Redispatch", "Step"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Key = tuple[str, str]
Values = dict[Key, Array]

_NETWORK = ("bus", "branch")
_ALWAYS = (("generator", "pg"), ("generator", "qg"), ("storage", "ps"), ("storage", "qs"))
_SHARE = ("load", "unserved")
_PRECISE = {"tol": 1e-8, "constr_viol_tol": 1e-8}
_WIDE = 1e3  # p.u.; stands for a range without limit
_LEAST_VM, _MOST_VM = 0.2, 2.0  # p.u.; no grid runs outside, and Newton's steps stay inside


@dataclass(frozen=True)
class Step:
    """What happened in one step.

    Attributes
    ----------
    values
        Per-unit values ``(items,)`` by ``(kind, quantity)``.
    state
        The state at the next step, in physical units.
    described
        Unit and description of each quantity.
    formulation
        The physics that the values obey.
    status
        How the plant found them: ``planned``, or the status of its own problem.
    solved
        Whether it did; if not, values of the network are NaN.
    """

    values: Mapping[Key, Array]
    state: Mapping[str, Array]
    described: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    formulation: str = "ac"
    status: str = "planned"
    solved: bool = True


class Plant(Protocol):
    """Answers a plan: what the grid does in the first stage, and the next state."""

    def apply(self, plan: Plan) -> Step:
        """Apply the first stage of a plan."""
        ...


class NominalPlant:
    """The grid does exactly what was planned."""

    def apply(self, plan: Plan) -> Step:
        """Take the first stage of the plan as what happened."""
        known = {**plan.quantities(), **plan.exceeded(), **plan.prices()}
        values = {key: value[:, 0] for key, value in known.items()}
        formulation = plan.problem.formulation.name
        return Step(values, plan.next_state(), plan.problem.described, formulation)


class _ACPlant:
    """What the two AC plants share: they are a problem of one stage, solved at what really happens.

    The problem is compiled at the first plan, and only numbers change from then on.
    """

    def __init__(self) -> None:
        self._arrays: PerUnitNetwork | None = None
        self._set_points = _SetPoints({})
        self._last: Plan | None = None
        self._before: Array | None = None
        self._next = -1

    def apply(self, plan: Plan) -> Step:
        """Find the physical state of the first stage of a plan, at the demand that happens.

        Returns
        -------
        Step
            Also if there is no such state: then with the set-points as they were, NaN for what the
            network does, and the status.
        """
        self._prepare(plan)
        network = plan.problem.window(plan.time, 1)
        planned = {key: value[:, 0] for key, value in plan.quantities().items() if key[0] not in _NETWORK}
        found = self._find(plan, planned, network)
        values = self._values(planned, found)
        before = self._before
        values |= excesses(network, values, plan.problem.step, before)
        values |= changes(network, values, planned, self._available)
        self._before, self._next = values.get(("generator", "pg")), plan.time + 1
        return Step(
            values={**{key: price[:, 0] for key, price in plan.prices().items()}, **values},
            state=self._state(plan, values, network),
            described={**plan.problem.described, **self._problem.described, **DESCRIBED},
            status=found.status,
            solved=found.optimal,
        )

    def _prepare(self, plan: Plan) -> None:
        """Compile for the network of a plan, and forget what happened if the plan is not the next one."""
        if self._arrays is not plan.problem.arrays:
            self._arrays = plan.problem.arrays
            self._problem = self._make(plan)
            self._next = -1
            series = plan.problem.profiles.series
            self._available = np.array([(g, "p_max") in series for g in self._arrays.generator.names])
        if plan.time != self._next:
            self._last = self._before = None

    def _make(self, plan: Plan) -> MultiStage:
        raise NotImplementedError

    def _find(self, plan: Plan, planned: Values, network: PerUnitNetwork) -> Plan:
        """Solve the plant's own problem for the set-points of a plan."""
        raise NotImplementedError

    def _solve(self, time: int, initial: dict[str, Any] | None, window: Values) -> Plan:
        """Solve, first from the last state, then from nothing."""
        found = self._problem.solve(time, initial, self._last, expected=window)
        if not found.optimal and self._last is not None:
            found = self._problem.solve(time, initial, expected=window)
        self._last = found if found.optimal else None
        return found

    @staticmethod
    def _values(planned: Values, found: Plan) -> Values:
        """The physical state by quantity; the set-points alone if there is none."""
        state = {key: value[:, 0] for key, value in found.quantities().items()}
        state |= {key: value[:, 0] for key, value in found.exceeded().items() if key[1] in DESCRIBED}
        if not found.optimal:
            held = {key: planned.get(key, np.zeros_like(value)) for key, value in state.items()}
            unknown = {key: np.full_like(value, np.nan) for key, value in state.items() if key[0] in _NETWORK}
            state = held | unknown
        return planned | state

    @staticmethod
    def _state(plan: Plan, values: Values, network: PerUnitNetwork) -> dict[str, Array]:
        """The state that the next plan starts from, in physical units.

        With ``generator_delay`` 1 the dispatch of the next stage is committed already, and stays as
        planned; with 0 it is ramped from what was really generated, as far as the unit's limits go.
        """
        state = plan.next_state(values)
        if plan.problem.generator_delay == 0 and "pg" in state:
            table = network.generator
            low, high = (table.arrays[field][:, 0] for field in ("p_min", "p_max"))
            state["pg"] = np.clip(state["pg"], low * network.base_mva, high * network.base_mva)
        return state


class PowerFlow(_ACPlant):
    r"""Units hold their set-points and limits are measured, not enforced.

    Losses and forecast errors are taken by a distributed slack: with participation factors
    :math:`\gamma`, which sum to one in an island,

    .. math::
        p^g_i = \hat p^g_i + \gamma_i s

    Voltages are held where there are generators, at the plan's magnitude or, if the plan has none, at
    1 p.u. within the limits of the bus; the generators of a bus share its reactive power in
    proportion to their ranges. Storages hold ``ps`` and ``qs``, zero where the plan has none. A set-point
    above what is available is lowered to that.

    Parameters
    ----------
    participation
        Factor of each generator by name; those that are not mentioned take no part. By default
        in proportion to ``p_max``.
    """

    def __init__(self, participation: Mapping[str, float] | None = None) -> None:
        super().__init__()
        for name, factor in (participation or {}).items():
            if not 0 <= factor < np.inf:
                raise ModelError(f"participation: {name} = {factor!r}: must be a number, at least 0")
        self.participation = participation

    def shares(self, network: PerUnitNetwork) -> Array:
        """Share of each generator in the slack of its island; those of an island sum to one.

        Raises
        ------
        ModelError
            A factor is of no generator in service.
        """
        table = network.generator
        if self.participation is None:
            factors = np.clip(table.p_max[:, 0], 0.0, _WIDE)
        else:
            for name in self.participation:
                if name not in table.position:
                    known = nearest(name, table.names)
                    raise ModelError(f"participation: no generator in service is named {name!r}; {known}")
            factors = np.array([float(self.participation.get(name, 0.0)) for name in table.names])
        return _divide(factors, network.island[table.bus])

    def _make(self, plan: Plan) -> MultiStage:
        problem = plan.problem
        own: dict[type, Device] = {
            Generator: _HeldGenerators(self.shares(problem.arrays)),
            Storage: _HeldStorages(),
            Load: _HeldLoads(),
        }
        devices = [own.get(device.component, device) for device in problem.devices]
        others = [key for key in _set_points(plan) if key not in _ALWAYS]
        self._set_points = _SetPoints(dict.fromkeys((*_ALWAYS, _SHARE), 0.0) | dict.fromkeys(others, 1.0))
        free = _without_limits(problem.arrays)
        kept = {
            key: values
            for key, values in problem.profiles.series.items()
            if (problem.network[key[0]].kind, key[1]) not in free
        }
        made = _one_stage(problem, self._set_points, devices, profiles=Profiles(kept))
        made.arrays = made.arrays.with_series(free)
        return made

    def _find(self, plan: Plan, planned: Values, network: PerUnitNetwork) -> Plan:
        if _SHARE[1] in plan.solution.program.variables:  # an elastic plan sheds on purpose
            planned = planned | {_SHARE: plan.solution.value(_SHARE[1])[:, 0]}
        window = self._set_points.targets(network, planned)
        held = window["generator", "pg_set"]
        window["generator", "pg_set"] = np.minimum(held, network.generator.p_max)
        low, high = network.bus.vm_min, network.bus.vm_max
        at = np.unique(network.generator.bus)
        wanted = plan.quantities().get(("bus", "vm"), np.ones((len(network.bus), 1)))[:, :1]
        least, most = np.full_like(wanted, _LEAST_VM), np.full_like(wanted, _MOST_VM)
        least[at] = most[at] = np.clip(wanted, low, high)[at]
        window |= {("bus", "vm_min"): least, ("bus", "vm_max"): most}
        return self._solve(plan.time, None, window)


class Redispatch(_ACPlant):
    r"""The smallest change of set-points that keeps all AC limits, ramps and the limits of storages.

    .. math::
        \min\; \pi_p \sum |p^g - \hat p^g| + \pi_p \sum |p^s - \hat p^s|
             + \pi_q \sum |q^g - \hat q^g| + \pi_q \sum |q^s - \hat q^s| + \text{elastic terms}

    Reactive set-points that a plan lacks are zero. Demand is shed, and limits are exceeded, at the
    prices of an elastic problem, so that there is an answer to every plan.

    Parameters
    ----------
    price, reactive_price
        :math:`\pi_p` and :math:`\pi_q` in $/MWh and $/MVArh; only their ratios to the others matter.
    shedding_price
        Of demand that is not served, $/MWh.
    violation_price
        Of limits that are exceeded, $/MWh; see :class:`opfmodel.Elastic`.
    """

    def __init__(
        self,
        price: float = 100.0,
        reactive_price: float = 1.0,
        shedding_price: float = 10_000.0,
        violation_price: float = 50_000.0,
    ) -> None:
        super().__init__()
        for name, value in (("price", price), ("reactive_price", reactive_price)):
            if not 0 < value < np.inf:
                raise ModelError(f"redispatch: {name} = {value!r}: must be a positive price")
        self.price = price
        self.reactive_price = reactive_price
        self.elastic = Elastic(violation_price, shedding_price, 2.0 * violation_price)

    def _make(self, plan: Plan) -> MultiStage:
        wanted = list(dict.fromkeys([*_ALWAYS, *_set_points(plan)]))
        reactive = (*_ALWAYS[1::2], *(k for k in _set_points(plan) if _unit(plan, k) == "MVAr"))
        base = plan.problem.arrays.base_mva
        prices = {key: base * (self.reactive_price if key in reactive else self.price) for key in wanted}
        # what is stored is worth a little, or a lossy store would charge and discharge at once
        end = End(price=0.01 * self.price)
        self._set_points = _SetPoints(prices)
        return _one_stage(plan.problem, self._set_points, plan.problem.devices, elastic=self.elastic, end=end)

    def _find(self, plan: Plan, planned: Values, network: PerUnitNetwork) -> Plan:
        base = network.base_mva
        before = None if self._before is None else self._before * base
        dispatch = {"pg": before, "qg": None} if len(network.generator) else {}
        initial = {**dispatch, **plan.stocks()}
        return self._solve(plan.time, initial, self._set_points.targets(network, planned))


class _SetPoints(Objective):
    """Distance from set-points ``<quantity>_set``, which are numbers of every solve.

    Parameters
    ----------
    prices
        By quantity, $/h per p.u.; what costs nothing has a set-point for devices that hold it.
    """

    def __init__(self, prices: Mapping[Key, float]) -> None:
        self.prices = prices

    def series(self, network: PerUnitNetwork) -> Values:
        """Set-points of zero, for want of a plan."""
        return self.targets(network, {})

    def targets(self, network: PerUnitNetwork, planned: Values) -> Values:
        """Set-points ``(items, 1)`` as fields of the network, zero where a plan has none."""
        made = {}
        for kind, name in self.prices:
            none = np.zeros(len(network.tables[kind]))
            made[kind, f"{name}_set"] = planned.get((kind, name), none)[:, None]
        return made

    def stage_cost(self, stage: Stage) -> Any:
        """Sum of the absolute differences; None where there is nothing to pay."""
        cost: Any = None
        for (kind, name), price in self.prices.items():
            if price and stage.has(name):
                quantities = getattr(stage, kind)
                change = getattr(quantities, name) - getattr(quantities, f"{name}_set")
                distance = price * total(largest(change, -change))
                cost = distance if cost is None else cost + distance
        return cost


def _one_stage(
    problem: MultiStage, objective: Objective, devices: Sequence[Device], **options: Any
) -> MultiStage:
    """One stage of AC physics of the network of a problem."""
    return MultiStage(
        problem.network,
        step=problem.step,
        objective=objective,
        devices=devices,
        solver="ipopt",
        options=_PRECISE,
        **{"profiles": problem.profiles, **options},
    )


class _HeldGenerators(Device):
    """Generators at their set-points and a distributed slack in every island."""

    component = Generator

    def __init__(self, shares: Array) -> None:
        self.shares = shares

    def declare(self, model: Model, table: Table) -> None:
        """Publish ``pg`` and ``qg`` in terms of one slack per island and one per bus with generators."""
        network = model.network
        slack = model.build.variable("slack", network.n_islands, model.stages)
        pg = model.parameter("generator", "pg_set") + self.shares * slack[network.island[table.bus]]
        at, which = np.unique(table.bus, return_inverse=True)
        extra = model.build.variable("slack_q", at.size, model.stages)
        shares = _divide(np.minimum(table.q_max - table.q_min, _WIDE)[:, 0], which)
        qg = model.parameter("generator", "qg_set") + shares * extra[which]
        model.publish("generator", "pg", pg, unit="MW", description="active generation")
        model.publish("generator", "qg", qg, unit="MVAr", description="reactive generation")
        model.inject(table.bus, p=pg, q=qg)


class _HeldStorages(Device):
    """Storages at their set-points."""

    component = Storage

    def declare(self, model: Model, table: Table) -> None:
        """Publish ``ps`` and ``qs`` as they were planned."""
        ps, qs = model.parameter("storage", "ps_set"), model.parameter("storage", "qs_set")
        model.publish("storage", "ps", ps, unit="MW", description="charging power")
        model.publish("storage", "qs", qs, unit="MVAr", description="reactive power drawn")
        model.inject(table.bus, p=-ps, q=-qs)


class _HeldLoads(Device):
    """Loads, less the share that is shed on purpose."""

    component = Load

    def declare(self, model: Model, table: Table) -> None:
        """Withdraw what is served; publish what is not."""
        share = model.parameter(_SHARE[0], f"{_SHARE[1]}_set")
        for name, power in (("p", model.parameter("load", "p")), ("q", model.parameter("load", "q"))):
            unit, text = DESCRIBED[f"{name}_unserved"]
            model.publish("load", f"{name}_unserved", power * share, unit=unit, description=text)
            served = power * share - power
            model.inject(table.bus, **{name: served})


def _divide(weights: Array, group: Index) -> Array:
    """Weights divided by the sum over their group; equal ones where that is zero."""
    sums = np.bincount(group, weights)[group]
    equal = 1.0 / np.bincount(group)[group]
    return np.asarray(np.where(sums > 0, weights / np.where(sums > 0, sums, 1.0), equal))


def _set_points(plan: Plan) -> list[Key]:
    """What a plan decides about devices: everything of theirs that is not a stock or a report."""
    return [key for key in plan.decisions() if key[0] not in _NETWORK]


def _unit(plan: Plan, key: Key) -> str:
    return plan.problem.described[key[1]][0]


def _without_limits(network: PerUnitNetwork) -> Values:
    """Fields that leave the network without limits of its own."""
    none = np.full((len(network.branch), 1), np.inf)
    return {
        ("branch", "rating"): none,
        ("branch", "angle_min"): -none,
        ("branch", "angle_max"): none,
        ("bus", "vm_min"): np.full((len(network.bus), 1), _LEAST_VM),
        ("bus", "vm_max"): np.full((len(network.bus), 1), _MOST_VM),
    }
