"""The sequence of single-stage optima: operation without storage and ramps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import Times
from opfmodel.data.series import Profiles
from opfmodel.errors import IncompatibleError, ModelError
from opfmodel.network.arrays import per_unit
from opfmodel.network.component import Component
from opfmodel.network.components import Generator, Storage
from opfmodel.network.network import Network
from opfmodel.objectives.base import Objective
from opfmodel.objectives.setpoint_tracking import Setpoints
from opfmodel.plan.multistage import MultiStage
from opfmodel.plan.positions import without_moves
from opfmodel.plan.result import Plan

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["SingleStageSequence", "single_stage_sequence"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class SingleStageSequence:
    """The optimal power flow of each step on its own, (x_s, u_s)(d).

    Attributes
    ----------
    plan
        Optima of the distinct steps, as the stages of one plan.
    stage
        Stage of the plan for each step.
    times
        Beginnings of the steps.
    """

    plan: Plan
    stage: Index
    times: Times
    _network: Network

    @property
    def optimal(self) -> bool:
        """Whether every step has an optimum."""
        return self.plan.optimal

    @cached_property
    def cost_rate(self) -> Array:
        """Stage cost of each step, $/h."""
        cost = self.plan.problem.objective.stage_cost(self.plan.stage)
        return np.zeros(self.stage.size) if cost is None else np.asarray(cost, dtype=float)[self.stage]

    @property
    def cost(self) -> float:
        """Total cost of all steps, $."""
        return float(self.cost_rate.sum()) * self.times.step

    @cached_property
    def data(self) -> xr.Dataset:
        """Quantities and demand of all steps in physical units."""
        return self.plan.data.isel(time=self.stage).assign_coords(time=self.times.coordinate())

    def setpoints(self, share: float = 0.5) -> Setpoints:
        """Return set-points for :class:`opfmodel.SetpointTracking`.

        Parameters
        ----------
        share
            Stored energy as a share of the capacity; storage power is zero.
        """
        data = self.data
        values: dict[str, npt.ArrayLike] = {}
        for quantity in ("pg", "qg"):
            if quantity in data:
                columns = data[quantity].transpose("generator", "time").values
                names = data["generator"].values
                values |= {f"{n}.{quantity}": row for n, row in zip(names, columns, strict=True)}
        for name in per_unit(self._network).storage.names:
            energy = self._network.of(Storage)[name].energy
            values |= {f"{name}.e": share * energy, f"{name}.ps": 0.0, f"{name}.qs": 0.0}
        return Setpoints(values)


def single_stage_sequence(problem: MultiStage, steps: int, start: int = 0) -> SingleStageSequence:
    """Solve every step on its own, without storage, ramps, moves that cost, reserves and custom constraints.

    All steps are stages of one program without coupling; steps with equal data are solved once.

    Parameters
    ----------
    problem
        The problem that provides the network, profiles, formulation and objective.
    steps, start
        Number of steps, and the first step.

    Raises
    ------
    ModelError
        A step has no solution (the message names the step and the reason), or a component other than
        a storage carries something from step to step.
    """
    left_out: list[type[Component]] = [
        Storage,
        *(device.component for device in problem.devices if not device.physical),
    ]
    network = _alone(problem.network, left_out)
    kept = Profiles(
        {key: v for key, v in problem.profiles.items() if key.component in network and key.field != "ramp"},
        problem.profiles.calendar,
    )
    window = kept.steps(slice(start, start + steps))
    if window.length is not None and window.length < steps:
        raise ModelError(
            f"{steps} single stages from step {start} need time series of {start + steps} values; "
            f"the shortest has {kept.length}"
        )
    own = _of_objective(problem.objective, network, start, steps)
    rows = [*window.values(), *(row for values in own.values() for row in values)]
    first, stage = _distinct(rows, steps)

    def solve(chosen: Index) -> Plan:
        stages = chosen.size
        alone = MultiStage(
            network,
            stages,
            problem.step,
            formulation=problem.formulation,
            objective=problem.objective,
            profiles=window.steps(chosen),
            devices=problem.devices,
            solver=problem.solver,
            options=problem.options,
        )
        carried = [
            state
            for state in alone.model.states.values()
            if state.role == "stock" and len(alone.arrays.tables[state.kind])
        ]
        if steps > 1 and carried:
            raise IncompatibleError(
                f"single-stage optima: {carried[0].kind} carries its {carried[0].name} from stage to stage; "
                "only storages may do so"
            )
        return alone.solve(expected={key: values[:, chosen] for key, values in own.items()})

    plan = solve(first)
    if not plan.optimal:
        for step in first:  # find the step at fault
            alone = solve(np.array([step]))
            if not alone.optimal:
                raise ModelError(
                    f"single-stage optimum of step {start + step}: {alone.status} ({alone.termination})"
                )
        raise ModelError(f"single-stage optima: {plan.status} ({plan.termination})")
    times = Times(np.arange(steps), problem.step, window.calendar)
    return SingleStageSequence(plan, stage, times, problem.network)


def _alone(network: Network, left_out: Sequence[type[Component]]) -> Network:
    """Return the network without some kinds of components, ramps, costs of moves and attached series."""
    alone = without_moves(network)
    alone.attach(Profiles())
    for kind in left_out:
        for name in network.of(kind):
            alone.remove(name)
    for name, generator in network.of(Generator).items():
        if generator.ramp is not None:
            alone.update(name, ramp=None)
    return alone


def _of_objective(
    objective: Objective, network: Network, start: int, steps: int
) -> dict[tuple[str, str], Array]:
    """Return the time-varying data of the objective from a step on, in per unit."""
    own = {}
    for key, values in objective.series(per_unit(network)).items():
        if values.shape[1] == 1:
            continue
        if values.shape[1] < start + steps:
            raise ModelError(
                f"{type(objective).__name__}: {key[1]} has {values.shape[1]} values; "
                f"{steps} single stages from step {start} need {start + steps}"
            )
        own[key] = values[:, start : start + steps]
    return own


def _distinct(rows: Sequence[Array], steps: int) -> tuple[Index, Index]:
    """Return the first step of each distinct set of data, and the position of each step among these."""
    if not rows:
        return np.zeros(1, dtype=np.intp), np.zeros(steps, dtype=np.intp)
    columns = np.vstack(rows)
    _, first, position = np.unique(columns, axis=1, return_index=True, return_inverse=True)
    return first, position.ravel()
