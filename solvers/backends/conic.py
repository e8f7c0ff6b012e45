"""Second-order cone programs through CVXPY, stated in matrices."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np

from solvers.assembly import Evaluator
from solvers.certify import certified
from solvers.errors import SolverOptionError
from solvers.matrices import Matrices, MatrixMaker, StandardForm, proves_infeasible, standard_form
from solvers.program import Array, Instance, Program
from solvers.solution import Solution, Start
from solvers.status import SolutionStatus, TerminationCondition
from solvers.structure import Kind

__all__ = ["Conic"]

_PREFERRED = ("clarabel", "mosek", "ecos", "scs")
_DEFAULTS: dict[str, dict[str, Any]] = {
    "clarabel": {},
    # Measured on twenty DC and SOC problems: SCS's own acceleration never comes to an end on two of them,
    # without it and with this scale all are solved, in 50 to 4,000 iterations.
    "scs": {
        "eps_abs": 1e-7,
        "eps_rel": 1e-7,
        "max_iters": 100_000,
        "scale": 10.0,
        "acceleration_lookback": 0,
    },
}
_TERMINATION = {
    "optimal": TerminationCondition.CONVERGED,
    "optimal_inaccurate": TerminationCondition.ACCEPTABLE,
    "infeasible": TerminationCondition.INFEASIBLE,
    "infeasible_inaccurate": TerminationCondition.INFEASIBLE,
    "unbounded": TerminationCondition.UNBOUNDED,
    "unbounded_inaccurate": TerminationCondition.UNBOUNDED,
    "user_limit": TerminationCondition.ITERATION_LIMIT,
}


class Conic:
    """Linear, quadratic and second-order cone programs through CVXPY."""

    name = "conic"
    accepts = Kind.CONIC

    def solvers(self) -> Iterator[str]:
        """What CVXPY finds installed and can solve cone programs, the most robust first."""
        import cvxpy as cp
        from cvxpy.reductions.solvers.defines import SOLVER_MAP_CONIC

        known = [n.lower() for n in cp.installed_solvers() if n in SOLVER_MAP_CONIC]
        able = [n for n in known if cp.constraints.SOC in SOLVER_MAP_CONIC[n.upper()].SUPPORTED_CONSTRAINTS]
        yield from (name for name in _PREFERRED if name in able)
        yield from (name for name in able if name not in _PREFERRED)

    def prepare(self, program: Program, solver: str, options: dict[str, Any], verbose: bool) -> ConicSession:
        """Fold the program into matrices."""
        return ConicSession(program, solver, options, verbose)


class ConicSession:
    """A program as matrices, stated to CVXPY without a loop over buses or stages."""

    def __init__(self, program: Program, solver: str, options: dict[str, Any], verbose: bool) -> None:
        self._program = program
        self._evaluator = Evaluator(program)
        self._maker = MatrixMaker(self._evaluator)
        self._solver = solver
        self._options = _DEFAULTS.get(solver, {}) | options
        self._verbose = verbose

    def solve(self, instance: Instance, start: Start | None = None) -> Solution:  # noqa: ARG002
        """Solve; CVXPY's interior-point solvers have no use for a start."""
        import cvxpy as cp

        matrices = self._maker.at(instance)
        stated = _Stated(self._program, matrices)
        began = time.perf_counter()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the status says it
                stated.problem.solve(solver=self._solver.upper(), verbose=self._verbose, **self._options)
        except (TypeError, AttributeError, ValueError) as error:
            raise SolverOptionError(f"{self._solver} refused its options {self._options}: {error}") from error
        except cp.error.SolverError as error:
            return self._solution(instance, stated, matrices, str(error), time.perf_counter() - began)
        status = str(stated.problem.status)
        return self._solution(instance, stated, matrices, status, time.perf_counter() - began)

    def _solution(
        self, instance: Instance, stated: _Stated, matrices: Matrices, message: str, seconds: float
    ) -> Solution:
        termination = _TERMINATION.get(message, TerminationCondition.NUMERICAL_FAILURE)
        x, lam_x, lam_g, z = stated.values()
        status = SolutionStatus.NONE
        if termination is TerminationCondition.INFEASIBLE:
            proven = proves_infeasible(matrices, lam_x, lam_g, z)
            status = SolutionStatus.PROVEN_INFEASIBLE if proven else SolutionStatus.LOCALLY_INFEASIBLE
        stats = stated.problem.solver_stats
        solution = Solution(
            program=self._program,
            evaluator=self._evaluator,
            instance=instance,
            x=x,
            lam_x=stated.scale * lam_x,
            lam_g=stated.scale * lam_g,
            z=stated.scale * z,
            termination=termination,
            status=status,
            message=message,
            solver=self._solver,
            iterations=None if stats is None else stats.num_iters,
            seconds=seconds,
        )
        claimed = termination in (TerminationCondition.CONVERGED, TerminationCondition.ACCEPTABLE)
        return certified(solution) if claimed else solution


