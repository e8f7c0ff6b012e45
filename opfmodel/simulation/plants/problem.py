"""The common part of AC plants: a single-stage problem, solved with the realised data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from opfmodel.data.series import SeriesKey
from opfmodel.horizon import Horizon
from opfmodel.model import Device, Model, Stage
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.objectives.base import Objective
from opfmodel.plan import Initial, MultiStage, Plan
from opfmodel.plan.positions import without_moves
from opfmodel.plan.recall import Memory, plan_memory, problem_memory, recall_problem, recalled_plan
from opfmodel.plan.request import Request
from opfmodel.simulation.outages import Outages
from opfmodel.simulation.plants.base import Array, Key, Plant, Step, Values, with_following
from opfmodel.simulation.records import DESCRIBED, changes, excesses
from solvers import largest, total

__all__ = ["ALWAYS", "SHED", "ACPlant", "SetPoints", "decided", "one_stage"]

_NETWORK = ("bus", "branch")
ALWAYS = (("generator", "pg"), ("generator", "qg"), ("storage", "ps"), ("storage", "qs"))
SHED = ("load", "load_shed")
_PRECISE = {"tol": 1e-8, "constr_viol_tol": 1e-8}


class ACPlant(Plant):
    """A plant that solves a single-stage problem with the AC equations and the realised data.

    The problem is compiled at the first plan; later plans change only the instance data. A subclass
    builds the problem (:meth:`make`) and solves it for set-points (:meth:`find`).
    """

    takes_outages = True

    def __init__(self) -> None:
        self._set_points = SetPoints({})
        self._happening = Outages()
        self._controlled: MultiStage | None = None
        self._own: MultiStage | None = None
        self._last: Plan | None = None
        self._before: Array | None = None
        self._next = 0
        self._memory: Memory | None = None  # to be put back when the own problem has been made

    def begin(self, problem: MultiStage, state: Initial | None = None) -> None:
        """Start a run; the plant recompiles its own problem only if the controller's is a new one."""
        self._happening = self.outages.of(problem)
        other = self._own is not None and self._own.outages != self.outages.components
        if self._controlled is None or other or not problem.is_variant_of(self._controlled):
            self._controlled, self._own = problem, None
            names, known = problem.arrays.generator.names, problem.profiles
            self._available = np.array([SeriesKey(name, "p_max") in known for name in names])
        elif self._own is not None:
            recall_problem(self._own, {})
        self._last, self._next, self._memory = None, 0, None
        before = (state or {}).get("pg") if problem.generator_delay == 0 else None
        self._before = None if before is None else np.asarray(before, dtype=float) / problem.arrays.base_mva

    def memory(self) -> Memory:
        """Return the generation and the state of the last step, from which the next one starts."""
        if self._own is None or self._memory is not None:
            return self._memory or {}
        return {
            "next": self._next,
            "before": self._before,
            "last": None if self._last is None else plan_memory(self._own, self._last),
            "problem": problem_memory(self._own),
        }

    def recall(self, memory: Memory) -> None:
        """Put back what :meth:`memory` returned; the own problem is compiled at the next plan."""
        if memory:
            self._memory, self._next = memory, memory["next"]

    def apply(self, plan: Plan) -> Step:
        """Find the physical state of the first stage of a plan, at the realised demand.

        Returns
        -------
        Step
            Also if there is no such state; then with the unchanged set-points, NaN for network
            quantities, and the status.
        """
        known = self._controlled is not None and plan.problem.is_variant_of(self._controlled)
        if not known or plan.time < self._next:
            self.begin(plan.problem)
        if self._own is None:
            self._own = self.make(plan)
        if self._memory is not None:
            recall_problem(self._own, self._memory["problem"])
            last, self._before = self._memory["last"], self._memory["before"]
            self._last = None if last is None else recalled_plan(self._own, last)
            self._memory = None
        network = self._happening.network(plan.problem, plan.time)
        moves = [(s.kind, f"{s.name}_moves") for s in plan.model.settings.values()]
        planned = {
            key: value[:, 0]
            for key, value in plan.quantities().items()
            if key[0] not in _NETWORK or key in moves
        }
        wanted = self._left(self.aims(plan, planned), network)
        wanted = _of_demand(wanted, plan, network)
        aims = _with_energy(wanted, planned, network, plan.problem.step)
        found = self.find(plan, aims, network)
        values = self._values(aims, found)
        before = self._before
        values |= excesses(network, values, plan.problem.step, before)
        values |= changes(network, values, planned, self._available)
        values = with_following(plan, values, network)
        self._before, self._next = values.get(("generator", "pg")), plan.time + 1
        return Step(
            values={**{key: price[:, 0] for key, price in plan.prices().items()}, **values},
            state=self._state(plan, values, network),
            described={**plan.problem.described, **self._own.described, **DESCRIBED},
            status=found.status,
            solved=found.optimal,
        )

    def aims(self, plan: Plan, planned: Values) -> Values:  # noqa: ARG002 - for subclasses
        """Return the set-points that devices actually pursue, p.u.; by default those of the plan."""
        return planned

    def make(self, plan: Plan) -> MultiStage:
        """Return the plant's own problem for the network of a plan."""
        raise NotImplementedError

    def find(self, plan: Plan, aims: Values, network: PerUnitNetwork) -> Plan:
        """Solve the plant's own problem for set-points."""
        raise NotImplementedError

    def solve(self, plan: Plan, initial: dict[str, Any] | None, window: Values) -> Plan:
        """Solve from the last state, then from a cold start if that fails."""
        assert self._own is not None
        out = self._happening.out(plan.time, self._own.step)
        given = Request(
            plan.time, initial, self._own.end, window, self._own.horizon, out, self._settings(plan)
        )
        found = self._own.solve_requested(given, self._last)
        if not found.optimal and self._last is not None:
            found = self._own.solve_requested(given)
        self._last = found if found.optimal else None
        return found

    def _left(self, aims: Values, network: PerUnitNetwork) -> Values:
        """Return set-points that are zero where a component is out of service."""
        made = dict(aims)
        for key in made.keys() & self._set_points.prices.keys():
            status = network.tables[key[0]].arrays.get("status", np.ones(1))
            if not status.all():
                made[key] = made[key] * status[:, 0]
        return made

    def _settings(self, plan: Plan) -> dict[str, Array]:
        """Return the taps, phase shifts and shunts of a plan, or their neutral values if it decides none.

        Those that the plan does not put at a position, as in a relaxation, are at the nearest one.
        """
        assert self._own is not None
        made, chosen = {}, plan.quantities()
        for setting in self._own.model.settings.values():
            values = chosen.get((setting.kind, setting.name), setting.neutral)[:, :1]
            held = np.clip(values, setting.low, setting.high)
            made[setting.name] = np.where(setting.stepped, setting.rounded(held), held)
        return made

    def stocks(self, plan: Plan) -> dict[str, Array]:
        """Return the stored quantities before the step that the own problem has, in physical units."""
        assert self._own is not None
        own = self._own.model.states
        return {name: values for name, values in plan.stocks().items() if values.size and name in own}

    @staticmethod
    def _values(aims: Values, found: Plan) -> Values:
        """Return the physical state by quantity, or the set-points alone if there is none."""
        state = {key: value[:, 0] for key, value in found.quantities().items()}
        state |= {key: value[:, 0] for key, value in found.exceeded().items() if key[1] in DESCRIBED}
        if not found.optimal:
            held = {key: aims.get(key, np.zeros_like(value)) for key, value in state.items()}
            unknown = {key: np.full_like(value, np.nan) for key, value in state.items() if key[0] in _NETWORK}
            state = held | unknown
        return aims | state

    @staticmethod
    def _state(plan: Plan, values: Values, network: PerUnitNetwork) -> dict[str, Array]:
        """Return the initial state of the next plan, in physical units.

        With ``generator_delay`` 1 the dispatch of the next stage is already committed and stays as
        planned. With 0 its ramp starts from the actual generation, clipped to the limits of the unit.
        """
        state = plan.next_state(values)
        if plan.problem.generator_delay == 0 and "pg" in state:
            table = network.generator
            low, high = (table.arrays[field][:, 0] for field in ("p_min", "p_max"))
            state["pg"] = np.clip(state["pg"], low * network.base_mva, high * network.base_mva)
        return state


