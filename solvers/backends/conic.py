"""Second-order cone programs through CVXPY, in matrix form."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from solvers.assembly import Evaluator
from solvers.backends.clarabel import Clarabel
from solvers.certify import certified
from solvers.errors import SolverOptionError
from solvers.matrices import Matrices, MatrixMaker, StandardForm, standard_form
from solvers.program import Array, Instance, Program
from solvers.solution import Solution, Start
from solvers.solve import Session
from solvers.status import SolutionStatus, TerminationCondition
from solvers.structure import Kind

__all__ = ["Conic"]

_PREFERRED = ("clarabel", "mosek", "ecos", "scs")
_DEFAULTS: dict[str, dict[str, Any]] = {
    # Measured on twenty DC and SOC problems: with its acceleration SCS never terminates on two of them;
    # without it and with this scale it solves all, in 50 to 4,000 iterations.
    "scs": {
        "eps_abs": 1e-7,
        "eps_rel": 1e-7,
        "max_iters": 100_000,
        "scale": 10.0,
        "acceleration_lookback": 0,
    },
}
# CVXPY uses the same statuses for all solvers.
_TERMINATION = {
    "optimal": TerminationCondition.CONVERGED,
    "optimal_inaccurate": TerminationCondition.ACCEPTABLE,
    "infeasible": TerminationCondition.INFEASIBLE,
    "infeasible_inaccurate": TerminationCondition.INFEASIBLE,
    "unbounded": TerminationCondition.UNBOUNDED,
    "unbounded_inaccurate": TerminationCondition.UNBOUNDED,
    "user_limit": TerminationCondition.LIMIT,
}
# CVXPY merges several statuses into a limit or an error; the solver's own status tells them apart.
_OWN: dict[str, tuple[Callable[[Any], int], dict[int, TerminationCondition]]] = {
    "scs": (
        lambda found: int(found["info"]["status_val"]),
        {-3: TerminationCondition.NUMERICAL_FAILURE, -5: TerminationCondition.INTERRUPTED},
    ),
    "ecos": (
        lambda found: int(found["info"]["exitFlag"]),
        {
            -1: TerminationCondition.ITERATION_LIMIT,
            -2: TerminationCondition.NUMERICAL_FAILURE,
            -3: TerminationCondition.NUMERICAL_FAILURE,
            -4: TerminationCondition.INTERRUPTED,
        },
    ),
    "gurobi": (
        lambda found: int(found["model"].Status),
        {
            7: TerminationCondition.ITERATION_LIMIT,
            9: TerminationCondition.TIME_LIMIT,
            11: TerminationCondition.INTERRUPTED,
            12: TerminationCondition.NUMERICAL_FAILURE,
        },
    ),
}


class Conic:
    """Linear, quadratic and second-order cone programs through CVXPY."""

    name = "conic"
    accepts = Kind.CONIC

    def solvers(self) -> Iterator[str]:
        """Installed solvers that CVXPY can use for cone programs, the most robust first."""
        import cvxpy as cp
        from cvxpy.reductions.solvers.defines import SOLVER_MAP_CONIC

        known = [n.lower() for n in cp.installed_solvers() if n in SOLVER_MAP_CONIC]
        able = [n for n in known if cp.constraints.SOC in SOLVER_MAP_CONIC[n.upper()].SUPPORTED_CONSTRAINTS]
        yield from (name for name in _PREFERRED if name in able)
        yield from (name for name in able if name not in _PREFERRED)

    def prepare(self, program: Program, solver: str, options: Mapping[str, Any], verbose: bool) -> Session:
        """Fold the program into matrices, here or in the solver's dedicated back end."""
        if solver == Clarabel.name:
            return Clarabel().prepare(program, solver, options, verbose)
        return ConicSession(program, solver, options, verbose)


class ConicSession:
    """A program as matrices, passed to CVXPY without a loop over buses or stages."""

    def __init__(self, program: Program, solver: str, options: Mapping[str, Any], verbose: bool) -> None:
        self._program = program
        self._evaluator = Evaluator(program)
        self._maker = MatrixMaker(self._evaluator)
        self._solver = solver
        self._given = dict(options)
        self._options = _DEFAULTS.get(solver, {}) | self._given
        self._verbose = verbose

    def solve(self, instance: Instance, start: Start | None = None) -> Solution:  # noqa: ARG002
        """Solve an instance; the start is not passed to CVXPY.

        Raises
        ------
        KeyboardInterrupt
            Ctrl-C, if the solver catches it itself.
        """
        stated = _Stated(self._program, self._maker.at(instance))
        began = time.perf_counter()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the status reports the same
                termination, message = self._call(stated.problem)
        except (TypeError, AttributeError, ValueError) as error:
            if not self._given:
                raise
            raise SolverOptionError(f"{self._solver} rejected options {self._given}: {error}") from error
        seconds = time.perf_counter() - began
        if termination is TerminationCondition.INTERRUPTED:
            raise KeyboardInterrupt
        x, lam_x, lam_g, z = stated.values()
        stats = stated.problem.solver_stats
        return certified(
            Solution(
                program=self._program,
                evaluator=self._evaluator,
                instance=instance,
                x=x,
                lam_x=lam_x,
                lam_g=lam_g,
                z=z,
                termination=termination,
                status=SolutionStatus.NONE,
                message=message,
                solver=self._solver,
                iterations=None if stats is None else stats.num_iters,
                seconds=seconds,
            )
        )

    def _call(self, problem: Any) -> tuple[TerminationCondition, str]:
        """Do what ``problem.solve`` does, and also read the solver's own status."""
        import cvxpy as cp

        own = None
        try:
            data, chain, inverse = problem.get_problem_data(self._solver.upper(), solver_opts=self._options)
            found = chain.solve_via_data(problem, data, verbose=self._verbose, solver_opts=self._options)
            if self._solver in _OWN:
                code, meaning = _OWN[self._solver]
                own = meaning.get(code(found))
            problem.unpack_results(found, chain, inverse)
            message = str(problem.status)
        except cp.error.SolverError as error:
            message = str(error)
        return own or _TERMINATION.get(message, TerminationCondition.ERROR), message


class _Stated:
    """A CVXPY problem made of matrices, with the inverse mapping of its values."""

    def __init__(self, program: Program, m: Matrices) -> None:
        import cvxpy as cp

        self._program = program
        self._form: StandardForm = standard_form(m)
        form = self._form
        # Slopes in $ per p.u. are in the thousands. Measured on the SOC relaxations of 14 PGLib cases:
        # without scaling, SCS needs up to fifty times the iterations.
        self._scale = m.cost_scale
        self._x = x = cp.Variable(m.q.size)
        cost = (m.q / self._scale) @ x
        if m.p.nnz:
            cost = cost + 0.5 * cp.quad_form(x, cp.psd_wrap(m.p / self._scale))
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
        """Values and multipliers ``(x, lam_x, lam_g, z)`` of the program, zero where missing."""
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
        return x, self._scale * lam_x, self._scale * lam_g, self._scale * z


def _dual(constraint: Any, size: int) -> Array:
    return np.zeros(size) if constraint is None else _dense(constraint.dual_value, size)


def _dense(values: Any, size: int) -> Array:
    return np.zeros(size) if values is None else np.asarray(values, dtype=float).ravel(order="F")
