"""Storages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.devices.capability import active_bounds, limit_to_capability
from opfmodel.errors import IncompatibleError
from opfmodel.model import Bound, BoundSource, Device, Model, Soft, Stage
from opfmodel.network.arrays import Array, Index, Table
from opfmodel.network.components import Storage
from solvers import Expression, Rows, largest, total

__all__ = ["StorageDevice"]

_OVERLAP = 1e-6  # p_c p_d relative to its maximum: an exact zero would leave IPOPT no interior


class StorageDevice(Device):
    r"""Storages with efficiencies, standing loss and an optional inverter circle or capability curve.

    Positive power charges. Without losses :math:`e(k+1) = e(k) + \Delta\, p^s(k)`. With losses

    .. math::
        p^s = p^c - p^d, \quad p^c, p^d \ge 0, \quad
        e(k+1) = (1 - \sigma \Delta)\, e(k) + \Delta\, (\eta_c p^c - p^d / \eta_d)

    which is a relaxation: simultaneous charging and discharging wastes energy, and pays only
    where energy has a negative value. ``exclusive`` forbids it (:math:`p^c p^d \le \epsilon`), at
    the price of a non-convex row.

    Energy that is wanted at an hour is a minimum of :math:`e(k+1)` in the stage that ends then. With a
    recovery cost the limits of energy give way to :math:`\underline e - o \le e(k+1) \le \bar e + o`.

    Cost: :math:`\pi_t |p^s| + \pi_r o`.
    """

    component = Storage

    def declare(self, model: Model, table: Table) -> None:
        """Declare ``ps``, ``qs`` and ``e``."""
        n, step = len(table), model.step
        rated: tuple[Bound, Bound] = (_lowest, _highest)
        low, high = active_bounds(model, table, *(("power_min", "power_max") if model.reactive else rated))
        ps = model.variable("storage", "ps", low, high, unit="MW", description="charging power")
        recovers = np.isfinite(table.recovery_cost[:, 0])
        limits: tuple[Bound, Bound] = ("energy_min", "energy")
        if recovers.any():
            limits = _hard(recovers, "energy_min", -np.inf), _hard(recovers, "energy", np.inf)
        e, e_next = model.stock(
            "storage", "e", *limits,
            initial="initial", unit="MWh", description="stored energy", capacity="energy",
        )  # fmt: skip
        qs = None
        if model.reactive:
            qs = model.variable(
                "storage", "qs", "q_min", "q_max", unit="MVAr", description="reactive power drawn"
            )
        limit_to_capability(model, table, ps, qs)
        model.inject(table.bus, p=-ps, q=None if qs is None else -qs)
        for power in (ps, qs):
            if power is not None:
                model.regularise(power)
        if not n:
            return
        self._want(model, table, e_next)
        if recovers.any():
            self._recover(model, recovers, e_next)
        model.price(
            "storage",
            "e_price",
            lambda solution, _: solution.dual("e_dynamics"),
            "$/MWh",
            "value of one more MWh stored at the end of the stage",
            rate=False,
        )
        kept = 1.0 - step * table.standing_loss
        gone = np.flatnonzero((kept < 0.0).any(axis=1))
        if gone.size:
            first, longest = gone[0], float(np.max(step))
            raise IncompatibleError(
                f"{table.names[first]}: standing_loss = {table.standing_loss[first, 0]:g}: loses more than "
                f"is stored in a stage of {longest:g} h; must be at most {1.0 / longest:g} per hour",
                "network", "storages", table.names[first], "standing_loss",
            )  # fmt: skip
        change = e_next - kept * e
        lossy = table.charge_efficiency * table.discharge_efficiency < 1.0
        dynamics = model.build.rows("e_dynamics", n, model.stages)
        model.build.add(change, into=dynamics)
        ideal = np.flatnonzero(~lossy)
        if ideal.size:
            model.build.add(-step * ps[ideal], into=dynamics[ideal])
        split = np.flatnonzero(lossy)
        if split.size:
            self._split(model, table, split, dynamics, ps)
        circle = np.flatnonzero(np.isfinite(table.rating))
        if qs is not None and circle.size:
            model.build.cone(
                "storage_rating", model.field("storage", "rating")[circle], ps[circle], qs[circle]
            )

    @staticmethod
    def _want(model: Model, table: Table, e_next: Expression) -> None:
        """State what is wanted at given hours of storages in service, in every stage but contingencies."""
        wanted = np.flatnonzero(np.isfinite(table.wanted))
        if not wanted.size:
            return
        regular = np.arange(len(model.horizon.regular))
        soft = Soft("wanted energy", wanted, "MWh", "is {} short of what is wanted", price="balance")

        def least(t: Table) -> Array:
            return np.where(t.status[wanted] > 0, t.energy_wanted[wanted], 0.0)

        model.rows("storage", "e_wanted", e_next[wanted][:, regular], least, np.inf, soft, regular)

    @staticmethod
    def _recover(model: Model, recovers: npt.NDArray[np.bool_], e_next: Expression) -> None:
        """Declare the energy outside the limits of storages that may recover, in every stage."""
        outside = model.variable(
            "storage", "storage_outside", 0.0, np.where(recovers, np.inf, 0.0)[:, None],
            unit="MWh", description="stored energy outside its limits at the end of a stage", start=0.0,
        )  # fmt: skip
        items = np.flatnonzero(recovers)

        def low(t: Table) -> Array:
            return np.asarray(t.energy_min[items])

        def high(t: Table) -> Array:
            return np.asarray(t.energy[items])

        model.rows("storage", "e_recovery_low", e_next[items] + outside[items], low, np.inf)
        model.rows("storage", "e_recovery_high", e_next[items] - outside[items], -np.inf, high)
        after = model.horizon.contingencies
        if after.size:  # it costs nothing there
            more = outside[items][:, after] - outside[items][:, model.horizon.owner[after]]
            model.rows("storage", "e_recovery_after", more, -np.inf, 0.0, nodes=after)

    def cost(self, stage: Stage) -> Any:
        """Return the cost of throughput and of energy outside its limits, $/h; None without either."""
        storage, cost = stage.storage, None
        rate = storage.throughput_cost
        priced: Any = slice(None)
        if not isinstance(rate, Expression):
            priced = np.flatnonzero(rate.any(axis=1))
            rate = rate[priced]
        if rate.shape[0]:
            ps = storage.ps[priced]
            cost = total(rate * largest(ps, -ps))
        recovery = np.where(np.isfinite(storage.recovery_cost), storage.recovery_cost, 0.0)
        if recovery.any() and stage.has("storage_outside"):
            recovering = total(recovery * storage.storage_outside)
            cost = recovering if cost is None else cost + recovering
        return cost

    @staticmethod
    def _split(model: Model, table: Table, split: Index, dynamics: Rows, ps: Expression) -> None:
        """Split the power of storages with losses into charging and discharging."""
        n, stages, step = split.size, model.stages, model.step

        def charging(t: Table) -> Array:
            return np.asarray(np.maximum(t.power_max[split], 0.0))

        def discharging(t: Table) -> Array:
            return np.asarray(np.maximum(-t.power_min[split], 0.0))

        most_charge, most_discharge = charging(table), discharging(table)
        charge = model.build.variable("pc", n, stages, 0.0, most_charge)
        discharge = model.build.variable("pdis", n, stages, 0.0, most_discharge)
        # both follow the time series of the limits
        model.bounds["pc"] = BoundSource("storage", 0.0, charging)
        model.bounds["pdis"] = BoundSource("storage", 0.0, discharging)
        model.build.constrain("ps_split", ps[split] - charge + discharge == 0.0)
        gain, drain = table.charge_efficiency[split], 1.0 / table.discharge_efficiency[split]
        model.build.add(-step * (gain * charge - drain * discharge), into=dynamics[split])
        exclusive = np.flatnonzero(table.exclusive[split])
        if exclusive.size:
            least = _OVERLAP * most_charge[exclusive] * most_discharge[exclusive]
            rows = model.build.rows("storage_exclusive", exclusive.size, stages, -np.inf, least)
            model.build.add(charge[exclusive] * discharge[exclusive], into=rows)


def _hard(recovers: npt.NDArray[np.bool_], field: str, free: float) -> Callable[[Table], Array]:
    """Return a limit of the energy that only storages without a recovery cost have."""
    return lambda table: np.where(recovers[:, None], free, table.arrays[field])


def _lowest(table: Table) -> Array:
    """Return the minimum charging power if no reactive power shares the rating."""
    return np.asarray(np.maximum(table.power_min, -table.rating))


def _highest(table: Table) -> Array:
    """Return the maximum charging power if no reactive power shares the rating."""
    return np.asarray(np.minimum(table.power_max, table.rating))
