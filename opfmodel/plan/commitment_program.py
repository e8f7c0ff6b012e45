"""The mixed-integer program of a unit commitment, from the compiled program of the dispatch.

The compiled program depends on the status of the units through parameters and bounds that are affine in it;
their coefficients are read from two instances: with all units shut down, and with all of them running. So
custom constraints and other devices that refer to what units can generate need nothing of their own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from opfmodel.errors import IncompatibleError, listed
from opfmodel.horizon import Horizon
from opfmodel.model import Model
from solvers import Evaluator, Instance, Kind, MatrixMaker, MixedInteger, Program, classify

__all__ = ["UnitProgram", "Units"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

_AFFINE = ("p_min", "p_max", "q_min", "q_max", "c0", "status")  # proportional to the status
_RAMPS = ("pg_ramp", "pg_ramp_first")
_SAME = 1e-9
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
    off, on
        The instances with all the units shut down, and with all of them running.
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
        on: Instance,
        capacity: Array,
    ) -> None:
        self.model, self.program, self.horizon, self.units = model, program, horizon, units
        structure = classify(program, off)
        if structure.kind > Kind.QUADRATIC:
            raise _not_linear(structure.culprits)
        self.off, self.on = off, on
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
        low[self.pg], high[self.pg] = self.units.p_min, self.units.p_max
        return low[self.curved], high[self.curved]

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
        base, row_lower, row_upper = self._base(q)
        self._limits_of_units()
        self._logic(lower, upper)
        self._ramps(base, row_lower, row_upper)
        self._least_capacity()
        self._tangent_rows()
        extra = self._stack()
        limits = np.array(self._limits, dtype=float).reshape(-1, 2)
        constant = self.evaluator.objective(np.zeros(n), self.off.parameters)
        return MixedInteger(
            q=q,
            constant=constant,
            a=sp.csr_array(sp.vstack([base, extra])),
            row_lower=np.concatenate([row_lower, limits[:, 0]]),
            row_upper=np.concatenate([row_upper, limits[:, 1]]),
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

    def _base(self, q: Array) -> tuple[sp.csr_array, Array, Array]:
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
        base = sp.csr_array(padded + constraints.b @ shift.tocsr())
        row_lower, row_upper = self.m.row_lower.copy(), self.m.row_upper.copy()
        self._bounds_of_rows(base, row_lower, row_upper)
        return base, row_lower, row_upper

    def _parameters(self) -> tuple[Index, Index, Array]:
        """Parameters that depend on the status, the variable of each, and the coefficients."""
        changed = np.abs(self.on.parameters - self.off.parameters) > 0
        entries, columns, changes = [], [], []
        row = np.full(len(self.model.network.generator), -1)
        row[self.units.item] = np.arange(self.units.item.size)
        for name, block in self.program.parameters.items():
            if not changed[block.slice].any() and not name.endswith(".starts"):
                continue
            kind, value = self.model.parameters.get(name, ("", ""))
            owner = row
            if value == "segment_offset":
                owner = row[self.model.network.generator.segment_owner]
            known = kind == "generator" and value in (*_AFFINE, "segment_offset", "starts")
            if not known and changed[block.slice].any():
                raise _not_linear([name], "depends on the status of the units in a way that is not known")
            if not known or block.stages != len(self.horizon):
                continue
            of, node = np.nonzero(np.broadcast_to((owner >= 0)[:, None], block.shape))
            position = block.index[of, node]
            entries.append(position)
            if value == "starts":
                columns.append(self.v[owner[of], node])
                changes.append(np.ones(of.size))
            else:
                columns.append(self.u[owner[of], node])
                changes.append(self.on.parameters[position] - self.off.parameters[position])
        if not entries:
            none = np.zeros(0, dtype=np.intp)
            return none, none, np.zeros(0)
        return np.concatenate(entries), np.concatenate(columns), np.concatenate(changes)

    def _bounds_of_rows(self, base: sp.csr_array, row_lower: Array, row_upper: Array) -> None:
        """State limits of rows that depend on the status, except those of ramps; the rows are freed."""
        shape = len(self.model.network.generator), len(self.horizon)
        for sign, on, off, limit in (
            (-1.0, self.on.row_lower, self.off.row_lower, row_lower),
            (1.0, self.on.row_upper, self.off.row_upper, row_upper),
        ):
            for name, block in self.program.rows.items():
                moved = on[block.slice] != off[block.slice]
                if name in _RAMPS or not moved.any():
                    continue
                finite = np.isfinite(on[block.slice]) & np.isfinite(off[block.slice])
                if block.shape != shape or not finite[moved].all():
                    raise _not_linear([name], "limits that depend on the status of units")
                for unit, item in enumerate(self.units.item):
                    for node, row in enumerate(block.index[item]):
                        entries = slice(base.indptr[row], base.indptr[row + 1])
                        columns = [*base.indices[entries].tolist(), int(self.u[unit, node])]
                        values = [*(sign * base.data[entries]).tolist(), sign * (off[row] - on[row])]
                        self._row(columns, values, -np.inf, sign * limit[row])
                        limit[row] = sign * np.inf

    # Units -------------------------------------------------------------------------------

    def _limits_of_units(self) -> None:
        """State the limits of what each unit generates, tighter in nodes in which it starts or stops."""
        units, own = self.units, np.zeros(self.size, dtype=bool)
        own[self.pg] = True
        moved = np.flatnonzero((self.off.lower != self.on.lower) | (self.off.upper != self.on.upper))
        for name, block in self.program.variables.items():
            if own[block.slice].any():
                continue
            if ((block.offset <= moved) & (moved < block.offset + block.size)).any():
                raise _not_linear([name], "limits that depend on the status of units")
        most = self._moves[1]
        count, nodes = units.p_min.shape
        for i in range(count):
            for k in range(nodes):
                pg, u = int(self.pg[i, k]), int(self.u[i, k])
                p_max = units.p_max[i, k]
                self._row([pg, u], [1.0, -units.p_min[i, k]], 0.0, np.inf)
                self._row([pg, u], [1.0, -p_max], -np.inf, 0.0)
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


def _not_linear(blocks: object, why: str = "") -> IncompatibleError:
    names = listed(map(repr, blocks)) if isinstance(blocks, list | tuple) else str(blocks)
    return IncompatibleError(
        f"commitment: {names}: {why or 'not linear'}: the mixed-integer program needs linear limits "
        "and costs that are linear, piecewise linear or quadratic in one quantity each"
    )
