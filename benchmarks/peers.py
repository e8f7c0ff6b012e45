"""Single-stage AC-OPF compared with pandapower and PYPOWER on the same data.

python -m benchmarks.peers
"""

from __future__ import annotations

import contextlib
import io
import warnings
from typing import Any

import numpy as np

from benchmarks.harness import arguments, measure, median, report, timed
from benchmarks.systems import PGLIB

CASES = ("case5_pjm", "case14_ieee", "case30_as", "case57_ieee", "case118_ieee", "case300_ieee")


def opfmodel_case(case: str) -> dict[str, Any]:
    """From the declared network to the optimum, as a user experiences it."""
    import opfmodel as om

    om.MultiStage(_network("case3_lmbd")).solve()  # exclude imports from the time
    network = _network(case)
    seconds, plan = timed(lambda: om.MultiStage(network).solve())
    return {"seconds": seconds, "objective": plan.objective, "status": plan.status}


def pypower_case(case: str) -> dict[str, Any]:
    """Optimum by PYPOWER's ``runopf`` with its default interior-point solver."""
    try:
        from pypower.api import ppoption, runopf
    except ImportError as error:
        return {"error": f"skipped: {error.name} is not installed (pip install pypower)"}
    quiet = ppoption(VERBOSE=0, OUT_ALL=0)
    case_data = _ppc(_network(case))
    _silently(lambda: runopf(_ppc(_network("case3_lmbd")), quiet))
    seconds, result = timed(lambda: _silently(lambda: runopf(case_data, quiet)))
    status = "converged" if result["success"] else "failed"
    return {"seconds": seconds, "objective": float(result["f"]), "status": status}


def pandapower_case(case: str) -> dict[str, Any]:
    """Optimum by pandapower's ``runopp`` with its defaults and a flat start."""
    try:
        import pandapower as pp
        from pandapower.converter.pypower.from_ppc import from_ppc
    except ImportError as error:
        return {"error": f"skipped: {error.name} is not installed (pip install pandapower)"}
    warm = _silently(lambda: from_ppc(_ppc(_network("case3_lmbd"))))
    _silently(lambda: pp.runopp(warm, init="flat"))
    net = _silently(lambda: from_ppc(_ppc(_network(case))))
    try:
        seconds, _ = timed(lambda: _silently(lambda: pp.runopp(net, init="flat")))
    except pp.optimal_powerflow.OPFNotConverged:
        return {"status": "failed"}
    return {"seconds": seconds, "objective": float(net.res_cost), "status": "converged"}


def _network(case: str) -> Any:
    import opfmodel as om

    return om.read_network(PGLIB / f"pglib_opf_{case}.m")


def _silently(function: Any) -> Any:
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        return function()


def _ppc(network: Any) -> dict[str, Any]:
    """A network as MATPOWER arrays, for PYPOWER and pandapower's converter."""
    from benchmarks.systems import vectors
    from opfmodel.network.arrays import per_unit

    n = vectors(per_unit(network))
    bus, gen, branch, base = n.bus, n.generator, n.branch, n.base_mva
    kind = np.ones(len(bus))
    kind[gen.bus] = 2
    kind[n.reference] = 3
    ones, zeros = np.ones, np.zeros
    power = [
        base * n.at_buses(table, values)
        for table, values in (
            ("load", n.load.p),
            ("load", n.load.q),
            ("shunt", n.shunt.g),
            ("shunt", n.shunt.b),
        )
    ]
    b, g, m = len(bus), len(gen), len(branch)
    number = np.arange(b) + 1.0
    rating = np.where(np.isfinite(branch.rating), base * branch.rating, 0.0)
    tap = np.where((branch.tap == 1) & (branch.shift == 0), 0.0, branch.tap)
    angles = np.rad2deg([branch.angle_min, branch.angle_max])
    columns = {
        "bus": [number, kind, *power, ones(b), ones(b), zeros(b), np.full(b, 100.0), ones(b),
                bus.vm_max, bus.vm_min],
        "gen": [number[gen.bus], base * 0.5 * (gen.p_min + gen.p_max), zeros(g), base * gen.q_max,
                base * gen.q_min, ones(g), np.full(g, base), ones(g), base * gen.p_max,
                base * gen.p_min, *zeros((11, g))],
        "branch": [number[branch.from_bus], number[branch.to_bus], branch.r, branch.x,
                   branch.b, rating, rating, rating, tap, np.rad2deg(branch.shift), ones(m), *angles],
        "gencost": [np.full(g, 2.0), zeros(g), zeros(g), np.full(g, 3.0), gen.c2 / base**2,
                    gen.c1 / base, gen.c0],
    }  # fmt: skip
    return {"version": "2", "baseMVA": base} | {
        key: np.column_stack(values) for key, values in columns.items()
    }


def main() -> None:
    """Measure and report."""
    options = arguments(__doc__ or "")
    cases = CASES[:2] if options.quick else CASES
    tools = {"opfmodel": opfmodel_case, "pandapower": pandapower_case, "PYPOWER": pypower_case}
    rows, goals = [], {}
    for case in cases:
        runs: dict[str, list[dict[str, Any]]] = {tool: [] for tool in tools}
        for _ in range(options.repeat):
            for tool, function in tools.items():
                runs[tool].append(measure(function, case))
        medians = {tool: median(list_) for tool, list_ in runs.items()}
        rows += [{"measurement": f"{case}, {tool}", **result} for tool, result in medians.items()]
        ours = medians.pop("opfmodel")
        for tool, result in medians.items():
            if "seconds" in result:
                goals[f"{case}, {tool} / opfmodel (goal >= 5)"] = result["seconds"] / ours["seconds"]
                goals[f"{case}, objective of {tool}, relative difference"] = abs(
                    result["objective"] / ours["objective"] - 1
                )
    report("peers", rows, goals)


if __name__ == "__main__":
    main()
