"""The command that finds the power flow of a network at its set-points."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from opfmodel.cli.options import FILE, JSON, LOSSY, SET, VARIANT
from opfmodel.cli.output import print_json, print_line, print_notes, print_pairs, print_table
from opfmodel.cli.reading import network_of

if TYPE_CHECKING:
    from opfmodel.plan.power_flow_result import PowerFlowResult

__all__ = ["powerflow"]

_SHOWN = 5  # rows of each table


def powerflow(
    file: FILE,
    slack: Annotated[
        str,
        typer.Option(
            metavar="single|distributed",
            help="What covers losses: the first generator at the reference bus, or all that participate.",
        ),
    ] = "single",
    enforce_q_limits: Annotated[
        bool, typer.Option("--enforce-q-limits", help="Generators at a reactive limit give up their voltage.")
    ] = False,
    step: Annotated[int, typer.Option(help="Step of the time series, if there are any.")] = 0,
    out: Annotated[Path | None, typer.Option(help="Folder for trajectories.nc and summary.json.")] = None,
    lossy: LOSSY = False,
    variant: VARIANT = None,
    set_: SET = None,
    json_: JSON = False,
) -> int:
    """Find the AC power flow of a network at its set-points.

    Limits are not enforced. Of a scenario, its network and time series are used.
    """
    from opfmodel.plan.power_flow import power_flow
    from opfmodel.results import save

    network, profiles = network_of(file, lossy, variant, set_)
    flow = power_flow(network, slack=slack, enforce_q_limits=enforce_q_limits, profiles=profiles, step=step)
    summary = flow.summary()
    if out is not None:
        save(flow.data if flow.converged else None, summary, out)
    if json_:
        print_json(summary)
    else:
        _show(flow)
        if out is not None:
            print_line(f"written to {out}")
    return 0 if flow.converged else 1


def _show(flow: PowerFlowResult) -> None:
    """Print what matters: whether it converged, the slack, and the extremes of voltage and loading."""
    print_notes(flow.notes)
    pairs = {
        "status": f"{flow.status} after {flow.iterations} iterations",
        "max mismatch": f"{flow.max_mismatch:.1e} MVA",
    }
    if not flow.converged:
        print_pairs(pairs)
        return
    pairs["losses"] = f"{flow.losses:.3f} MW"
    for bus, power in flow.slack.items():
        pairs[f"slack at {bus}"] = f"{power:.3f} MW"
    if flow.limited:
        pairs["at a limit of q"] = ", ".join(flow.limited)
    print_pairs(pairs)
    data = flow.data.isel(time=0)
    voltage = data["vm"].sortby(data["vm"])
    for title, chosen in (("lowest", voltage[:_SHOWN]), ("highest", voltage[::-1][:_SHOWN])):
        print_line("")
        rows = [
            [str(bus), f"{vm:.4f}", f"{data['va'].sel(bus=bus).item():.3f}"]
            for bus, vm in zip(chosen["bus"].values, chosen.values, strict=True)
        ]
        print_table([f"{title} voltages", "vm (p.u.)", "va (deg)"], rows, numbers=True)
    loading = flow.loading.dropna("branch")
    loading = loading.sortby(loading, ascending=False)[:_SHOWN]
    if loading.size:
        print_line("")
        rows = [
            [str(branch), f"{percent:.1f}", f"{data['pf'].sel(branch=branch).item():.3f}"]
            for branch, percent in zip(loading["branch"].values, loading.values, strict=True)
        ]
        print_table(["highest loadings", "% of rating", "pf (MW)"], rows, numbers=True)
