"""How each command prints its result."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from opfmodel.cli.output import print_line, print_notes, print_pairs, print_table, remark

if TYPE_CHECKING:
    from opfmodel.analysis.bound import Certificate
    from opfmodel.check import Report
    from opfmodel.plan import Plan
    from opfmodel.plan.commitment import Commitment
    from opfmodel.plugins.catalogue import Entry
    from opfmodel.simulation import Run
    from opfmodel.study import Group, Outcome
    from opfmodel.study.comparison import Comparison

__all__ = ["comparisons", "entries", "plan", "run", "study_outcome", "study_statistics", "study_table"]

_UNITS, _LIMITS = 10, 6  # that the overview of a plan names
_TOLERATED = 1e-5  # p.u. on the scale of the system, or radians
_ELASTIC = "hint: --on-infeasible elastic reports which limits cannot be met, where and when"


def plan(
    solved: Plan,
    report: Report | None,
    diagnosis: list[str],
    elastic: bool,
    certificate: Certificate | None = None,
    commitments: Sequence[Commitment] = (),
) -> None:
    """Print the results of a plan, and the diagnosis of an infeasible problem.

    Parameters
    ----------
    elastic
        Whether the user asked for the diagnosis.
    certificate
        What is proven about the plan, if the user asked for it.
    commitments
        The commitments of units that led to it.
    """
    problem, solution = solved.problem, solved.solution
    size = solution.program
    iterations = (
        "iterations not reported" if solution.iterations is None else f"{solution.iterations} iterations"
    )
    print_notes(problem.notes)
    print_pairs(
        {
            "status": solved.status if solved.optimal else f"{solved.status}: {solved.termination}",
            "objective": f"{solved.objective:,.4f} {solved.network.currency}" if solved.optimal else "none",
            **({} if certificate is None else _bounded(certificate)),
            **({"commitment": _committed(commitments[-1])} if commitments else {}),
            "formulation": problem.formulation.name,
            "size": f"{size.n_variables:,} variables, {size.n_rows:,} rows",
            "solver": f"{solution.solver}, {iterations}{_failed(solved)}",
            "time": f"{problem.build_seconds:.3f} s build, {solution.seconds:.3f} s solve",
            **({} if report is None else _verified(report)),
            **{key.replace("_", " "): f"{value:.1e}" for key, value in solved.relaxation.items()},
        }
    )
    _diagnosis(diagnosis)
    if solved.infeasible and not elastic:
        print_line(_ELASTIC)
    if solved.optimal:
        _overview(solved)


def _overview(solved: Plan) -> None:
    """Print what the largest units do, the range of the prices and the limits that bind."""
    from opfmodel.results.overview import limited, price_range, units

    data = solved.trajectory(solved.likeliest)
    every = units(data)
    shown = sorted(every, key=lambda unit: -abs(unit.energy_mwh))[:_UNITS]
    single = solved.stages == 1
    print_line("")
    print_table(
        ["unit", "bus", *(["MW"] if single else ["mean MW", "min", "max"]), "price"],
        [
            [
                unit.name,
                unit.bus,
                *([f"{unit.mean_mw:,.2f}"] if single else [f"{mw:,.2f}" for mw in unit[3:6]]),
                "" if unit.price != unit.price else f"{unit.price:,.2f}",
            ]
            for unit in (each for each in every if each in shown)
        ],
        numbers=True,
    )
    if len(every) > len(shown):
        print_line(f"and {len(every) - len(shown)} more units")
    lines = {}
    if (prices := price_range(data)) is not None:
        (least, cheap), mean, (most, dear) = prices
        low, middle, high = (f"{round(price, 2) + 0.0:,.2f}" for price in (least, mean, most))
        unit = f"{solved.network.currency}/MWh"
        lines["prices"] = f"{low} {unit} at bus {cheap} to {high} at bus {dear}, mean {middle}"
    bound = limited(data)
    texts = [
        f"{each.component} {each.quantity} {each.side}" + ("" if single else f" ({each.stages})")
        for each in bound[:_LIMITS]
    ]
    more = f" and {len(bound) - _LIMITS} more" if len(bound) > _LIMITS else ""
    lines["at limits"] = f"{', '.join(texts)}{more}" if texts else "none"
    print_line("")
    print_pairs(lines)


def _failed(solved: Plan) -> str:
    """Return the solves that found nothing before a plan was found."""
    before = [
        f"{each.solver} ({each.termination.value}, {each.iterations} iterations)"
        for each in solved.solution.failed
    ]
    return f", after {' and '.join(before)}" if before else ""


def _committed(commitment: Commitment) -> str:
    """Return a commitment on one line."""
    if not commitment.found:
        return f"{commitment.status}: {commitment.termination}"
    margin = f", capacity {commitment.margin:+.0%}" if commitment.margin else ""
    starts = sum(commitment.starts.values())
    return f"{len(commitment.starts)} units, {starts} starts, gap {commitment.gap:.1e}{margin}"


def run(done: Run, summary: Mapping[str, Any], report: Report | None, folder: Path, elastic: bool) -> None:
    """Print the results of a closed loop, and the diagnoses of its infeasible problems.

    Parameters
    ----------
    elastic
        Whether infeasible problems were solved with soft limits.
    """
    violation, cost = summary["max_violation"], summary["cost"]
    mean, largest = summary["solve_seconds_mean"], summary["solve_seconds_max"]
    currency = done.problem.network.currency
    print_notes(done.problem.notes)
    print_pairs(
        {
            "scenario": summary["scenario"],
            "status": "done" if done.status == "done" else f"{done.status}: {done.termination}",
            "cost": "none" if cost is None else f"{cost:,.2f} {currency} in {summary['steps']} steps",
            "solve time": f"{mean:.3f} s mean, {largest:.3f} s maximum",
            "iterations": _mean(summary["iterations_mean"]),
            "max violation": "not checked" if violation is None else f"{violation:.1e} p.u.",
            **({} if report is None else _exceeded(report)),
            **_measured(summary),
            **_unchecked(summary["unchecked"]),
            "results": str(folder),
        }
    )
    for step, sentences in summary["diagnosis"].items():
        _diagnosis(sentences, f"plan at step {step}")
    if done.infeasible and not elastic:
        print_line(_ELASTIC)


def comparisons(compared: list[Comparison]) -> None:
    """Print the costs J_e, J_s, J_t and J_b side by side."""
    from opfmodel.study.comparison import COSTS, rows, unit

    print_table([unit(compared), *COSTS], rows(compared), numbers=True)


def entries(catalogue: list[Entry]) -> None:
    """Print what is installed."""
    lines = [
        (e.sort, e.name, e.origin, f"{e.summary}\n  {', '.join(e.options)}" if e.options else e.summary)
        for e in catalogue
    ]
    print_table(["kind", "name", "origin", "description and options"], lines, prose=True)


def study_outcome(name: str, outcome: Outcome) -> None:
    """Print the progress of a study."""
    counts = {"done": outcome.done, "failed": outcome.failed, "skipped": outcome.skipped}
    if outcome.waiting:
        counts["waiting"] = outcome.waiting
    status = "interrupted" if outcome.interrupted else "done" if outcome.complete else "incomplete"
    for failed, error in outcome.failures.items():
        remark(f"failed: {failed}: {error}")
    print_pairs(
        {
            "study": name,
            "status": status,
            "runs": f"{outcome.total}: " + ", ".join(f"{count} {what}" for what, count in counts.items()),
            "time": f"{outcome.seconds:.1f} s",
            "table": str(outcome.table),
        }
    )


def study_table(rows: list[dict[str, Any]], columns: list[str]) -> None:
    """Print selected columns of the table of a study."""
    print_table(columns, [[_cell(row.get(name)) for name in columns] for row in rows])


def study_statistics(groups: list[Group], columns: list[str]) -> None:
    """Print a line per group of runs and figure, and which runs failed."""
    axes = [name for name in groups[0].labels if len({repr(group.labels[name]) for group in groups}) > 1]
    lines = []
    for group in groups:
        runs = group.done + len(group.failed) + group.waiting
        point = [_cell(group.labels[name]) for name in axes]
        for name in columns:
            if found := group.figures.get(name):
                numbers = (found.mean, found.deviation, found.q05, found.q50, found.q95)
                count = f"{found.runs}" if found.runs == runs else f"{found.runs} of {runs}"
                lines.append([*point, name, count, *map(_cell, numbers)])
        if not group.done:
            lines.append([*point, "", f"0 of {runs}", *[""] * 5])
    print_table([*axes, "figure", "runs", "mean", "deviation", "5 %", "50 %", "95 %"], lines)
    for group in groups:
        for failed, error in group.failed.items():
            remark(f"failed: {failed}: {error}")


def _diagnosis(sentences: list[str], label: str = "diagnosis") -> None:
    for sentence in sentences:
        print_line(f"{label}: {sentence}")


def _mean(iterations: float | None) -> str:
    """Mean number of iterations as text; some solvers do not report them."""
    return "not reported" if iterations is None else f"{iterations:.1f}".removesuffix(".0") + " mean"


def _verified(report: Report) -> dict[str, str]:
    """The lines on what the independent check found in a plan."""
    worst = report.worst
    place = f" ({worst.family} at {worst.component})" if worst is not None and worst.value > 0 else ""
    return {"max violation": f"{'none' if worst is None else worst}{place}", **_unchecked(report.unchecked)}


def _bounded(certificate: Certificate) -> dict[str, str]:
    """The lines on how far a plan is from a proven lower bound."""
    known = certificate.as_dict()
    by = f"{certificate.formulation}, {certificate.status}, {certificate.seconds:.3f} s"
    lower, gap = known["lower"], known["gap"]
    bound = "none" if lower is None else f"{lower:,.4f} {certificate.plan.network.currency}"
    return {
        "lower bound": f"{bound} ({by})",
        "gap": "none" if gap is None else f"{round(100 * gap, 4) + 0.0:.4f} %",
    }


def _unchecked(what: Iterable[str]) -> dict[str, str]:
    """The line that names what the independent check could not verify, if anything."""
    listed = "; ".join(what)
    return {"not checked": listed} if listed else {}


def _exceeded(report: Report) -> dict[str, str]:
    """The line that locates the worst violation, if it exceeds what solvers leave."""
    worst = report.worst
    if worst is None or worst.relative <= _TOLERATED:
        return {}
    return {"worst violation": f"{worst.family} at {worst.component}, {worst.moment}: {worst}"}


def _measured(summary: Mapping[str, Any]) -> dict[str, str]:
    """The lines on what the plant measured, if anything."""
    named = {"redispatched_mwh": "redispatched", "shed_mwh": "shed", "curtailed_mwh": "curtailed"}
    shown = {word: f"{summary[key]:,.2f} MWh" for key, word in named.items() if key in summary}
    if "violated_steps" in summary:
        shown["limits"] = f"exceeded in {summary['violated_steps']} of {summary['steps']} steps"
    if summary.get("outages"):
        out = (f"{name} in {len(steps)} steps" for name, steps in summary["outages"].items())
        shown["out of service"] = ", ".join(out)
    if summary.get("unsolved_steps"):
        shown["unsolved"] = f"{summary['unsolved_steps']} of {summary['steps']} steps"
    return shown


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:,.2f}" if abs(value) >= 1e3 else f"{value:.4g}"
    return str(value)
