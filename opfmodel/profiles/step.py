"""Temporary changes of demand."""

from __future__ import annotations

import warnings
from typing import Annotated

import numpy as np

from opfmodel.errors import ProfileError, ProfileWarning
from opfmodel.network.quantities import In
from opfmodel.profiles.base import ProfileRule, Workbook

__all__ = ["Step"]


class Step(ProfileRule):
    """Change demand between two steps, inclusive, at constant power factor.

    A change that begins after the last value has no effect and only raises a warning, because a
    scenario may be shortened.

    Parameters
    ----------
    loads
        Names of loads.
    first, last
        First and last step of the change.
    add
        Active demand added to each load, MW.
    factor
        Factor on the demand; give either ``add`` or ``factor``.
    """

    def __init__(
        self,
        loads: list[str],
        first: int,
        last: int,
        add: Annotated[float | None, In("MW")] = None,
        factor: float | None = None,
    ) -> None:
        if (add is None) == (factor is None):
            raise ProfileError("a step needs either 'add' or 'factor'")
        if not 0 <= first <= last:
            raise ProfileError(f"a step needs 0 <= first <= last, not first = {first}, last = {last}")
        self.loads = loads
        self.first = first
        self.last = last
        self.add = add
        self.factor = factor

    def apply(self, book: Workbook) -> None:
        """Change the demand in the steps from ``first`` to ``last``."""
        if self.first >= book.steps:
            warnings.warn(
                f"step: first = {self.first}: has no effect; the series have {book.steps} values",
                ProfileWarning,
                stacklevel=2,
            )
        for load in book.loads(self.loads):
            p, q = book.get(load, "p").copy(), book.get(load, "q").copy()
            window = slice(self.first, self.last + 1)
            if self.add is None:
                factor = np.full_like(p[window], self.factor)
            elif (p[window] == 0).any():
                fault = f"load {load!r} has zero active demand and thus no power factor to keep"
                raise ProfileError(fault, (load, "p"))
            else:
                factor = 1.0 + self.add / p[window]
            p[window] *= factor
            q[window] *= factor
            book.set(load, "p", p)
            book.set(load, "q", q)
