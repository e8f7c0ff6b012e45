"""The mixed-integer program of a unit commitment, from the compiled program of the dispatch.

The compiled program depends on the status of the units through parameters and bounds that are affine in it.
Their coefficients are read from instances: one with all units shut down, and one with each of them alone
running. So custom constraints and other devices that refer to what units can generate, such as reserves, need
nothing of their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from opfmodel.errors import IncompatibleError, listed
from opfmodel.horizon import Horizon
from opfmodel.model import Model
from solvers import Block, Evaluator, Instance, Kind, MatrixMaker, MixedInteger, Program, classify

__all__ = ["UnitProgram", "Units"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

_RAMPS = ("pg_ramp", "pg_ramp_first")
_SAME = 1e-9
_NOT_BY_STAGE = "depends on the status of units, but not on that of each by itself and stage by stage"
_ENDS_SOON = 1e-6  # h


@dataclass(frozen=True)
class Units:
    """The units whose status is decided; arrays are ``(units, nodes)`` or ``(units,)``, per unit and hours.

    Attributes
    ----------
    item
        Position of each among the generators.
    available
        Whether each may run.
    before
        How long each has been running before the first node; negative: shut down; NaN if not known.
    """

    item: Index
    p_min: Array
    p_max: Array
    ramp: Array
    available: npt.NDArray[np.bool_]
    min_up: Array
    min_down: Array
    before: Array


class UnitProgram:
    """The mixed-integer program: the variables of the dispatch, then on, started and stopped, then costs.

    Parameters
    ----------
    off, alone, on
        The instances with all the units shut down, with each of them alone running, and with all of them.
    capacity
        Least total capacity of the units that run, in each node.

    Raises
    ------
    IncompatibleError
        The program is not linear, apart from separable convex quadratic costs.
    """

    def __init__(
        self,
        model: Model,
        program: Program,
        horizon: Horizon,
        units: Units,
        off: Instance,
        alone: Sequence[Instance],
        on: Instance,
        capacity: Array,
    ) -> None:
        self.model, self.program, self.horizon, self.units = model, program, horizon, units
        structure = classify(program, off)
        if structure.kind > Kind.QUADRATIC:
            raise _not_linear(structure.culprits)
        self.off, self.alone, self.on = off, alone, on
        self._check_sums()
        self.evaluator = Evaluator(program)
        maker = MatrixMaker(self.evaluator)
        self.m, running = maker.at(off), maker.at(on)
        n, (count, nodes) = program.n_variables, units.p_min.shape
        self.u, self.v, self.w = n + np.arange(3 * count * nodes).reshape(3, count, nodes)
        self.first_cost = n + 3 * count * nodes
        self.pg = program.variables["pg"].index[units.item]
        curvature = sp.coo_array(self.m.p)
        if (curvature.row != curvature.col)[curvature.data != 0].any():
            raise _not_linear(structure.culprits, "a quadratic cost of more than one quantity at a time")
        for what, one, other in (("rows", self.m.a, running.a), ("costs", self.m.p, running.p)):
            if abs(one - other).max() > _SAME:
                raise _not_linear([what], "coefficients that depend on the status of a unit")
        if np.abs(self.m.q - running.q).max(initial=0.0) > _SAME * max(1.0, np.abs(self.m.q).max(initial=0)):
            raise _not_linear(["costs"], "coefficients that depend on the status of a unit")
        self.curvature = self.m.p.diagonal()
        self.curved = np.flatnonzero(self.curvature > 0)
        self.tangents: list[tuple[int, float]] = []
        self._rows: list[tuple[Index, Index, Array]] = []
        self._limits: list[tuple[float, float]] = []
        self._capacity = capacity

    @property
    def size(self) -> int:
        """Number of variables."""
        return int(self.first_cost + self.curved.size)

    # Tangents ----------------------------------------------------------------------------

    def add_tangents(self, at: npt.ArrayLike, which: Index) -> None:
        """Add tangents of the quadratic costs of some variables at points ``(variables,)``."""
        self.tangents += zip(which.tolist(), np.asarray(at, dtype=float).tolist(), strict=True)

    def spread_tangents(self, number: int) -> None:
        """Add a number of tangents of each quadratic cost, evenly over the range of its variable."""
        low, high = self._range
        for share in np.linspace(0.0, 1.0, number):
            at = low + share * (high - low)
            finite = np.isfinite(at)
            self.add_tangents(at[finite], np.flatnonzero(finite))

    @cached_property
    def _range(self) -> tuple[Array, Array]:
        """Range of the variables with a quadratic cost."""
        low, high = np.minimum(self.off.lower, self.on.lower), np.maximum(self.off.upper, self.on.upper)
        low[self.pg], high[self.pg] = self._running
        return low[self.curved], high[self.curved]

    @cached_property
    def _running(self) -> tuple[Array, Array]:
        """Limits of each unit while it runs: those of its bounds, unless its dispatch is given."""
        low, high = self.on.lower[self.pg], self.on.upper[self.pg]
        given = (low == self.off.lower[self.pg]) & (high == self.off.upper[self.pg])
        return np.where(given, self.units.p_min, low), np.where(given, self.units.p_max, high)

    def curve(self, x: Array) -> tuple[Array, Array]:
        """Return the quadratic costs at a point, and what the tangents make of them."""
        exact = 0.5 * self.curvature[self.curved] * x[self.curved] ** 2
        return exact, x[self.first_cost :]

    # Program -----------------------------------------------------------------------------

    def mixed(self) -> MixedInteger:
        """Return the program with the tangents so far."""
        self._rows, self._limits = [], []
        lower, upper = np.full(self.size, 0.0), np.full(self.size, np.inf)
        n = self.program.n_variables
        lower[:n] = np.minimum(self.off.lower, self.on.lower)
        upper[:n] = np.maximum(self.off.upper, self.on.upper)
        upper[n : self.first_cost] = 1.0
        lower[self.first_cost :] = -np.inf
        q = np.zeros(self.size)
        q[:n], q[self.first_cost :] = self.m.q, 1.0
        base, row_lower, row_upper = self._base(q), self.m.row_lower.copy(), self.m.row_upper.copy()
        limits = {"row_lower": row_lower, "row_upper": row_upper, "lower": lower, "upper": upper}
        self._bounds(base, limits)
        self._limits_of_units()
        self._logic(lower, upper)
        self._ramps(base, row_lower, row_upper)
        self._least_capacity()
        self._tangent_rows()
        extra = self._stack()
        stated = np.array(self._limits, dtype=float).reshape(-1, 2)
        constant = self.evaluator.objective(np.zeros(n), self.off.parameters)
        return MixedInteger(
            q=q,
            constant=constant,
            a=sp.csr_array(sp.vstack([base, extra])),
            row_lower=np.concatenate([row_lower, stated[:, 0]]),
            row_upper=np.concatenate([row_upper, stated[:, 1]]),
            lower=lower,
            upper=upper,
            binary=np.arange(n, self.first_cost),
        )

    def _row(self, columns: list[int], values: list[float], low: float, high: float) -> None:
        at = np.full(len(columns), len(self._limits), dtype=np.intp)
        self._rows.append((at, np.array(columns, dtype=np.intp), np.array(values, dtype=float)))
        self._limits.append((low, high))

    def _stack(self) -> sp.csr_array:
        shape = len(self._limits), self.size
        if not self._rows:
            return sp.csr_array(shape)
        rows, columns, values = (np.concatenate(part) for part in zip(*self._rows, strict=True))
        return sp.coo_array((values, (rows, columns)), shape=shape).tocsr()

    def _base(self, q: Array) -> sp.csr_array:
        """Return the rows of the dispatch with the coefficients of the status, which ``q`` gets too."""
        assembly = self.evaluator.assembly
        costs, constraints = assembly.costs, assembly.constraints
        entry, column, change = self._parameters()
        touched = np.zeros(self.program.n_parameters, dtype=bool)
        touched[entry] = True
        for placement in (*costs.rest, *constraints.rest):
            if touched[placement.parameters].any():
                raise _not_linear([placement.block], "a product with the status of a unit")
        if abs(costs.hxp[:, entry]).sum() or abs(costs.hpp[:, entry]).sum():
            raise _not_linear(["costs"], "a product with the status of a unit")
        np.add.at(q, column, costs.gp[entry] * change)
        shift = sp.coo_array((change, (entry, column)), shape=(self.program.n_parameters, self.size))
        padded = sp.hstack(
            [self.m.a, sp.csr_array((self.program.n_rows, self.size - self.program.n_variables))]
        )
        return sp.csr_array(padded + constraints.b @ shift.tocsr())

    def _parameters(self) -> tuple[Index, Index, Array]:
        """Parameters that depend on the status, the variable of each, and the coefficients."""
        blocks, generator = self.program.parameters, self.model.network.generator
        node = _nodes(blocks, self.program.n_parameters, len(self.horizon))
        entries, columns, changes = [], [], []
        for unit, alone in enumerate(self.alone):
            moved = np.flatnonzero(alone.parameters != self.off.parameters)
            if (node[moved] < 0).any():
                raise _not_linear(_named(blocks, moved[node[moved] < 0]), _NOT_BY_STAGE)
            entries.append(moved)
            columns.append(self.u[unit, node[moved]])
            changes.append((alone.parameters - self.off.parameters)[moved])
        for name, block in blocks.items():
            if self.model.parameters.get(name) == (generator.kind.kind, "starts"):
                entries.append(block.index[self.units.item].ravel())
                columns.append(self.v.ravel())
                changes.append(np.ones(self.v.size))
        none = np.zeros(0, dtype=np.intp)
        return (
            np.concatenate([none, *entries]),
            np.concatenate([none, *columns]),
            np.concatenate([[], *changes]),
        )

    def _check_sums(self) -> None:
        """Raise an error unless what all units change is the sum of what each of them does."""
        blocks = {"parameters": self.program.parameters, "row_lower": self.program.rows}
        blocks |= {"row_upper": self.program.rows, "lower": self.program.variables}
        blocks |= {"upper": self.program.variables}
        for side, named in blocks.items():
            off, on = getattr(self.off, side), getattr(self.on, side)
            finite = np.isfinite(off) & np.isfinite(on)
            total = off[finite] + sum((getattr(a, side)[finite] - off[finite] for a in self.alone), 0.0)
            wrong = np.abs(total - on[finite]) > 1e-7 * np.maximum(1.0, np.abs(on[finite]))
            if wrong.any():
                raise _not_linear(_named(named, np.flatnonzero(finite)[wrong]), _NOT_BY_STAGE)

    def _bounds(self, base: sp.csr_array, limits: Mapping[str, Array]) -> None:
        """State limits that depend on the status, except those of what units generate and of its ramps.

        Parameters
        ----------
        base
            The rows.
        limits
            The sides of rows and variables, which are freed where a limit is stated here.
        """
        program, n = self.program, self.program.n_variables
        most = self.units.p_max.max(axis=1, initial=0.0).sum() + self.model.network.generator.p_max.sum()
        offset = self.evaluator.rows(np.zeros(n), self.off.parameters)
        for side, limit in limits.items():
            rows = side.startswith("row_")
            blocks = program.rows if rows else program.variables
            node = _nodes(blocks, limit.size if rows else n, len(self.horizon))
            own = np.zeros(node.size, dtype=bool)
            for name in _RAMPS if rows else ("pg",):
                if name in blocks:
                    own[blocks[name].slice] = True
            sign = 1.0 if side.endswith("upper") else -1.0
            off = np.clip(getattr(self.off, side), -most, most)
            terms: dict[int, list[tuple[int, float]]] = {}
            for unit, alone in enumerate(self.alone):
                moved = np.flatnonzero((getattr(alone, side) != getattr(self.off, side)) & ~own)
                if (node[moved] < 0).any():
                    raise _not_linear(_named(blocks, moved[node[moved] < 0]), _NOT_BY_STAGE)
                # what has no limit while a unit runs is at most what all units can generate
                change = np.clip(getattr(alone, side)[moved], -most, most) - off[moved]
                for at, step in zip(moved.tolist(), change.tolist(), strict=True):
                    terms.setdefault(at, []).append((int(self.u[unit, node[at]]), step))
            for at, entries in terms.items():
                columns, values = [at], [1.0]
                if rows:
                    part = slice(base.indptr[at], base.indptr[at + 1])
                    columns, values = base.indices[part].tolist(), base.data[part].tolist()
                columns += [column for column, _ in entries]
                values = [*(sign * value for value in values), *(-sign * step for _, step in entries)]
                self._row(columns, values, -np.inf, sign * (off[at] - (offset[at] if rows else 0.0)))
                limit[at] = sign * np.inf

    # Units -------------------------------------------------------------------------------

    def _limits_of_units(self) -> None:
        """State the limits of what each unit generates, tighter in nodes in which it starts or stops."""
        units, (low, high) = self.units, self._running
        most = self._moves[1]
        count, nodes = units.p_min.shape
        for i in range(count):
            for k in range(nodes):
                pg, u = int(self.pg[i, k]), int(self.u[i, k])
                p_max = high[i, k]
                self._row([pg, u], [1.0, -low[i, k]], 0.0, np.inf)
                self._row([pg, u], [1.0, -p_max], -np.inf, 0.0)
                if self.model.elastic is not None:  # ramps may be exceeded
                    continue
                if k and p_max > most[i, k]:  # implied by the ramps, but not where a status is a fraction
                    self._row([pg, u, int(self.v[i, k])], [1.0, -p_max, p_max - most[i, k]], -np.inf, 0.0)
                if k + 1 < nodes and p_max > most[i, k + 1]:
                    self._row(
                        [pg, u, int(self.w[i, k + 1])], [1.0, -p_max, p_max - most[i, k + 1]], -np.inf, 0.0
                    )

    @cached_property
    def _moves(self) -> tuple[Array, Array]:
        """Most that each unit moves from the node before while it runs, and when it starts or stops."""
        horizon, ramp = self.horizon, self.units.ramp
        hours = horizon.hours.copy()
        hours[1:] = 0.5 * (horizon.hours[1:] + horizon.hours[:-1])
        running = ramp * hours
        return running, np.maximum(running, self.units.p_min)

    def _logic(self, lower: Array, upper: Array) -> None:
        """State when units start and stop, and for how long they then run or not."""
        units, horizon = self.units, self.horizon
        begins = horizon.step * horizon.base
        count, nodes = units.p_min.shape
        upper[self.u] = units.available
        for i in range(count):
            before = units.before[i]
            for k in range(nodes):
                u, v, w = (int(block[i, k]) for block in (self.u, self.v, self.w))
                if k:
                    self._row([u, int(self.u[i, k - 1]), v, w], [1.0, -1.0, -1.0, 1.0], 0.0, 0.0)
                elif np.isnan(before):
                    upper[v] = upper[w] = 0.0
                else:
                    was = float(before > 0)
                    self._row([u, v, w], [1.0, -1.0, 1.0], was, was)
                for moved, least, sign, most in (
                    (self.v, units.min_up[i], -1.0, 0.0),
                    (self.w, units.min_down[i], 1.0, 1.0),
                ):
                    recent = np.flatnonzero(begins[: k + 1] > begins[k] - least + _ENDS_SOON)
                    since = moved[i, recent if recent.size else [k]].tolist()
                    self._row([*since, u], [*([1.0] * len(since)), sign], -np.inf, most)
                if before > 0 and begins[k] < units.min_up[i] - before - _ENDS_SOON:
                    lower[u] = 1.0
                if before < 0 and begins[k] < units.min_down[i] + before - _ENDS_SOON:
                    upper[u] = 0.0

    def _ramps(self, base: sp.csr_array, row_lower: Array, row_upper: Array) -> None:
        """State the ramps of the units in place of those of the dispatch."""
        ramped = self.model.states["pg"].ramped
        if ramped is None or not ramped.size:
            return
        running, moving = self._moves
        for name in _RAMPS:
            if name not in self.program.rows:
                continue
            block = self.program.rows[name]
            first = name == "pg_ramp_first"
            for position, item in enumerate(ramped):
                at = np.flatnonzero(self.units.item == item)
                if not at.size:
                    continue
                i = int(at[0])
                for column, row in enumerate(block.index[position]):
                    k = column if first else column + 1
                    free = np.isinf(self.off.row_upper[row])
                    offset = 0.0 if free else self.off.row_upper[row] - row_upper[row]
                    row_lower[row], row_upper[row] = -np.inf, np.inf
                    if free or np.isinf(running[i, k]):
                        continue
                    one, more = running[i, k], moving[i, k] - running[i, k]
                    entries = slice(base.indptr[row], base.indptr[row + 1])
                    columns, values = base.indices[entries].tolist(), base.data[entries].tolist()
                    u, v, w = (int(block[i, k]) for block in (self.u, self.v, self.w))
                    if first:
                        self._row([*columns, v], [*values, -more], -np.inf, one - offset)
                        self._row([*columns, w], [*values, more], -one - offset, np.inf)
                    else:
                        last = int(self.u[i, k - 1])
                        self._row([*columns, last, v], [*values, -one, -moving[i, k]], -np.inf, 0.0)
                        self._row([*columns, u, w], [*values, one, moving[i, k]], 0.0, np.inf)

    def _least_capacity(self) -> None:
        for k in np.flatnonzero(self._capacity > 0):
            self._row(self.u[:, k].tolist(), self.units.p_max[:, k].tolist(), self._capacity[k], np.inf)

    def _tangent_rows(self) -> None:
        """State that each quadratic cost is above its tangents, which are scaled by the status of a unit."""
        n = self.program.n_variables
        status = np.full(n, -1)
        status[self.pg] = self.u
        for which, t in self.tangents:
            variable, cost = int(self.curved[which]), self.first_cost + which
            slope = self.curvature[variable] * t
            if status[variable] >= 0:
                columns, values = [cost, variable, int(status[variable])], [1.0, -slope, 0.5 * slope * t]
                self._row(columns, values, 0.0, np.inf)
            else:
                self._row([cost, variable], [1.0, -slope], -0.5 * slope * t, np.inf)
        for which in range(self.curved.size):
            self._row([self.first_cost + which], [1.0], 0.0, np.inf)


def _nodes(blocks: Mapping[str, Block], size: int, nodes: int) -> Index:
    """Return the node of each entry of a vector, -1 in blocks that do not have one column per node."""
    made = np.full(size, -1, dtype=np.intp)
    for block in blocks.values():
        if block.stages == nodes:
            made[block.index] = np.arange(nodes)
    return made


def _named(blocks: Mapping[str, Block], at: Index) -> list[str]:
    """Return the names of the blocks with some entries of a vector."""
    return [
        name
        for name, block in blocks.items()
        if ((block.offset <= at) & (at < block.offset + block.size)).any()
    ]


def _not_linear(blocks: object, why: str = "") -> IncompatibleError:
    names = listed(map(repr, blocks)) if isinstance(blocks, list | tuple) else str(blocks)
    return IncompatibleError(
        f"commitment: {names}: {why or 'not linear'}: the mixed-integer program needs linear limits "
        "and costs that are linear, piecewise linear or quadratic in one quantity each"
    )
