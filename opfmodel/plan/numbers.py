"""The instance data of one solve: parameters and bounds of a compiled program."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from opfmodel.errors import ModelError
from opfmodel.model.declared import resolved
from opfmodel.model.model import Model, number_of
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.network.units import scale
from opfmodel.plan.end import End
from solvers import Instance, Program

__all__ = ["Numbers"]

Array = npt.NDArray[np.float64]


class Numbers:
    """The instance data of one solve.

    Parameters
    ----------
    network
        Arrays of the network with the series of all stages of the program.
    begin
        Stage of the program at which the plan begins; see :mod:`opfmodel.plan.shrinking`.
    freed
        Rows that are not in force.
    """

    def __init__(
        self,
        model: Model,
        program: Program,
        network: PerUnitNetwork,
        begin: int = 0,
        freed: npt.NDArray[np.bool_] | None = None,
    ) -> None:
        self.model = model
        self.program = program
        self.network = network
        self.begin, self.freed = begin, freed
        self.parameters: dict[str, Array] = {
            name: number_of(resolved(network.tables[kind], value), network)
            for name, (kind, value) in model.parameters.items()
        }
        self.lower: dict[str, Array] = {}
        self.upper: dict[str, Array] = {}
        changed = {kind for kind, table in network.tables.items() if table is not model.network.tables[kind]}
        for name, source in model.bounds.items():
            if source.kind in changed:
                low, high = source.resolve(network.tables[source.kind])
                self.lower[name], self.upper[name] = low, high

    def _bounds(self, name: str) -> tuple[Array, Array]:
        """Return the bounds of a block as writable arrays."""
        block = self.program.variables.get(name) or self.program.rows[name]
        for side, default in ((self.lower, block.lower), (self.upper, block.upper)):
            side[name] = np.array(block.spread(side.get(name, default)))
        return self.lower[name], self.upper[name]

    def start_from(self, name: str, values: Array | None) -> None:
        """Fix the initial value of a state, or leave it free."""
        state, delay, horizon = self.model.states[name], self.model.delay, self.model.horizon
        if values is not None:
            values = np.asarray(values, dtype=float)
            if values.shape != (self.program.variables[name].items,) or not np.isfinite(values).all():
                raise ModelError(
                    f"initial {name}: must be one number per {state.kind}, "
                    f"{self.program.variables[name].items} in total, not {values!r}"
                )
        late = delay == 1 and state.role == "dispatch"
        if (state.role == "stock" or late) and values is not None:
            lower, upper = self._bounds(name)
            start = [self.begin] if state.role == "stock" or self.begin else horizon.roots
            lower[:, start] = upper[:, start] = values[:, None]
            if state.role == "stock":  # a cyclic end refers to the first point
                lower[:, 0] = upper[:, 0] = values
        elif state.role == "stock" and self.begin and len(self.model.network.tables[state.kind]):
            raise ModelError(
                f"initial {name}: must be given for a plan that ends with the data (at_end = 'shrink')"
            )
        given = values is not None and not late
        begun = np.isin(self.model.starts, [self.begin] if self.begin else horizon.roots)
        free = ~begun if given else np.ones_like(begun)
        for rows in state.first:
            if free.any():
                lower, upper = self._bounds(rows)
                lower[:, free], upper[:, free] = -np.inf, np.inf
        if state.first and values is not None and not late:
            self.parameters[f"{name}_previous"] = values[state.ramped]

    def end_with(self, name: str, end: End, out: npt.NDArray[np.bool_]) -> None:
        """Apply the terminal conditions to stored energy, except where the storage is out of service."""
        state = self.model.states[name]
        if state.ends:
            if end.cyclic:
                lower, upper = self._bounds(f"{name}_cyclic")
                lower[~out] = upper[~out] = 0.0
            if end.minimum > 0:
                limited = f"{name}_limit" in self.program.rows  # in an elastic problem
                lower, _ = self._bounds(f"{name}_limit" if limited else name)
                leaves = self.model.horizon.leaves
                capacity = resolved(self.network.tables[state.kind], state.capacity)
                capacity = np.broadcast_to(capacity, (len(lower), self.model.stages))[:, leaves]
                least = np.where(out[:, None], 0.0, end.minimum)
                lower[:, leaves + 1] = np.maximum(lower[:, leaves + 1], least * capacity)
            price = end.price / scale(f"$/{state.unit}", self.model.network.base_mva)
            self.parameters[f"{name}_end_price"] = np.array([price])

    def limit(self, name: str, lower: npt.ArrayLike, upper: npt.ArrayLike) -> None:
        """Set the bounds of a block; they broadcast to the items and the stages of the plan.

        Entries that are NaN leave a bound as it is.
        """
        low, high = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
        if np.isnan(low).any() or np.isnan(high).any():
            known = [bound[:, self.begin :] for bound in self._bounds(name)]
            low, high = np.where(np.isnan(low), known[0], low), np.where(np.isnan(high), known[1], high)
        if self.begin and (low.ndim or high.ndim):
            every = self._bounds(name)
            every[0][:, self.begin :], every[1][:, self.begin :] = low, high
        else:
            self.lower[name], self.upper[name] = low, high

    def instance(self) -> Instance:
        """Return the instance of the program."""
        instance = self.program.instance(self.parameters, self.lower, self.upper)
        if self.freed is None or not self.freed.any():
            return instance
        return replace(
            instance,
            row_lower=np.where(self.freed, -np.inf, instance.row_lower),
            row_upper=np.where(self.freed, np.inf, instance.row_upper),
        )
