"""Linear programs through SciPy."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from scipy.optimize import OptimizeWarning, linprog

from solvers import Evaluator, Instance, Kind, MatrixMaker, Program, Solution, Start, standard_form
from solvers.errors import SolverOptionError
from solvers.status import SolutionStatus, TerminationCondition

__all__ = ["LinProg"]

_STOPPED = {
    0: (TerminationCondition.CONVERGED, SolutionStatus.GLOBALLY_OPTIMAL),
    1: (TerminationCondition.ITERATION_LIMIT, SolutionStatus.NONE),
    2: (TerminationCondition.INFEASIBLE, SolutionStatus.LOCALLY_INFEASIBLE),  # it returns no certificate
    3: (TerminationCondition.UNBOUNDED, SolutionStatus.NONE),
    4: (TerminationCondition.NUMERICAL_FAILURE, SolutionStatus.NONE),
}


class LinProg:
    """Linear programs through scipy.optimize.linprog."""

    name = "linprog"
    accepts = Kind.LINEAR

    def solvers(self) -> Iterator[str]:
        """The methods of linprog that this back end calls."""
        yield from ("highs", "highs-ds", "highs-ipm")

    def prepare(self, program: Program, solver: str, options: Mapping[str, Any], verbose: bool) -> Session:
        """Fold the program into matrices."""
        return Session(program, solver, {"disp": verbose, **options})


class Session:
    """A program as matrices; a new instance changes only vectors."""

    def __init__(self, program: Program, solver: str, options: dict[str, Any]) -> None:
        self._evaluator = Evaluator(program)
        self._maker = MatrixMaker(self._evaluator)
        self._solver, self._options = solver, options

    def solve(self, instance: Instance, start: Start | None = None) -> Solution:
        """Solve; SciPy passes no starting point to HiGHS."""
        form = standard_form(self._maker.at(instance))
        bounds = np.column_stack([form.lb, form.ub])
        began = time.perf_counter()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", OptimizeWarning)  # its warning of unknown options
                found = linprog(
                    form.q, form.g, form.h, form.a, form.b, bounds, self._solver, options=self._options
                )
        except (OptimizeWarning, TypeError, ValueError) as error:
            raise SolverOptionError(f"linprog rejected options {self._options}: {error}") from error
        seconds = time.perf_counter() - began
        termination, status = _STOPPED[found.status]
        program = self._evaluator.program
        x, lam_x, lam_g = np.zeros(form.q.size), np.zeros(form.q.size), np.zeros(program.n_rows)
        if found.x is not None:
            # SciPy's marginals are slopes of the optimum: multipliers of opposite sign
            x, box = found.x, -(found.lower.marginals + found.upper.marginals)
            lam_x, lam_g = form.multipliers(-found.eqlin.marginals, -found.ineqlin.marginals, box)
        return Solution(
            program, self._evaluator, instance, x, lam_x, lam_g, np.zeros(0),
            termination, status, found.message, self._solver, int(found.nit), seconds,
        )  # fmt: skip
