"""The command that solves one problem."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from opfmodel.cli import show
from opfmodel.cli.options import FILE, JSON, LOSSY, ON_INFEASIBLE, SET, VARIANT, VERBOSE
from opfmodel.cli.output import print_json, solver_output
from opfmodel.cli.reading import (
    check_on_infeasible,
    is_scenario,
    read_network_file,
    read_scenario,
    refuse_lossy,
)
from opfmodel.errors import OpfmodelError

if TYPE_CHECKING:
    from opfmodel.model import Elastic
    from opfmodel.plan import MultiStage

__all__ = ["solve"]


def solve(
    file: FILE,
    formulation: Annotated[
        str | None, typer.Option(help="Formulation, such as ac or dc; see 'opfmodel list'.")
    ] = None,
    solver: Annotated[str | None, typer.Option(help="Back end or solver, such as auto or ipopt.")] = None,
    horizon: Annotated[int | None, typer.Option(help="Number of stages.")] = None,
    default_cost: Annotated[
        float | None, typer.Option(help="Cost in $/MWh of generators without cost data in a network file.")
    ] = None,
    lossy: LOSSY = False,
    variant: VARIANT = None,
    set_: SET = None,
    on_infeasible: ON_INFEASIBLE = None,
    json_: JSON = False,
    verbose: VERBOSE = False,
) -> int:
    """Solve one optimal power flow.

    A scenario is solved for the first plan of its controller, with a perfect forecast.
    """
    from opfmodel.check import check

    check_on_infeasible(on_infeasible)
    elastic = on_infeasible == "elastic"
    chosen = {"formulation": formulation, "solver": solver, "horizon": horizon}
    with solver_output(verbose):
        problem, initial, prices = _problem(
            file, {k: v for k, v in chosen.items() if v is not None}, default_cost, lossy, variant, set_
        )
        problem.verbose = verbose
        plan = problem.solve(initial=initial)
        diagnosis = []
        if not plan.optimal and elastic:
            diagnosis = [str(s) for s in problem.elastic_twin(prices).solve(initial=initial).shortages]
    report = check(problem.network, plan.data, problem.profiles) if plan.optimal else None
    if json_:
        print_json(
            {
                "status": plan.status,
                "termination": plan.termination,
                "objective": plan.objective if plan.optimal else None,
                "currency": problem.network.currency,
                "build_seconds": problem.build_seconds,
                "solve_seconds": plan.solution.seconds,
                "iterations": plan.solution.iterations,
                "max_violation": None if report is None else report.max_violation,
                "violations": {} if report is None else report.as_dict(),
                "unchecked": [] if report is None else list(report.unchecked),
                "relaxation": plan.relaxation,
                "formulation": problem.formulation.name,
                "solver": plan.solution.solver,
                "variables": plan.solution.program.n_variables,
                "rows": plan.solution.program.n_rows,
                "notes": list(problem.notes),
                "diagnosis": {"0": diagnosis} if diagnosis else {},  # by step, as for a closed loop
            }
        )
    else:
        show.plan(plan, report, diagnosis, elastic)
    return 0 if plan.optimal else 1


def _problem(
    file: Path,
    chosen: Mapping[str, Any],
    default_cost: float | None,
    lossy: bool,
    variant: str | None,
    overrides: list[str] | None,
) -> tuple[MultiStage, Mapping[str, Any] | None, Elastic | None]:
    """The problem of a file, its initial state and the penalty prices of its elastic twin."""
    from opfmodel.plan import MultiStage

    if is_scenario(file):
        if default_cost is not None:
            raise OpfmodelError(
                f"{file}: --default-cost applies to network files only; "
                "use --set network.default_cost, a cost such as {c1: 30}"
            )
        refuse_lossy(file, lossy)
        changes = {f"controller.{key}": (f"--{key}", value) for key, value in chosen.items()}
        scenario = read_scenario(file, variant, overrides, changes)
        return scenario.problem, scenario.initial(), scenario.elastic
    if variant is not None or overrides:
        raise OpfmodelError(f"{file}: --variant and --set apply to scenario files (.yaml) only")
    return MultiStage(read_network_file(file, default_cost, lossy), **chosen), None, None
