"""Plans: the result of one solve, in physical units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import Times
from opfmodel.data.labelled import Labelled, Variable
from opfmodel.errors import IncompatibleError, ModelError, nearest
from opfmodel.horizon import Horizon
from opfmodel.model import Model, NumericStage, Shortage
from opfmodel.model.elastic import LEAST, shortages
from opfmodel.network.arrays import OUTAGES, PerUnitNetwork
from opfmodel.network.units import scale
from opfmodel.plan.diagnosis import shortfall_due
from opfmodel.plan.outages import STATUS
from opfmodel.plan.request import Request
from opfmodel.plugins.versions import versions
from opfmodel.results import labelled
from opfmodel.results.overview import Unit, units
from opfmodel.results.presented import Presented, Scenarios
from opfmodel.results.store import save
from solvers import Solution, SolutionStatus

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from opfmodel.plan.multistage import MultiStage
    from opfmodel.plan.screening import Round

__all__ = ["Plan", "penalty_outputs", "status_word"]

Array = npt.NDArray[np.float64]


class Plan(Presented):
    """The result of one solve: trajectories in physical units, status and effort.

    If the solver found no optimum, the objective, the quantities and the prices are NaN, and
    ``solution.x`` is the point at which it stopped.

    Attributes
    ----------
    model, network
        The declarations, and the arrays of the network with the series of the window.
    whole
        The same arrays with the data of contingencies, which follow those of the stages.
    solution
        The certified solution of the program.
    request
        What was asked for.
    rounded_from
        The plan before its settings were rounded to positions; None if none have positions.
    rounds
        Rounds of screening that led to a secure plan; empty without screening.
    """

    def __init__(
        self,
        problem: MultiStage,
        model: Model,
        solution: Solution,
        network: PerUnitNetwork,
        request: Request,
    ) -> None:
        self.problem = problem
        self.solution = solution
        self.request = request
        self.model = model
        self.whole = network
        self.rounds: tuple[Round, ...] = ()
        self.rounded_from: Plan | None = None
        regular = slice(len(request.horizon.regular))
        self.network = network.over(regular) if request.horizon.out else network

    def __repr__(self) -> str:
        cost = f", {self.objective:.6g} {self.network.currency}" if self.optimal else ""
        return f"Plan({self.network.name!r}, from step {self.time}: {self.status}{cost})"

    def with_solution(self, problem: MultiStage, solution: Solution) -> Plan:
        """Return the same plan with another record of its solution, as the plan of another problem."""
        made = Plan(problem, self.model, solution, self.whole, self.request)
        made.rounds, made.rounded_from = self.rounds, self.rounded_from
        return made

    @property
    def rounding_loss(self) -> float:
        """Increase of the objective, $, by taps, phase shifts and shunts at positions; 0 if none have any.

        NaN if no plan exists at the nearest positions.
        """
        return 0.0 if self.rounded_from is None else self.objective - self.rounded_from.objective

    @property
    def time(self) -> int:
        """First step of the plan."""
        return self.request.time

    @property
    def stages(self) -> int:
        """Number of stages: the horizon, unless the plan ends earlier, with the data."""
        return len(self.horizon)

    @property
    def status(self) -> str:
        """``globally_optimal``, ``locally_optimal``, ``*_infeasible`` or ``stopped``."""
        return status_word(self.solution.status)

    @property
    def termination(self) -> str:
        """Why the solver stopped."""
        return f"{self.solution.termination.value} ({self.solution.message})"

    @property
    def optimal(self) -> bool:
        """Whether the plan is optimal."""
        return self.solution.status.is_optimal

    @property
    def infeasible(self) -> bool:
        """Whether the problem is infeasible, as far as the solver can tell."""
        return self.solution.status.is_infeasible

    @cached_property
    def objective(self) -> float:
        """What is minimised, in $ over the horizon, without regularisation; NaN unless optimal.

        Includes risk aversion and penalties that are traded against cost; :attr:`expected_cost` does not.
        """
        risk, elastic = self.problem.risk, self.problem.elastic
        traded = self.penalty if self.optimal and elastic is not None and elastic.traded else 0.0
        if risk is None:
            return self.expected_cost + traded
        last = self.horizon.probability[self.horizon.leaves]
        return risk.measure(np.array(list(self.scenario_costs.values())), last) + traded

    @property
    def expected_cost(self) -> float:
        """Mean cost of the scenarios in $ over the horizon, without regularisation; NaN unless optimal."""
        if not self.optimal:
            return np.nan
        return float(np.sum(self.horizon.probability * self.node_costs))

    @cached_property
    def node_costs(self) -> Array:
        """Cost of each node in $, the terminal cost of its scenario included; NaN unless optimal."""
        horizon, objective = self.horizon, self.problem.objective
        if not self.optimal:
            return np.full(len(horizon), np.nan)
        stage = self.stage
        cost, terminal = objective.stage_cost(stage), objective.terminal_cost(stage)
        made = np.zeros(len(horizon)) if cost is None else horizon.hours * cost
        if terminal is not None:
            made[horizon.leaves] += terminal
        return np.asarray(made)

    @property
    def scenario_costs(self) -> dict[str, float]:
        """Cost of each scenario in $, from the measured state to the end of the horizon."""
        paths = zip(self.horizon.scenarios, self.horizon.paths, strict=True)
        return {name: float(self.node_costs[path].sum()) for name, path in paths}

    @cached_property
    def horizon(self) -> Horizon:
        """The nodes in time that the plan covers, without contingencies."""
        whole, skipped = self.request.horizon.regular, self.solution.skipped
        return Horizon.chain(len(whole) - skipped, whole.base) if skipped else whole

    @property
    def nodes(self) -> Horizon:
        """The nodes of the plan with contingencies."""
        return self.request.horizon if self.request.horizon.out else self.horizon

    @cached_property
    def stage(self) -> NumericStage:
        """The published quantities of the plan as numbers in per unit, for evaluating costs."""
        published = {key: value for key, value in self.quantities().items() if self.model.has(key[1])}
        return NumericStage(self.network, self.model.stage.step, published, self.model.costed, self.horizon)

    def quantities(self) -> dict[tuple[str, str], Array]:
        """Return all published quantities in per unit, ``(items, stages)`` by ``(kind, name)``.

        Injections by devices of other packages are ``("bus", "<kind>_p")`` and ``_q``.
        """
        named = {**self.model.published, **self.model.reported}
        values = {(p.kind, name): self.solution.value(name) for name, p in named.items()}
        for injection in self.model.injections:
            power = injection.at_buses(self.solution, self.network)
            values["bus", injection.name] = values.get(("bus", injection.name), 0.0) + power
        known = {key: self._regular(array) for key, array in values.items()}
        return {**known, **self._following(known)} if self.optimal else self._held(known)

    def _following(self, known: Mapping[tuple[str, str], Array]) -> dict[tuple[str, str], Array]:
        """Return the quantities that follow from others; see :meth:`Device.follow`."""
        stage = NumericStage(self.network, self.model.stage.step, known, self.model.costed, self.horizon)
        devices = self.model.devices
        return {(d.component.kind, name): values for d in devices for name, values in d.follow(stage).items()}

    def _regular(self, values: Array) -> Array:
        """Return values without those of contingencies, which come last."""
        return values[:, : len(self.horizon)]

    def _held(self, values: dict[tuple[str, str], Array]) -> dict[tuple[str, str], Array]:
        """Return the values if the plan is optimal, else NaN in their place."""
        return values if self.optimal else {key: np.full_like(value, np.nan) for key, value in values.items()}

    def exceeded(self) -> dict[tuple[str, str], Array]:
        """Return the limit violations of an elastic plan, p.u., in the form of :meth:`quantities`."""
        network = self.network
        stages = self.stages + self.request.horizon.contingencies.size
        return {
            (slack.kind, name): self._regular(
                slack.spread(self.solution.value(name), len(network.tables[slack.kind]), stages)
            )
            for name, slack in self.model.slacks.items()
            if slack.kind in network.tables and name not in self.model.reported
        }

    @property
    def short(self) -> bool:
        """Whether an elastic plan has a shortfall."""
        slacks = self.model.slacks if self.optimal else ()
        return any(np.abs(self.solution.value(name)).max(initial=0.0) > LEAST for name in slacks)

    @cached_property
    def shortages(self) -> tuple[Shortage, ...]:
        """Shortfalls of an elastic plan, the most expensive first; empty if every limit is hard.

        With the reported amounts added, the problem has a solution. Load that is shed only because it
        shares a load with power that is lacking is not reported; to find it, one more problem is solved.
        """
        prices = self.problem.elastic
        if prices is None or not self.short:
            return ()
        slacks = self.model.slacks.values()
        times = self.problem.times(self.time, self.nodes)
        return shortages(slacks, shortfall_due(self), self.whole, prices, self.nodes, times)

    @property
    def penalty(self) -> float:
        """Penalty of the shortfalls of an elastic plan, $; 0 if every limit is hard."""
        return _penalty(self.model, self.solution)

    @property
    def program_penalty(self) -> float:
        """Penalty of the whole program, $, with stages before a plan that ends with the data."""
        return _penalty(self.model, replace(self.solution, skipped=0))

    def next_state(self, happened: Mapping[tuple[str, str], Array] | None = None) -> dict[str, Array]:
        """Return the states after the first stage, in physical units.

        Parameters
        ----------
        happened
            Realised per-unit values ``(items,)`` of the first stage by ``(kind, name)``, if they differ
            from the plan. A dispatch that is committed one stage ahead stays as planned.

        Raises
        ------
        ModelError
            The plan is not optimal.
        """
        if not self.optimal:
            raise ModelError(f"the plan from step {self.time} is {self.status}: it has no next state")
        out = {}
        delayed, planned = self.model.delay == 1, self.quantities()
        after = np.flatnonzero(self.horizon.parent == 0)  # siblings share what is committed
        for state in self.model.states.values():
            name = f"{state.name}_next" if state.role == "stock" else state.name
            committed = delayed and state.role == "dispatch"
            if happened is not None and not committed:
                values = happened[state.kind, name]
            elif not committed or self.stages == 1 < self.problem.stages:
                values = planned[state.kind, name][:, 0]
            elif not after.size:
                raise IncompatibleError("generator_delay = 1: a receding horizon needs at least 2 stages")
            else:
                values = self.solution.value(name)[:, after[0]]
            out[state.name] = values * scale(state.unit, self.network.base_mva)
        return out

    def stocks(self) -> dict[str, Array]:
        """Return the stored quantities at the start of the plan, in physical units."""
        return {
            state.name: self._points(state.name)[:, 0] * scale(state.unit, self.network.base_mva)
            for state in self.model.states.values()
            if state.role == "stock"
        }

    def _points(self, name: str) -> Array:
        return self.solution.variable(name)

    @cached_property
    def data(self) -> xr.Dataset:
        """All published quantities and the demand, in physical units, over ``time`` and components.

        Over ``node`` in place of time if the horizon is a tree, with the coordinates ``time``, ``parent``,
        ``probability`` and ``scenario``; see :meth:`scenario`. Stages of different lengths have the
        coordinate ``hours``.
        """
        made = self._labelled.dataset()
        return made if self.horizon.is_chain else _over_nodes(made, self.horizon)

    def record(self) -> dict[str, Any]:
        """Return what a report states of the plan: status, cost, effort, check and outages."""
        from opfmodel.check import check

        solution, made = self.solution, dict[str, Any]()
        if self.optimal and self.horizon.is_chain:
            found = check(
                self.problem.network, self.trajectory(self.horizon.scenarios[0]), self.problem.profiles
            )
            made = {
                "max_violation": found.max_violation,
                "violations": found.as_dict(),
                "unchecked": list(found.unchecked),
            }
        return {
            "status": self.status,
            "termination": self.termination,
            "cost": self.objective if self.optimal else None,
            "currency": self.network.currency,
            "steps": self.stages,
            "iterations_mean": solution.iterations,
            "solve_seconds_mean": solution.seconds,
            "contingencies": [
                {"out": ", ".join(names), "status": "included"}
                for names in dict.fromkeys(self.request.horizon.out)
                if names
            ],
            "notes": list(self.problem.notes),
            "versions": versions(),
            **made,
        }

    def summary(self) -> pd.DataFrame:
        """Return what each unit does over the plan, as a pandas table indexed by name.

        Columns are ``kind``, ``bus``, ``mean_mw``, ``min_mw``, ``max_mw``, ``energy_mwh``, ``price`` (mean at
        its bus, weighted by energy, $/MWh) and ``stages_at_limit``; powers are those into the grid. If there
        are several scenarios, of the most probable one.
        """
        import pandas as pd

        rows = units(self.trajectory(self.likeliest))
        return pd.DataFrame(rows, columns=Unit._fields).set_index("name")

    @property
    def likeliest(self) -> str:
        """The most probable scenario."""
        shares = self.horizon.probability[self.horizon.leaves]
        return self.horizon.scenarios[int(np.argmax(shares))]

    def save(self, folder: str | Path) -> None:
        """Write ``trajectories.nc`` and ``summary.json`` to a folder, from which ``opfmodel.load_run`` reads.

        Of the most probable scenario, if there are several.

        Raises
        ------
        ResultError
            The folder cannot be written.
        """
        save(self.scenario(self.likeliest) if self.optimal else None, self.record(), Path(folder))

    def futures(self) -> Scenarios:
        """Return probability, cost and trajectories of each scenario; empty if the horizon is a chain."""
        if self.horizon.is_chain:
            return {}
        shares = self.horizon.probability[self.horizon.leaves]
        costs = self.scenario_costs
        return {
            name: (float(share), costs[name], self.scenario(name))
            for name, share in zip(self.horizon.scenarios, shares, strict=True)
        }

    @property
    def _labelled(self) -> Labelled:
        """The quantities and the demand over the beginnings of the stages, also of a tree."""
        described = self.problem.described
        values = {
            name: (kind, *described[name], array)
            for (kind, name), array in {**self.quantities(), **self.prices()}.items()
        }
        if self.request.out:
            for kind in OUTAGES:
                table = self.network.tables[kind.kind]
                status = np.broadcast_to(table.status, (len(table), self.stages))
                values[f"{kind.kind}_status"] = (kind.kind, *STATUS, status)
        made = labelled(self.network, values, self._moments)
        made.attrs |= {
            "network": self.network.name,
            "formulation": self.problem.formulation.name,
            "objective": type(self.problem.objective).__name__,
            "status": self.status,
            "step_hours": self.problem.step,
            "cost": self.objective,
        }
        made.attrs |= self.relaxation
        if not self.horizon.is_even:
            about = {"units": "h", "long_name": "length of the stage"}
            made.coords["hours"] = Variable(("time",), self.horizon.hours, about)
        return made

    def scenario(self, name: str) -> xr.Dataset:
        """Return the quantities of one scenario over ``time``, from the measured state to the end.

        Raises
        ------
        ModelError
            There is no scenario of that name.
        """
        made = self.trajectory(name)
        return self.data if self.horizon.is_chain else made.dataset()

    def trajectory(self, name: str) -> Labelled:
        """Return what :meth:`scenario` does without xarray, as :func:`opfmodel.check.check` takes it, too."""
        horizon = self.horizon
        if name not in horizon.scenarios:
            raise ModelError(f"scenario {name!r}: no such scenario; {nearest(name, horizon.scenarios)}")
        if horizon.is_chain:
            return self._labelled
        made = self._labelled.take("time", horizon.paths[horizon.scenarios.index(name)])
        made.attrs |= {"scenario": name, "cost": self.scenario_costs[name]}
        return made

    def price(self, name: str) -> Array:
        """Return a shadow price in $ and per unit, ``(items, stages)``: ``lmp``, ``reserve_price``, ..."""
        values = self.model.prices[name].values(self.solution, self.whole, self.nodes)
        return self._regular(values)

    def contingency_prices(self) -> Array:
        """Return what one more MW of demand after each contingency alone costs, $/MWh, by bus.

        One column per contingency of the horizon of the request; they add up to the ``security_price``.
        """
        horizon, model = self.request.horizon, self.model
        after = horizon.contingencies
        price = -self.solution.dual("p_balance")[model.zones][:, after] / self.network.base_mva
        return np.asarray(price / horizon.influence[after])

    def prices(self) -> dict[tuple[str, str], Array]:
        """Return all shadow prices by ``(kind, name)``; see :meth:`price`."""
        return self._held({(price.kind, name): self.price(name) for name, price in self.model.prices.items()})

    @cached_property
    def relaxation(self) -> dict[str, float]:
        """Deviation of the plan from the equations that its formulation relaxes, by name.

        For ``soc``, the ``largest_cone_slack`` in p.u. and the ``largest_angle_mismatch`` around loops
        in degrees: the relaxation is exact if both vanish. Empty for formulations that relax
        nothing, for secure plans, and for plans that are not optimal.
        """
        if not self.optimal or self.request.horizon.out:
            return {}
        return self.problem.formulation.relaxation(self.solution, self.network)

    def relaxation_gap(self, exact: Plan | float) -> float:
        """Return the relative gap to an exact formulation, ``(exact - this) / |exact|``."""
        other = exact.objective if isinstance(exact, Plan) else float(exact)
        return (other - self.objective) / abs(other)

    @property
    def times(self) -> Array:
        """Hours at which the stages begin, counted from step 0."""
        return self._moments.hours

    @property
    def _moments(self) -> Times:
        return self.problem.times(self.time, self.horizon)


def _penalty(model: Model, solution: Solution) -> float:
    amounts = (solution.value(name) for name in penalty_outputs(model))
    return sum(float(np.maximum(values, 0.0).sum()) for values in amounts)  # solvers leave -1e-8 of each


def _over_nodes(data: xr.Dataset, horizon: Horizon) -> xr.Dataset:
    """Turn the dimension ``time`` into nodes of a tree."""
    of_node = {
        "node": np.arange(len(horizon)),
        "parent": ("node", horizon.parent, {"long_name": "node before, -1 for the measured state"}),
        "probability": ("node", horizon.probability),
        "scenario": ("node", np.array(horizon.scenario, dtype=str)),
    }
    loose = data.rename_dims(time="node").reset_index("time")
    return loose.assign_coords(of_node)


def penalty_outputs(model: Model) -> list[str]:
    """Return the names of the program outputs that hold the penalties."""
    return [f"penalty {number}" for number in range(1, len(model.penalties) + 1)]


def status_word(status: SolutionStatus) -> str:
    """Return a status as the command line and results spell it."""
    return "stopped" if status is SolutionStatus.NONE else status.value.replace(" ", "_")
