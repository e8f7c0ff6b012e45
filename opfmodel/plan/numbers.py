"""The instance data of one solve: parameters and bounds of a compiled program."""

from __future__ import annotations

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
    """The instance data of one solve."""

    def __init__(self, model: Model, program: Program, network: PerUnitNetwork) -> None:
        self.model = model
        self.program = program
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
        if (state.role == "stock" or delay == 1) and values is not None:
            lower, upper = self._bounds(name)
            first = [0] if state.role == "stock" else horizon.roots
            lower[:, first] = upper[:, first] = values[:, None]
        if f"{name}_ramp_first" in self.program.rows:
            if values is None or delay == 1:
                lower, upper = self._bounds(f"{name}_ramp_first")
                lower[:], upper[:] = -np.inf, np.inf
            else:
                self.parameters[f"{name}_previous"] = values[state.ramped]

    def end_with(self, name: str, end: End) -> None:
        """Apply the terminal conditions to stored energy."""
        state = self.model.states[name]
        if state.is_energy:
            if end.cyclic:
                lower, upper = self._bounds(f"{name}_cyclic")
                lower[:] = upper[:] = 0.0
            if end.minimum > 0:
                lower, upper = self._bounds(f"{name}_limit" if self.model.elastic is not None else name)
                last = self.model.horizon.leaves + 1
                lower[:, last] = np.maximum(lower[:, last], end.minimum * upper[:, last])
            price = end.price / scale(f"$/{state.unit}", self.model.network.base_mva)
            self.parameters[f"{name}_end_price"] = np.array([price])

    def limit(self, name: str, lower: npt.ArrayLike, upper: npt.ArrayLike) -> None:
        """Set the bounds of a block; they broadcast to ``(items, stages)``."""
        self.lower[name], self.upper[name] = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)

    def instance(self) -> Instance:
        """Return the instance of the program."""
        return self.program.instance(self.parameters, self.lower, self.upper)
