"""Finding, without a solve, what a run of a scenario would refuse before its first one."""

from __future__ import annotations

from dataclasses import replace

from opfmodel.errors import IncompatibleError, ModelError
from opfmodel.horizon import Horizon
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.objectives.setpoint_tracking import Setpoints
from opfmodel.plan import MultiStage
from opfmodel.scenario.parts import planned_objective
from opfmodel.scenario.scenario import Scenario
from opfmodel.simulation import check_first_stage
from solvers import SolverError

__all__ = ["rehearse"]


def rehearse(scenario: Scenario) -> None:
    """Compile one stage of the problem of a scenario, prepare its back end, and ask for forecasts.

    Formulation, objective, devices, constraints and back end of one stage are those of the whole
    horizon, so that a combination that cannot be compiled is found within a fraction of the time. The
    forecasts of the first and of the last step are made.

    Raises
    ------
    ScenarioError
        A run would be refused; the message gives the position of every part that cannot be used.
    """
    scenario = replace(scenario, document=scenario.document.collecting())
    document, faults = scenario.document, scenario.document.faults
    objective = planned_objective(
        document,
        scenario.settings,
        scenario.network,
        scenario.cost,
        scenario.grid,
        lambda: _stand_in(scenario.problem.arrays),
    )
    problem = scenario.problem.variant(elastic=None, objective=objective)
    with faults, document.located("time", "steps"):
        problem.check_lengths(scenario.steps, scenario.cost)
    with faults, document.located("controller"):
        check_first_stage(problem)
    with faults:
        _compile(scenario, problem.variant(elastic=None, horizon=Horizon.chain(1, problem.step)))
    if scenario.starts_from_single_stage:
        with faults, document.located("cost"):
            scenario.single_stage().compile()
    with faults:
        scenario.check_forecast()
    faults.settle()


def _compile(scenario: Scenario, problem: MultiStage) -> None:
    """Compile a problem; an error has the position of the part of the controller that it is about."""
    document = scenario.document
    planned = ("controller", "objective") if scenario.settings.controller.objective is not None else ("cost",)
    try:
        problem.compile()
    except SolverError as error:
        raise document.error(("controller", "solver"), str(error), error) from error
    except IncompatibleError as error:
        place = error.key if error.key[:1] == ("network",) else planned  # of a component
        raise document.error(place, str(error), error) from error
    except ModelError as error:
        raise document.error(("controller",), str(error), error) from error


def _stand_in(network: PerUnitNetwork) -> Setpoints:
    """Return set-points for the quantities of single-stage optima, without solving for these."""
    quantities = {"generator": ("pg", "qg"), "storage": ("e", "ps", "qs")}
    return Setpoints(
        {
            f"{name}.{quantity}": 0.0
            for kind, named in quantities.items()
            for name in network.tables[kind].names
            for quantity in named
        }
    )