class _Stated:
    """A CVXPY problem made of matrices, and the way back for its values."""

    def __init__(self, program: Program, m: Matrices) -> None:
        import cvxpy as cp

        self._program = program
        self._form: StandardForm = standard_form(m)
        form = self._form
        # Slopes in $ per p.u. are thousands. Measured on the SOC relaxations of 14 PGLib cases: divided by
        # the largest, Clarabel stops short of its tolerance on five; undivided on two, and SCS needs up to
        # fifty times the iterations; divided by the mean, on one.
        self.scale = max(1.0, float(np.abs(m.q).mean())) if m.q.size else 1.0
        self._x = x = cp.Variable(m.q.size)
        cost = (m.q / self.scale) @ x
        if m.p.nnz:
            cost = cost + 0.5 * cp.quad_form(x, cp.psd_wrap(m.p / self.scale))
        self._low, self._high = (np.flatnonzero(np.isfinite(b)) for b in (form.lb, form.ub))
        self._equal = form.a @ x == form.b if form.b.size else None
        self._less = form.g @ x <= form.h if form.h.size else None
        self._above = x[self._low] >= form.lb[self._low] if self._low.size else None
        self._below = x[self._high] <= form.ub[self._high] if self._high.size else None
        self._cones = []
        rows = m.s.tocsr()
        for cone in program.cones.values():
            bound, entries = cone.index[0], cone.index[1:]
            inside = rows[entries.ravel(order="F")] @ x + m.s0[entries.ravel(order="F")]
            matrix = cp.reshape(inside, entries.shape, order="F")
            self._cones.append(cp.SOC(rows[bound] @ x + m.s0[bound], matrix, axis=0))
        linear = (self._equal, self._less, self._above, self._below)
        self.problem = cp.Problem(cp.Minimize(cost), [*(c for c in linear if c is not None), *self._cones])

    def values(self) -> tuple[Array, Array, Array, Array]:
        """Primal values and multipliers ``(x, lam_x, lam_g, z)``, zero where there are none."""
        form = self._form
        x = _dense(self._x.value, form.q.size)
        z_box = np.zeros(form.q.size)
        z_box[self._low] -= _dual(self._above, self._low.size)
        z_box[self._high] += _dual(self._below, self._high.size)
        y, less = _dual(self._equal, form.b.size), _dual(self._less, form.h.size)
        lam_x, lam_g = form.multipliers(y, less, z_box)
        z = np.zeros(self._program.n_cone_values)
        for cone, constraint in zip(self._program.cones.values(), self._cones, strict=True):
            bound, entries = (d.value for d in constraint.dual_variables)
            z[cone.index[0]] = _dense(bound, cone.index.shape[1])
            if entries is not None:
                z[cone.index[1:]] = np.asarray(entries, dtype=float).reshape(cone.index[1:].shape)
        return x, lam_x, lam_g, z


def _dual(constraint: Any, size: int) -> Array:
    return np.zeros(size) if constraint is None else _dense(constraint.dual_value, size)


def _dense(values: Any, size: int) -> Array:
    return np.zeros(size) if values is None else np.asarray(values, dtype=float).ravel(order="F")
