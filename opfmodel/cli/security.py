"""The command that finds the outages a plan or a dispatch does not survive."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer

from opfmodel.cli.options import FILE, JSON, LOSSY, SET, VARIANT
from opfmodel.cli.output import print_json, print_line, print_notes, print_pairs, print_table
from opfmodel.cli.reading import controller_of, is_scenario, network_of

if TYPE_CHECKING:
    from opfmodel.plan import Plan, Security
    from opfmodel.plan.assessment import Assessment
    from opfmodel.plan.power_flow_result import PowerFlowResult

__all__ = ["security"]

_SHOWN = 20  # rows of the table


def security(
    file: FILE,
    response: Annotated[
        str | None, typer.Option(metavar="corrective|preventive", help="What may be dispatched anew.")
    ] = None,
    minutes: Annotated[float | None, typer.Option(help="Time for a corrective response.")] = None,
    rating: Annotated[
        float | None, typer.Option(help="Multiple of the ratings after an outage, where none is stated.")
    ] = None,
    lossy: LOSSY = False,
    variant: VARIANT = None,
    set_: SET = None,
    json_: JSON = False,
) -> int:
    """Find the outages that a plan or the present dispatch does not survive.

    Of a scenario, the first plan of its controller is assessed; of a network file, the power flow at its
    set-points. Options override the security that a scenario states.
    """
    from opfmodel.plan.assessment import assess
    from opfmodel.plan.power_flow import power_flow

    options = {"response": response, "minutes": minutes, "rating": rating}
    stated = {key: value for key, value in options.items() if value is not None}
    if is_scenario(file):
        controller, initial = controller_of(file, {}, None, lossy, variant, set_)
        plan = controller.problem.solve(initial=initial, **controller.request(0))
        dispatch: Plan | PowerFlowResult = plan
        failure = None if plan.optimal else f"the plan is {plan.status}: {plan.termination}"
    else:
        dispatch = flow = power_flow(network_of(file, lossy, variant, set_)[0])
        failure = None if flow.converged else "the power flow at the set-points of the file diverged"
    own = _security(dispatch, stated)
    found = assess(dispatch, own) if failure is None else None
    if json_:
        made = {"secure": False, "contingencies": [], "islanding": []} if found is None else found.as_dict()
        print_json({**made, "response": own.response, "failure": failure})
    elif found is None:
        print_pairs({"status": "not secure", "reason": str(failure)})
    else:
        _show(found)
    return 0 if found is not None and found.secure else 1


def _security(dispatch: Plan | PowerFlowResult, stated: Mapping[str, Any]) -> Security:
    """Return the security of a plan with other options."""
    from dataclasses import replace

    from opfmodel.plan import Plan, Security

    own = dispatch.problem.security if isinstance(dispatch, Plan) else None
    return replace(own or Security(), **stated)


def _show(found: Assessment) -> None:
    """Print the outages that are not survived and those that split the grid."""
    notes = [f"outage of {c.out} splits the grid: {c.load_mw:.4g} MW of demand" for c in found.islanding]
    print_notes(notes[:_SHOWN])
    violated, many = found.violated, len(found.outcomes)
    print_pairs(
        {"status": "secure" if found.secure else "not secure", "tested": f"{many} contingencies",
         "not survived": str(len(violated))}
    )  # fmt: skip
    if not violated:
        return
    print_line("")
    rows = [[o.out, str(o.stage), o.scenario or "-", o.status, o.text] for o in violated[:_SHOWN]]
    print_table(["outage", "stage", "scenario", "status", "what is lacking"], rows)
    if len(violated) > _SHOWN:
        print_line(f"and {len(violated) - _SHOWN} more; --json lists all")
