"""The limits that bind in a plan, by name."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from opfmodel.network.units import scale
from opfmodel.plan import Plan

__all__ = ["NEAR", "active_limits"]

Array = npt.NDArray[np.float64]

# Of the range of a limited quantity, or p.u. where a side is infinite: interior-point methods approach
# a limit that costs nothing only to the square root of their tolerance.
NEAR = 1e-3
_PRICED = 1e-6  # $/MWh of a branch, $/h and unit of a constraint; a smaller price is tolerance


def active_limits(plan: Plan) -> tuple[str, ...]:
    """Return the limits that bind in a plan of one stage, as sentences without a verb.

    Limits of variables and of angle differences bind where the values are near them, ratings of branches and
    custom constraints where they have a price.
    """
    return (*_bounds(plan), *_angles(plan), *_priced(plan))


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
                if np.isfinite(bound) and beyond <= NEAR * width:
                    shown = bound * scale(unit, model.network.base_mva)
                    yield f"{item}: {name} at its {side} of {shown:.6g} {unit}".rstrip()


def _angles(plan: Plan) -> Iterator[str]:
    if "va" not in plan.model.published:
        return
    branch, va = plan.network.branch, plan.stage.bus.va[:, 0]
    across = va[branch.from_bus] - va[branch.to_bus]
    for item, at, least, most in zip(
        branch.names, across, branch.angle_min[:, 0], branch.angle_max[:, 0], strict=True
    ):
        if min(at - least, most - at) <= NEAR:
            yield f"{item}: at its limit of the angle difference"


def _priced(plan: Plan) -> Iterator[str]:
    network = plan.network
    if "rating_price" in plan.model.prices:
        price = np.abs(plan.price("rating_price")[:, 0]) / network.base_mva
        yield from (f"{network.branch.names[at]}: at its rating" for at in np.flatnonzero(price > _PRICED))
    for constraint in plan.problem.constraints.values():
        if constraint.price in plan.model.prices and (np.abs(plan.price(constraint.price)) > _PRICED).any():
            yield f"constraint {constraint.name}"
