"""Time per back end on convex problems, and PyPSA's linear optimal power flow, in one run.

python -m benchmarks.backends
"""

from __future__ import annotations

from typing import Any

from benchmarks.harness import arguments, measure, median, report, timed
from benchmarks.systems import PGLIB, case118, demand

DC = ("ipopt", "clarabel", "osqp", "qp:piqp", "qp:highs")
SOC = ("ipopt", "clarabel", "conic:scs")
# The active-set method of HiGHS needs minutes on the large problem.
OPTIONS = {"qp:highs": {"time_limit": 120.0}}


def dc_118(solver: str, horizon: int, linear: bool = False) -> dict[str, Any]:
    """DC with storage at every bus: the first problem cold, the next one started from it."""
    import opfmodel as om

    network, series = case118(horizon + 1)
    if linear:
        _linearise(network)
    options = {"regularisation": 0.0} if linear else {}
    settings = {"formulation": "dc", "profiles": series, "solver": solver, **options}
    om.MultiStage(network, 1, **settings).solve()  # exclude imports from the time
    problem = om.MultiStage(network, horizon, options=OPTIONS.get(solver), **settings)
    built, _ = timed(problem.compile)
    first_s, first = timed(problem.solve)
    next_s = None
    if first.optimal:
        next_s, _ = timed(lambda: problem.solve(1, first.next_state(), first))
    return _result(first, built, first_s) | {"next_s": next_s}


def soc_single(solver: str, case: str) -> dict[str, Any]:
    """A single stage of a PGLib case."""
    import opfmodel as om

    network = om.read_network(PGLIB / f"pglib_opf_{case}.m")
    small = om.read_network(PGLIB / "pglib_opf_case3_lmbd.m")
    om.MultiStage(small, formulation="soc", solver=solver).solve()
    problem = om.MultiStage(network, formulation="soc", solver=solver)
    built, _ = timed(problem.compile)
    first_s, first = timed(problem.solve)
    return _result(first, built, first_s)


def pypsa_118(horizon: int) -> dict[str, Any]:
    """PyPSA on the data of :func:`dc_118` with linear costs."""
    try:
        from benchmarks.linear import pypsa_network, solve_pypsa
    except ImportError as error:
        return {"error": f"skipped: {error.name} is not installed (pip install pypsa)"}
    from opfmodel.network.arrays import per_unit

    network, series = case118(horizon + 1)
    _linearise(network)
    arrays = per_unit(network)
    active, _ = demand(arrays, series, 0, horizon)
    solve_pypsa(pypsa_network(arrays, active[:, :1]))
    build_s, made = timed(lambda: pypsa_network(arrays, active))
    first_s, result = timed(lambda: solve_pypsa(made))
    return {"build_s": build_s, "first_s": first_s, **result}


def _linearise(network: Any) -> None:
    """Keep the linear part of the generators' costs, with offsets that make them differ."""
    import opfmodel as om

    for position, (name, generator) in enumerate(network.of(om.Generator).items()):
        network.update(name, cost=om.Polynomial(0.0, generator.cost.c1 + 0.01 * position, 0.0))


def _result(plan: Any, built: float, first: float) -> dict[str, Any]:
    solution = plan.solution
    return {
        "build_s": built,
        "first_s": first,
        "objective": plan.objective if plan.optimal else None,
        "primal_residual": solution.primal_residual,
        "status": plan.status if plan.optimal else f"{plan.status}: {plan.termination}",
    }


def main() -> None:
    """Measure and report."""
    options = arguments(__doc__ or "")
    horizon = 4 if options.quick else 48
    larger = "case57_ieee" if options.quick else "case300_ieee"
    dc, linear = f"DC 118 x {horizon}", f"DC 118 x {horizon}, linear"
    groups: dict[str, list[tuple[str, Any, tuple[Any, ...]]]] = {
        dc: [(solver, dc_118, (solver, horizon)) for solver in DC],
        linear: [
            *((solver, dc_118, (solver, horizon, True)) for solver in ("ipopt", "qp:highs", "clarabel")),
            ("PyPSA", pypsa_118, (horizon,)),
        ],
        "SOC 118 x 1": [(solver, soc_single, (solver, "case118_ieee")) for solver in SOC],
        f"SOC {larger} x 1": [(solver, soc_single, (solver, larger)) for solver in SOC],
    }
    rows: list[dict[str, Any]] = []
    goals: dict[str, Any] = {}
    for group, measurements in groups.items():
        runs: dict[str, list[dict[str, Any]]] = {name: [] for name, _, _ in measurements}
        for _ in range(options.repeat):  # alternate, so that a drift of the machine affects all
            for name, function, given in measurements:
                runs[name].append(measure(function, *given))
        found = {name: median(list_) for name, list_ in runs.items()}
        rows += [{"measurement": f"{group}, {name}", **row} for name, row in found.items()]
        totals = {name: row["build_s"] + row["first_s"] for name, row in found.items() if "error" not in row}
        fastest = min(totals, key=lambda name: totals[name])
        goals |= {
            f"{group}, {name} / {fastest}": total / totals[fastest]
            for name, total in totals.items()
            if name != fastest
        }
        if "PyPSA" in totals:
            ours, theirs = found["clarabel"]["objective"], found["PyPSA"]["objective"]
            goals["relative difference of the linear objectives"] = abs(ours / theirs - 1)
    report("backends", rows, goals)


if __name__ == "__main__":
    main()
