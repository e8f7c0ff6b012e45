"""Maxima of quantities so far, as states."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from solvers import Expression

if TYPE_CHECKING:
    from opfmodel.model.model import Model

__all__ = ["declare_peak"]


def declare_peak(
    model: Model,
    kind: str,
    name: str,
    values: Expression,
    kept: Any,
    *,
    unit: str,
    description: str = "",
    initial: str | None = None,
) -> tuple[Expression, Expression]:
    r"""Declare the maximum of a quantity so far as a stock, in every stage but contingencies.

    .. math::
        m(k + 1) \ge kept(k)\, m(k), \quad m(k + 1) \ge x(k)

    Plans report the smallest such values. A solver may leave them larger, because a cost of the increase
    adds up to that of the final value, whenever it increases.

    Parameters
    ----------
    values
        The quantity :math:`x`.
    kept
        1, or 0 in a stage in which the maximum is counted anew.
    initial
        Field with the default initial value.

    Returns
    -------
    Expression, Expression
        The values at the start and at the end of each stage.
    """
    start, end = model.stock(
        kind, name, -np.inf, np.inf, unit=unit, description=description, initial=initial, ends=False
    )
    model.states[name] = replace(model.states[name], peak=True)
    regular, after = np.arange(len(model.horizon.regular)), model.horizon.contingencies
    above = end - kept * start
    model.rows(kind, f"{name}_kept", above[:, regular], 0.0, np.inf, nodes=regular)
    model.rows(kind, f"{name}_met", (end - values)[:, regular], 0.0, np.inf, nodes=regular)
    if after.size:
        model.rows(kind, f"{name}_after", (end - start)[:, after], 0.0, 0.0, nodes=after)
    zero = np.zeros((end.items, model.stages))
    model.build.output(f"{name} kept", model.build.expression(kept + zero))
    model.build.output(f"{name} met", values + zero)
    return start, end
