"""The limits that bind in a plan, by name."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from opfmodel.network.units import scale
from opfmodel.plan import Plan

__all__ = ["active_limits"]

Array = npt.NDArray[np.float64]

# Of the range of a limited quantity, or p.u. where a side is infinite: interior-point methods approach
# a limit that costs nothing only to the square root of their tolerance.
_NEAR = 1e-3
_PRICED = 1e-6  # $/MWh, a smaller price of a branch or constraint is tolerance


def active_limits(plan: Plan) -> tuple[str, ...]:
    """Return the limits that bind in the first stage of a plan, as sentences without a verb.

    Limits of variables, whose values are compared with them; ratings of branches, angle differences and
    custom constraints, which bind where they have a price.
    """
    return tuple(dict.fromkeys((*_bounds(plan), *_priced(plan))))


def _bounds(plan: Plan) -> Iterator[str]:
    solution, model = plan.solution, plan.model
    for name, source in model.bounds.items():
        published = {**model.published, **model.reported}.get(name)
        if published is None or name not in solution.program.variables:
            continue  # rows, and parts of a quantity, such as charging and discharging
        names = model.network.tables[source.kind].names
        block = solution.program.variables[name]
        value = block.read(solution.x)[:, 0]
        low, high = (block.read(side)[:, 0] for side in (solution.instance.lower, solution.instance.upper))
        unit = published.unit
        for item, at, least, most in zip(names, value, low, high, strict=True):
            if least == most:
                continue  # given, not limited
            width = most - least if np.isfinite(most - least) else 1.0
            for bound, side, beyond in ((least, "minimum", at - least), (most, "maximum", most - at)):
                if np.isfinite(bound) and beyond <= _NEAR * width:
                    shown = bound * scale(unit, model.network.base_mva)
                    yield f"{item}: {name} at its {side} of {shown:.6g} {unit}".rstrip()


def _priced(plan: Plan) -> Iterator[str]:
    network = plan.network
    for (kind, name), price in plan.prices().items():
        if name in ("lmp", "lmp_q", "e_price", "security_price") or name.endswith("_ramp_price"):
            continue
        what = name.removesuffix("_price")
        names = network.tables[kind].names if kind in network.tables else ("",)
        for item, value in zip(names, np.abs(price[:, 0]), strict=False):
            if value / network.base_mva > _PRICED:
                yield f"{item}: at its {what}" if item else f"constraint {what}"
    if "va" in plan.model.published:
        branch, va = network.branch, plan.stage.bus.va[:, 0]
        across = va[branch.from_bus] - va[branch.to_bus]
        for item, at, least, most in zip(
            branch.names, across, branch.angle_min[:, 0], branch.angle_max[:, 0], strict=True
        ):
            if min(at - least, most - at) <= _NEAR:
                yield f"{item}: at its limit of the angle difference"
