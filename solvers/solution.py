"""The result of a back end, certified against the program."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from solvers.assembly import Evaluator
from solvers.errors import ProgramError
from solvers.program import Array, Block, Cone, Index, Instance, Program
from solvers.status import SolutionStatus, TerminationCondition

__all__ = ["Attempt", "Solution", "Start"]


@dataclass(frozen=True, eq=False)
class Start:
    """A starting point: primal values and, where known, multipliers.

    Attributes
    ----------
    moved
        Number of stages by which the point was shifted in time; back ends trust an unshifted
        point more.
    iterations
        Iterations of the solve that found the point: whether the last problem was an easy one; None
        if unknown.
    """

    x: Array
    lam_x: Array | None = None
    lam_g: Array | None = None
    z: Array | None = None
    moved: int = 0
    iterations: int | None = None


@dataclass(frozen=True)
class Attempt:
    """An attempt at an instance: which solver, why it stopped, what it found, and the effort."""

    solver: str
    termination: TerminationCondition
    status: SolutionStatus
    message: str
    iterations: int | None
    seconds: float


@dataclass(frozen=True, eq=False)
class Solution:
    """Primal and dual values, why the solver stopped and what the status guarantees.

    The multipliers belong to the Lagrangian ``f + lam_g' g + lam_x' x - z' s``: those of an
    active upper bound are positive, those of an active lower bound negative, and ``z`` lies in
    the dual cone. The residuals are recomputed from the program, not taken from the solver.

    Attributes
    ----------
    termination, status, message
        Why the solver stopped, what the status guarantees, and the solver's own message.
    iterations, seconds
        Effort of the solver; ``seconds`` is the wall-clock time of the solve alone. ``iterations``
        is None where the interface library does not report them.
    skipped
        Number of leading stages that values and multipliers by name leave out.
    failed
        Attempts before this one that found nothing; their seconds are part of ``seconds``.
    """

    program: Program
    evaluator: Evaluator
    instance: Instance
    x: Array
    lam_x: Array
    lam_g: Array
    z: Array
    termination: TerminationCondition
    status: SolutionStatus
    message: str
    solver: str
    iterations: int | None
    seconds: float
    skipped: int = 0
    failed: tuple[Attempt, ...] = ()

    @property
    def attempts(self) -> tuple[Attempt, ...]:
        """All attempts at the instance, the last of which led to this solution."""
        seconds = self.seconds - sum(attempt.seconds for attempt in self.failed)
        own = Attempt(self.solver, self.termination, self.status, self.message, self.iterations, seconds)
        return *self.failed, own

    def after(self, *failed: Solution) -> Solution:
        """Return this solution with the attempts that failed before it."""
        earlier = [attempt for solution in failed for attempt in solution.attempts]
        seconds = self.seconds + sum(attempt.seconds for attempt in earlier)
        return replace(self, failed=(*earlier, *self.failed), seconds=seconds)

    @cached_property
    def objective(self) -> float:
        """Value of the objective at ``x``."""
        return self.evaluator.objective(self.x, self.instance.parameters)

    # Values by name ----------------------------------------------------------------------

    def value(self, name: str) -> Array:
        """Values of a variable block or an output, shape ``(items, stages)``."""
        if name in self.program.outputs:
            if name not in self._outputs:
                self._outputs[name] = self.evaluator.output(name, self.x, self.instance.parameters)
            return self._kept(self._outputs[name])
        return self.variable(name)

    def variable(self, name: str) -> Array:
        """Values of a variable block, shape ``(items, stages)``."""
        return self._kept(self._block(name, self.program.variables).read(self.x))

    def dual(self, name: str) -> Array:
        """Multipliers of a row block, shape ``(items, stages)``."""
        return self._kept(self._block(name, self.program.rows).read(self.lam_g))

    def bound_dual(self, name: str) -> Array:
        """Multipliers of a variable block's bounds, shape ``(items, stages)``."""
        return self._kept(self._block(name, self.program.variables).read(self.lam_x))

    def cone_dual(self, name: str) -> Array:
        """Multipliers of a cone block, shape ``(dimension, items, stages)``."""
        return self._kept(self._cone(name).read(self.z))

    def cone(self, name: str) -> Array:
        """Values of a cone block, shape ``(dimension, items, stages)``."""
        return self._kept(self._cone(name).read(self.cones))

    def _kept(self, values: Array) -> Array:
        """Values without the stages that are left out; blocks of a single stage are unchanged."""
        return values[..., self.skipped :] if values.shape[-1] > 1 else values

    def _cone(self, name: str) -> Cone:
        if name not in self.program.cones:
            raise ProgramError(f"unknown cone block {name!r}")
        return self.program.cones[name]

    @cached_property
    def _outputs(self) -> dict[str, Array]:
        """Values of the outputs that were asked for."""
        return {}

    @staticmethod
    def _block(name: str, blocks: Mapping[str, Block]) -> Block:
        if name not in blocks:
            raise ProgramError(f"unknown block {name!r}; available: {', '.join(sorted(blocks))}")
        return blocks[name]

    # Certificate -------------------------------------------------------------------------

    @cached_property
    def rows(self) -> Array:
        """Values of all rows at ``x``."""
        return self.evaluator.rows(self.x, self.instance.parameters)

    @cached_property
    def cones(self) -> Array:
        """Values of all cones at ``x``."""
        return self.evaluator.cones(self.x, self.instance.parameters)[0]

    @cached_property
    def primal_residual(self) -> float:
        """Largest violation of a bound, row or cone."""
        at = self.instance
        violations = [
            at.lower - self.x,
            self.x - at.upper,
            at.row_lower - self.rows,
            self.rows - at.row_upper,
        ]
        for cone in self.program.cones.values():
            values = cone.read(self.cones)
            violations.append(np.linalg.norm(values[1:], axis=0) - values[0])
        return _largest(violations)

    @cached_property
    def dual_residual(self) -> float:
        """Largest dual violation: gradient of the Lagrangian, multipliers of infinite bounds, dual cones."""
        at = self.instance
        slope = self.evaluator.gradient(self.x, at.parameters) + self.lam_x
        if self.lam_g.size:
            slope = slope + self.evaluator.jacobian(self.x, at.parameters).T @ self.lam_g
        if self.z.size:
            slope = slope - self.evaluator.cones(self.x, at.parameters)[1].T @ self.z
        violations = [np.abs(slope)]
        for multiplier, lower, upper in self._sides():
            violations.append(np.where(np.isinf(upper), multiplier, 0.0))
            violations.append(np.where(np.isinf(lower), -multiplier, 0.0))
        for cone in self.program.cones.values():
            z = cone.read(self.z)
            violations.append(np.linalg.norm(z[1:], axis=0) - z[0])
        return _largest(violations)

    @cached_property
    def gap(self) -> float:
        """Sum of the products of all multipliers with their slacks.

        For a convex program this is the difference between primal and dual objective.
        """
        gap = 0.0
        for (multiplier, lower, upper), value in zip(self._sides(), (self.x, self.rows), strict=True):
            to_upper = np.where(np.isinf(upper), 0.0, upper - value)
            to_lower = np.where(np.isinf(lower), 0.0, value - lower)
            gap += float(np.abs(np.maximum(multiplier, 0.0) * to_upper).sum())
            gap += float(np.abs(np.maximum(-multiplier, 0.0) * to_lower).sum())
        for cone in self.program.cones.values():
            products = (cone.read(self.z) * cone.read(self.cones)).sum(axis=0)
            gap += float(np.abs(products).sum())
        return gap

    def _sides(self) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]:
        at = self.instance
        return (self.lam_x, at.lower, at.upper), (self.lam_g, at.row_lower, at.row_upper)

    # Starting the next solve -------------------------------------------------------------

    def start(self) -> Start:
        """This point as the start of the same problem."""
        return Start(self.x, self.lam_x, self.lam_g, self.z, iterations=self.iterations)

    def shifted(self, stages: int = 1) -> Start:
        """This point shifted ahead in time: every block drops its first stages.

        The last stage stays in place, and the one before it is repeated to fill the gap: every
        horizon ends alike, and the multipliers of its end, where stored energy has no value, must
        not appear earlier. Blocks of a single stage are unchanged.
        """

        def source(block: Block | Cone) -> Index:
            last = block.stages - 1
            stage = np.minimum(np.arange(block.stages) + stages, max(last - 1, 0))
            stage[last] = last
            return stage

        return self.rearranged(source, moved=stages)

    def rearranged(
        self,
        source: Callable[[Block | Cone], Index],
        factor: Callable[[Block | Cone], Array | float] = lambda _: 1.0,
        moved: int = 0,
    ) -> Start:
        """This point with other stages in the place of its own.

        Parameters
        ----------
        source
            Returns, for a block, the stage from which each of its stages is taken.
        factor
            Returns, for a block, the factor of the multipliers of each of its stages.
        moved
            As in :class:`Start`.
        """

        def move(vector: Array, blocks: Iterable[Block | Cone], scaled: bool = True) -> Array:
            made = vector.copy()
            for block in blocks:
                values = block.read(vector)[..., source(block)]
                made[block.slice] = (values * factor(block) if scaled else values).ravel(order="F")
            return made

        variables = self.program.variables.values()
        return Start(
            move(self.x, variables, scaled=False),
            move(self.lam_x, variables),
            move(self.lam_g, self.program.rows.values()),
            move(self.z, self.program.cones.values()),
            moved=moved,
            iterations=self.iterations,
        )


def _largest(violations: list[Array]) -> float:
    """The largest of all violations, at least 0; NaN if one of them is NaN."""
    return float(np.max([0.0, *(v.max() for v in violations if v.size)]))
