"""The result of a power flow, in physical units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import Times
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.network.components import Branch, Bus, Generator
from opfmodel.network.network import Network

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["PowerFlowResult"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PowerFlowResult:
    """The state of a network at its set-points.

    Attributes
    ----------
    status
        ``converged`` or ``diverged``. A power flow that diverged has NaN for all quantities.
    max_mismatch
        Largest active or reactive power that is missing in the balance of a bus at the last point, MVA.
    iterations
        Steps of Newton's method, over all attempts.
    slack
        Active power by which the generators of each island exceed their set-points, MW, by the name of
        its reference bus.
    limited
        Buses whose generators are at a limit of reactive power and do not hold their voltage.
    notes
        What was left out of the network and chosen for it.
    """

    network: Network
    status: str
    max_mismatch: float
    iterations: int
    slack: Mapping[str, float]
    limited: tuple[str, ...]
    notes: tuple[str, ...]
    _times: Times = field(repr=False)
    _arrays: PerUnitNetwork = field(repr=False)
    _quantities: Mapping[str, tuple[str, str, str, Array]] = field(repr=False)

    @property
    def converged(self) -> bool:
        """Whether the equations are solved."""
        return self.status == "converged"

    @cached_property
    def data(self) -> xr.Dataset:
        """Voltages, flows and injections in physical units, named as in ``plan.data``."""
        from opfmodel.results import dataset

        made = dataset(self._arrays, self._quantities, self._times)
        made.attrs |= {
            "network": self.network.name,
            "formulation": "ac",
            "status": self.status,
            "step_hours": self._times.step,
        }
        return made

    @property
    def arrays(self) -> PerUnitNetwork:
        """Arrays of the network at the step of the power flow."""
        return self._arrays

    def per_unit(self) -> dict[str, Array]:
        """Return the quantities in per unit by name, one value per component."""
        return {name: values[:, 0] for name, (*_, values) in self._quantities.items()}

    @cached_property
    def loading(self) -> xr.DataArray:
        """Apparent power at the more loaded end of each branch, % of its rating; NaN without a rating."""
        ends = (("pf", "qf"), ("pt", "qt"))
        most = np.max([np.hypot(self.data[p].values[0], self.data[q].values[0]) for p, q in ends], axis=0)
        rating = self._arrays.branch.rating[:, 0] * self._arrays.base_mva
        rating = np.where(np.isfinite(rating) & (rating > 0), rating, np.nan)
        about = {"units": "%", "long_name": "loading"}
        return self.data["pf"].isel(time=0, drop=True).copy(data=100.0 * most / rating).assign_attrs(about)

    @property
    def losses(self) -> float:
        """Active losses of all branches, MW."""
        return float((self.data["pf"] + self.data["pt"]).sum(skipna=False))

    def summary(self) -> dict[str, object]:
        """Return the result as plain data in physical units.

        Buses, branches and generators are in the order of the network, or buses in that of its source where
        :attr:`Network.aliases <opfmodel.Network.aliases>` has one: those that were fused repeat the values of
        the bus that carries them. The quantities of what is out of service are None. Angles are between -180
        and 180 degrees, as PYPOWER and pandapower report them.
        """
        network = self.network
        carried = network.aliases or {name: name for name in network.of(Bus)}
        turned = (self.data["va"] + 180.0) % 360.0 - 180.0
        data = self.data.assign(va=turned, loading=self.loading.expand_dims("time"))
        return {
            "status": self.status,
            "max_mismatch": self.max_mismatch,
            "iterations": self.iterations,
            "losses": self.losses,
            "slack": dict(self.slack),
            "buses": _records(data, "bus", ("vm", "va"), carried),
            "branches": _records(
                data, "branch", ("pf", "qf", "pt", "qt", "loading"), {n: n for n in network.of(Branch)}
            ),
            "generators": _records(data, "generator", ("pg", "qg"), {n: n for n in network.of(Generator)}),
            "limited": list(self.limited),
            "notes": list(self.notes),
        }


def _records(
    data: xr.Dataset, kind: str, quantities: Sequence[str], carried: Mapping[str, str | None]
) -> list[dict[str, object]]:
    """Return the quantities of components, each by the name of the one that carries it; None without one."""
    present = set(data[kind].values.tolist())
    values = {
        name: dict(zip(data[kind].values.tolist(), data[name].values[0].tolist(), strict=True))
        for name in quantities
    }
    return [
        {"name": name, **{q: values[q][at] if at in present else None for q in quantities}}
        for name, at in carried.items()
    ]
