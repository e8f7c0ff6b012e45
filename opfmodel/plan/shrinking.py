"""Shorter horizons at the end of the data, solved by the program of the full horizon.

The last M stages of a program of N stages are a program of M stages, if nothing ties them to the stages
before. The given state therefore enters at stage N - M, the rows that tie a stage before it to a later one
are freed, and every stage before it repeats the data of the first step on its own: it has an optimum where
the first step has one, and adds nothing but a constant to the objective. Ends of the horizon, terminal costs
and everything else stay where they are.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import numpy.typing as npt

from opfmodel.errors import IncompatibleError
from solvers import Program
from solvers.program import Block

__all__ = ["Shrinking"]

Index = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]


class Shrinking:
    """Which rows of a program tie its stages together.

    Parameters
    ----------
    stages
        Number of stages, N, at least 2.
    stocks
        Blocks of variables with N + 1 points, the first of which is a given state.
    whole
        Blocks of rows that stay in force for any number of stages.

    Raises
    ------
    IncompatibleError
        The last stages are no program of their own: a constraint or a cost ties several stages together
        in another way than successive stages, or belongs to the first stages.
    """

    def __init__(
        self, program: Program, stages: int, stocks: Collection[str], whole: Collection[str]
    ) -> None:
        self.stages = stages
        self._stock = np.zeros(program.n_variables, dtype=bool)
        self._column = np.full(program.n_variables, stages + 1)  # a single value belongs to no stage
        for name, variable in program.variables.items():
            self._stock[variable.slice] = name in stocks
            if variable.stages > 1:
                self._column[variable.index] = np.arange(variable.stages)
        self._check_costs(program)
        first, last = self._spans(program)
        self._row = np.full(program.n_rows, stages)  # column of each row; beyond the last if it always holds
        for name, rows in program.rows.items():
            if name not in whole and not self._of_last_stage(rows, first):
                self._check_staged(rows, first)
                self._row[rows.index] = np.arange(rows.stages)
        self._tied = last > self._row

    def freed(self, skipped: int) -> Mask:
        """Return the rows that are freed if the plan begins at a stage."""
        return np.asarray(self._tied & (self._row < skipped))

    def _of_last_stage(self, rows: Block, first: Index) -> bool:
        """Whether a block of rows limits the last stage only; of two stages, that cannot be told."""
        alone = rows.stages == 1 and self.stages > 2
        return alone and bool((first[rows.index] >= self.stages - 1).all())

    def _check_staged(self, rows: Block, first: Index) -> None:
        """Raise an error unless each column of rows begins with the stage of the same number."""
        begins = first[rows.index]
        unclear = rows.stages == 1 and begins.any()
        if unclear or abs(rows.stages - self.stages) > 1 or (begins < np.arange(rows.stages)).any():
            raise self._refusal(f"{rows.name!r} is neither a row of every stage nor one of the last stage")

    def _spans(self, program: Program) -> tuple[Index, Index]:
        """Return the first and last column of the variables in each row."""
        first, last = np.full(program.n_rows + 1, self.stages + 1), np.full(program.n_rows + 1, -1)
        for placement in program.constraints:
            if len(placement.variables):
                columns = self._column[placement.variables]
                for into in placement.into:  # position -1, a discarded output, is the last entry
                    np.minimum.at(first, into, columns.min(axis=0))
                    np.maximum.at(last, into, columns.max(axis=0))
        return first[:-1], last[:-1]

    def _check_costs(self, program: Program) -> None:
        """Raise an error if a cost or a cone ties stages together.

        Both points of a stock, at the beginning and at the end of a stage, may have a cost in it: the
        point at which a plan begins is given.
        """
        for placements, earlier in ((program.costs, self._stock.astype(int)), (program.cone_values, 0)):
            for placement in placements:
                if len(placement.variables):
                    latest = (self._column - earlier)[placement.variables].max(axis=0)
                    if (latest > self._column[placement.variables].min(axis=0)).any():
                        raise self._refusal("a cost or a cone ties several stages together")

    @staticmethod
    def _refusal(reason: str) -> IncompatibleError:
        return IncompatibleError(
            f"at_end = 'shrink': {reason}; use at_end = 'error' or 'repeat', or state it for every stage"
        )
