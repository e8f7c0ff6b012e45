"""Sweeps over overlapping windows in time, until what they say about their seams agrees."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from solvers.assembly import Evaluator
from solvers.program import Array, Index, Instance
from solvers.solution import Start
from solvers.windows.chain import Chain, Found, Sessions
from solvers.windows.partition import Partition
from solvers.windows.piece import End, Piece
from solvers.windows.seam import Seam
from solvers.windows.window import Window

__all__ = ["Asked", "Sweep", "Sweeps"]

# What is given before a chain, and the ends and starting points of its windows.
Asked = tuple[Array | None, list[End | None], list[Start | None]]

_SAME = 1e-9  # p.u.: change of what a window hands on that is none
_FAR = 1.0  # p.u.: range of a variable without bounds, beside its magnitude


@dataclass(frozen=True)
class Sweep:
    """What a sweep achieved.

    Attributes
    ----------
    objective
        Of the solution after it.
    gap
        Bound on the distance from the optimum that the seams allow, relative to the objective.
    jump
        Largest primal jump at a seam.
    iterations
        Of all windows.
    seconds
        Since the beginning.
    """

    number: int
    objective: float
    gap: float
    jump: float
    iterations: int
    seconds: float

    def __str__(self) -> str:
        return (
            f"sweep {self.number}: objective {self.objective:.8g}, gap {self.gap:.1e}, jump {self.jump:.1e}, "
            f"{self.iterations} iterations, {self.seconds:.1f} s"
        )


class Sweeps:
    r"""Sweeps over the windows of a program, until they agree at the seams.

    In each sweep a chain of windows is solved from its first to its last, each from where the one before it
    ends, while the price of its end is that of the sweep before. What remains is the difference
    :math:`\delta` of the two prices of each seam, that of the window behind it less that of the window
    before. It is the gradient of the Lagrangian, so for a convex program with seam variables within
    :math:`[l, u]` the objective exceeds its optimum by at most

    .. math:: \sum \max(\delta, 0) (x - l) + \max(-\delta, 0) (u - x)

    That, and the primal jumps between chains at their price, is the gap. Jumps end with a last pass over the
    windows behind them.

    Parameters
    ----------
    solve
        Takes what is given before each chain and the ends of its windows, and sweeps all chains.
    proximal
        Weight of the proximal term of a variable at a seam, relative to its price over its range.
    start
        A point of the whole program, whose multipliers price the first sweep.
    """

    def __init__(
        self,
        partition: Partition,
        instance: Instance,
        solve: Callable[[Sequence[Asked]], list[list[Found]]],
        evaluator: Evaluator,
        proximal: float,
        start: Start | None = None,
    ) -> None:
        self._partition, self._instance, self._solve = partition, instance, solve
        self._evaluator, self._proximal = evaluator, proximal
        self._began = time.perf_counter()
        program = partition.staged.program
        self.x = (instance.start if start is None else start.x).copy()
        self._start = start
        sizes = (program.n_variables, program.n_rows, program.n_cone_values)
        known = (None,) * 3 if start is None else (start.lam_x, start.lam_g, start.z)
        self.lam_x, self.lam_g, self.z = (
            np.zeros(size) if own is None else own.copy() for size, own in zip(sizes, known, strict=True)
        )
        self.trace: list[Sweep] = []
        self.iterations = 0
        self.failed: tuple[Window, Found] | None = None
        self._found: list[Found] = []  # of the windows in the order of time
        staged = partition.staged
        inner = [window for window in partition.windows if window.span.end < staged.stages]
        self._ends = {
            w.span.last: Seam.after(staged, w.span.last - 1, instance) for w in inner if w.behind.size
        }
        self._joints = {w.span.end: Seam.after(staged, w.span.end - 1, instance) for w in inner}

    def sweep(self) -> None:
        """Solve every window once."""
        found = self._solve([self._asked(chain) for chain in self._partition.chains])
        for chain, results in zip(self._partition.chains, found, strict=True):
            for window, result in zip(chain, results, strict=False):
                self._take(window, result)
        if self.failed is not None:
            return
        self._start = self._point()
        self._found = [result for results in found for result in results]
        self.trace.append(self._measured(len(self.trace) + 1))

    def done(self, tolerance: float) -> bool:
        """Whether a window has failed, or the gap is within a tolerance."""
        return self.failed is not None or bool(self.trace and self.trace[-1].gap <= tolerance)

    @property
    def seconds(self) -> float:
        """Time since the beginning."""
        return time.perf_counter() - self._began

    def close(self, windows: Sequence[Window], sessions: Sessions) -> None:
        """Remove primal jumps: solve windows again that begin where the one before them ends.

        The gap of the last sweep is measured again.

        Parameters
        ----------
        windows
            Those from the second chain on, none of which is extended to the left. Where one hands on what
            it handed on before, those that follow stay as they are, to the beginning of the next chain.
        """
        led = {chain[0].span.begin for chain in self._partition.chains}
        came, first = True, len(self._found) - len(windows)
        for number, window in enumerate(windows, first):
            came = came or window.span.begin in led
            if not came:
                continue
            handed = self._joints.get(window.span.end)
            chain = Chain(sessions, [Piece.of(window, self._instance)])
            before = None if handed is None else self.x[handed.variables]
            start = window.start(self._point())
            result = chain.solve(0, self.x[window.before], self._end(window), start)
            self._take(window, result)
            self._found[number] = result
            if self.failed is not None:
                return
            if handed is not None and before is not None:
                came = bool((np.abs(self.x[handed.variables] - before) > _SAME).any())
        self.trace[-1] = self._measured(len(self.trace))

    def _take(self, window: Window, result: Found) -> None:
        """Put what a window found into the solution."""
        self.iterations += result.iterations
        variables, rows, cones = window.own
        self.x[variables], self.lam_x[variables] = result.x, result.lam_x
        self.lam_g[rows], self.z[cones] = result.lam_g, result.z
        if not result.status.is_optimal:
            self.failed = self.failed or (window, result)

    def _asked(self, chain: Sequence[Window]) -> Asked:
        starts = [None if self._start is None else window.start(self._start) for window in chain]
        if self._start is None or self._start.lam_g is None:
            return None, [None] * len(chain), starts
        return self.x[chain[0].before], [self._end(window) for window in chain], starts

    def _point(self) -> Start:
        """Return the solution as a start: in its overlap a window starts where those behind it stand."""
        # the ends of windows have changed; a point that is trusted more takes two to three times as long
        return Start(self.x, self.lam_x, self.lam_g, self.z, moved=1)

    def _end(self, window: Window) -> End:
        """Return what the end of a window is worth by the last sweep."""
        if not window.behind.size:
            return End.free(0)
        price = self._ends[window.span.last].price(self.x, self.lam_g)
        width = np.maximum(sum(self._range(window.behind)), 1e-9)
        return End(price, self._proximal * np.abs(price) / width, self.x[window.behind])

    def _range(self, variables: Index) -> tuple[Array, Array]:
        """Return how far the optimum can lie below and above the solution."""
        x, at = self.x[variables], self._instance
        lower, upper = at.lower[variables], at.upper[variables]
        far = _FAR + np.abs(x)
        below = np.where(np.isinf(lower), far, x - lower)
        above = np.where(np.isinf(upper), far, upper - x)
        return np.maximum(below, 0.0), np.maximum(above, 0.0)

    def _measured(self, number: int) -> Sweep:
        """Return what a sweep achieved, from what all windows found."""
        total, largest = 0.0, 0.0
        for window, result in zip(self._partition.windows, self._found, strict=True):
            joint = self._joints.get(window.span.end)
            if joint is not None and joint.variables.size:
                slope = joint.price(self.x, self.lam_g) - result.price
                below, above = self._range(joint.variables)
                total += float(np.maximum(slope, 0.0) @ below + np.maximum(-slope, 0.0) @ above)
            if result.joint.size:
                before = self._joints[window.span.begin]
                jump = np.abs(self.x[before.variables] - result.joint)
                total += float(jump @ np.abs(before.price(self.x, self.lam_g)))
                largest = max(largest, float(jump.max()))
        objective = self._evaluator.objective(self.x, self._instance.parameters)
        gap = total / max(abs(objective), 1e-9)
        iterations = sum(result.iterations for result in self._found)
        return Sweep(number, objective, gap, largest, iterations, self.seconds)
