"""The command that solves one problem."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from opfmodel.cli import show
from opfmodel.cli.options import FILE, JSON, LOSSY, ON_INFEASIBLE, SET, VARIANT, VERBOSE
from opfmodel.cli.output import print_json, print_line, solver_output
from opfmodel.cli.reading import check_on_infeasible, controller_of

if TYPE_CHECKING:
    from opfmodel.check import Report
    from opfmodel.plan import Plan
    from opfmodel.plan.commitment import Commitment
    from opfmodel.simulation import Controller

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
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for trajectories with prices, a summary and a table of the stages (CSV)."),
    ] = None,
    bound: Annotated[
        bool, typer.Option("--bound", help="Certify the plan: a lower bound on its cost from a relaxation.")
    ] = False,
    json_: JSON = False,
    verbose: VERBOSE = False,
) -> int:
    """Solve one optimal power flow.

    A scenario is solved for the first plan of its controller, with a perfect forecast unless its futures are
    drawn from its own. A bound is the optimum of a relaxation of the same problem; if that is proven
    infeasible, so is the problem.
    """
    from opfmodel.plan.attempt import attempts

    check_on_infeasible(on_infeasible)
    if out is not None:
        _check_out(out)
    elastic = on_infeasible == "elastic"
    chosen = {"formulation": formulation, "solver": solver, "horizon": horizon}
    with solver_output(verbose):
        controller, initial = controller_of(
            file, {k: v for k, v in chosen.items() if v is not None}, default_cost, lossy, variant, set_
        )
        problem = controller.problem
        problem.verbose = verbose
        asked = controller.request(0)
        if bound:
            from opfmodel.analysis.bound import certify, check_bounded

            check_bounded(problem)
        commitments: list[Commitment] = []
        if controller.commit == "milp":
            from opfmodel.plan.commitment import plan_with_commitment

            plan, commitments = plan_with_commitment(problem, initial=initial)
            problem = plan.problem
        else:
            plan = problem.solve(initial=initial, **asked)
        certificate = certify(plan) if bound else None
        if certificate is not None:
            plan = certificate.plan
        diagnosed = plan
        if not plan.optimal and elastic:
            diagnosed = problem.elastic_twin(controller.elastic).solve(initial=initial, **asked)
        diagnosis = [str(shortage) for shortage in diagnosed.shortages]
    report = _verified(controller, plan) if plan.optimal else None
    if out is not None:
        plan.save(out)
        if plan.optimal:
            plan.to_csv(out / "stages.csv")
    if json_:
        print_json(
            {
                "status": plan.status,
                "termination": plan.termination,
                "objective": plan.objective if plan.optimal else None,
                "expected_cost": plan.expected_cost if plan.optimal else None,
                "scenario_costs": plan.scenario_costs if plan.optimal and controller.scenarios else {},
                "commitments": [commitment.as_dict() for commitment in commitments],
                "bound": None if certificate is None else certificate.as_dict(),
                "currency": problem.network.currency,
                "build_seconds": problem.build_seconds,
                "solve_seconds": plan.solution.seconds,
                "iterations": plan.solution.iterations,
                "attempts": [asdict(attempt) for attempt in attempts(plan)],
                "max_violation": None if report is None else report.max_violation,
                "violations": {} if report is None else report.as_dict(),
                "unchecked": [] if report is None else list(report.unchecked),
                "relaxation": plan.relaxation,
                "formulation": problem.formulation.name,
                "solver": plan.solution.solver,
                "variables": plan.solution.program.n_variables,
                "rows": plan.solution.program.n_rows,
                "notes": list(problem.notes),
                "results": None if out is None else str(out),
                "diagnosis": {"0": diagnosis} if diagnosis else {},  # by step, as for a closed loop
            }
        )
    else:
        show.plan(plan, report, diagnosis, elastic, certificate, commitments)
        if out is not None:
            print_line(f"results: {out}")
    return 0 if plan.optimal else 1


def _check_out(folder: Path) -> None:
    """Raise an error unless a plan can be kept in a folder, where it would replace no run."""
    from opfmodel.errors import ResultError
    from opfmodel.results.store import check_writable, read_summary
    from opfmodel.simulation.checkpoint import Checkpoint
    from opfmodel.simulation.folder import CHECKPOINT

    known = read_summary(folder) or {}
    if "inputs" in known or Checkpoint(folder / CHECKPOINT).exists:
        raise ResultError(
            f"--out {folder}: holds a closed loop, which a plan must not replace; choose another"
        )
    check_writable(folder)


def _verified(controller: Controller, plan: Plan) -> Report:
    """The independent check of a plan; of the scenario with the largest violation, if there are several."""
    from opfmodel.check import check

    problem, futures = plan.problem, controller.futures
    series = [problem.profiles] if futures is None else futures.series
    reports = [
        check(problem.network, plan.trajectory(name), own)
        for name, own in zip(plan.horizon.scenarios, series, strict=True)
    ]
    return max(reports, key=lambda report: report.max_violation)