def _of_demand(aims: Values, plan: Plan, network: PerUnitNetwork) -> Values:
    """Return the set-points, with shed demand as the planned share of the realised demand."""
    if SHED not in aims:
        return aims
    expected, realised = plan.network.load.p[:, 0], np.maximum(network.load.p[:, 0], 0.0)
    shed = np.minimum(aims[SHED], np.maximum(expected, 0.0))
    scaled = np.divide(shed * realised, expected, out=np.zeros_like(shed), where=expected > 0)
    return aims | {SHED: scaled}


def _with_energy(aims: Values, planned: Values, network: PerUnitNetwork, step: float) -> Values:
    """Return the set-points, with stored energy corrected for storage power that differs from the plan."""
    power, energy = ("storage", "ps"), ("storage", "e_next")
    if energy not in planned or aims[power] is planned[power]:
        return aims
    table = network.storage
    gain, drain = table.charge_efficiency[:, 0], 1.0 / table.discharge_efficiency[:, 0]
    stored = [np.where(ps >= 0, gain * ps, drain * ps) for ps in (planned[power], aims[power])]
    return aims | {energy: planned[energy] + step * (stored[1] - stored[0])}


class SetPoints(Objective):
    """Distance from set-points ``<quantity>_set``, which are data of every solve.

    Parameters
    ----------
    prices
        By quantity, $/h per p.u.; a price of zero only provides the set-point to devices that hold it.
    fields
        Fields of the network that differ from the declared ones, ``(items, 1)``.
    waste
        Price of quantities that a relaxation may raise, $/h per p.u.
    """

    def __init__(
        self,
        prices: Mapping[Key, float],
        fields: Values | None = None,
        waste: Mapping[Key, float] | None = None,
    ) -> None:
        self.prices = prices
        self.fields = fields or {}
        self.waste = waste or {}

    def series(self, network: PerUnitNetwork) -> Values:
        """Return set-points of zero, to be replaced by those of each plan, and the fields."""
        return self.targets(network, {}) | self.fields

    def targets(self, network: PerUnitNetwork, planned: Values) -> Values:
        """Return set-points ``(items, 1)`` as fields of the network, zero if a plan has none."""
        made = {}
        for kind, name in self.prices:
            none = np.zeros(len(network.tables[kind]))
            made[kind, f"{name}_set"] = planned.get((kind, name), none)[:, None]
        return made

    def stage_cost(self, stage: Stage) -> Any:
        """Return the priced sum of absolute deviations and of waste; None if nothing has a price."""
        cost: Any = None
        for (kind, name), price in self.prices.items():
            if price and stage.has(name):
                quantities = getattr(stage, kind)
                change = getattr(quantities, name) - getattr(quantities, f"{name}_set")
                distance = price * total(largest(change, -change))
                cost = distance if cost is None else cost + distance
        for (kind, name), price in self.waste.items():
            wasted = price * total(getattr(getattr(stage, kind), name))
            cost = wasted if cost is None else cost + wasted
        return cost


def one_stage(
    problem: MultiStage, objective: Objective, devices: Sequence[Device], **options: Any
) -> MultiStage:
    """Return a single-stage problem with AC physics for the network of a problem.

    It has no devices that are no part of the grid.
    """
    made = MultiStage(
        without_moves(problem.network),
        step=problem.step,
        objective=objective,
        devices=devices,
        at_end=problem.at_end,
        solver="ipopt",
        options=_PRECISE,
        **{"profiles": problem.profiles, **options},
    )
    made.devices = [device for device in made.devices if device.physical]
    return made


def decided(network: PerUnitNetwork, devices: Sequence[Device]) -> dict[Key, str]:
    """Return the quantities that devices decide under the AC equations, without stocks, with their units.

    A plan without reactive power decides fewer.
    """
    model = Model(network, Horizon.chain(1), reactive=True, zones=np.arange(len(network.bus)))
    for device in devices:
        if device.physical:
            model.connect(device)
    stocks = {name for name, state in model.states.items() if state.role == "stock"}
    return {
        (p.kind, name): p.unit
        for name, p in model.published.items()
        if name in model.build.variables and name not in stocks
    }
