"""Security: plans that survive the outage of any one component."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from opfmodel.errors import SecurityError, listed, nearest, shown
from opfmodel.horizon import Horizon
from opfmodel.model import Model
from opfmodel.model.declared import Bound
from opfmodel.network.arrays import OUTAGES, Index, PerUnitNetwork, Table
from opfmodel.network.bounds import number_within
from opfmodel.network.network import name_pattern
from opfmodel.network.shares import divide
from opfmodel.plan.outages import splitting
from opfmodel.plan.set_points import participation_of
from solvers import Expression

__all__ = ["NOTHING", "Security", "at_contingencies", "outage_fields", "rating_after"]

Array = npt.NDArray[np.float64]
Fields = dict[tuple[str, str], Array]

KINDS = {kind.plural: kind.kind for kind in OUTAGES}

# A preventive response takes no time: neither ramps nor energy limit it.
_HELD: Mapping[tuple[str, str], float] = {("generator", "ramp"): np.inf}
NOTHING = ""  # the name of no component: a contingency in which nothing is lost
_AT_ONCE = 1e-7  # min; ramps of zero length would be undefined

Response = Literal["corrective", "preventive"]


@dataclass(frozen=True)
class Security:
    r"""N-1 security: after the outage of any one component at the end of any stage, the grid has a state.

    With a corrective response, units move within ``minutes`` by at most their ramp, storages act within
    power and energy, and voltages are free within their limits. With a preventive one nothing is
    dispatched anew:

    .. math::
        p^g = \hat p^g + \gamma s, \quad p^s = \hat p^s, \quad q^s = \hat q^s, \quad
        v = \hat v \text{ at the buses of generators}

    with the participation :math:`\gamma` of the units that are left and a slack s per island; reactive power
    and flows follow. Source: F. Capitanescu et al., "State-of-the-art, challenges, and future trends in
    security constrained optimal power flow", Electric Power Systems Research 81(8), 2011.

    Parameters
    ----------
    contingencies
        ``all``: every branch whose outage does not split the grid; or the names of components, or patterns
        with stars, by the plural of their kind: ``branches``, ``generators``, ``dc_lines``, ... Patterns
        leave out branches whose outage splits the grid.
    response
        ``corrective`` or ``preventive``.
    minutes
        Time for a corrective response.
    participation
        Weight of each unit in the slack of a preventive response, by name; others do not participate. By
        default ``Generator.participation``, or the capacity.
    rating
        Multiple of the rating of a branch that applies after an outage, if it has no emergency rating.
    screen
        Whether problems include only the contingencies that a plan without them does not survive; see
        :class:`opfmodel.plan.screening.Screening`. Else they include all of them from the start.
    """

    contingencies: Literal["all"] | Mapping[str, Sequence[str]] = "all"
    response: Response = "corrective"
    minutes: float = 15.0
    participation: Mapping[str, float] | None = None
    rating: float = 1.0
    screen: bool = True

    def __post_init__(self) -> None:
        if self.response not in get_args(Response):
            raise SecurityError(f"security: response = {self.response!r}: must be corrective or preventive")
        if self.participation is not None and self.response == "corrective":
            raise SecurityError("security: participation: applies to a preventive response only")
        self._check_contingencies()
        if not isinstance(self.participation, Mapping | None):
            raise SecurityError(
                f"security: participation = {shown(self.participation)}: must be weights of units by name"
            )
        for name, weight in (self.participation or {}).items():
            number_within(f"security: participation: {name}", weight, at_least=0, error=SecurityError)
        if not isinstance(self.screen, bool):
            raise SecurityError(f"security: screen = {shown(self.screen)}: must be true or false")
        number_within("security: minutes", self.minutes, above=0, error=SecurityError)
        number_within("security: rating", self.rating, above=0, error=SecurityError)

    def _check_contingencies(self) -> None:
        if isinstance(self.contingencies, str) and self.contingencies == "all":
            return
        if not isinstance(self.contingencies, Mapping):
            raise SecurityError(
                f"security: contingencies = {shown(self.contingencies)}: must be 'all' or lists of names by "
                f"{', '.join(KINDS)}"
            )
        for key, names in self.contingencies.items():
            if key not in KINDS:
                raise SecurityError(f"contingencies: {shown(key)}: {nearest(key, KINDS)}")
            listed_names = isinstance(names, Iterable) and not isinstance(names, str)
            if not listed_names or not all(isinstance(name, str) for name in names):
                raise SecurityError(f"contingencies: {key}: {shown(names)}: must be a list of names")

    def outages(self, network: PerUnitNetwork) -> list[str]:
        """Return the names of the components that may go out, one at a time.

        Raises
        ------
        SecurityError
            A name is unknown, or the outage of a branch that was asked for splits the grid.
        """
        bridges = splitting(network)
        if self.contingencies == "all":
            return [name for name in network.branch.names if name not in bridges]
        return list(dict.fromkeys(self._named(network, bridges)))

    def _named(self, network: PerUnitNetwork, bridges: Mapping[str, float]) -> Iterator[str]:
        assert not isinstance(self.contingencies, str)
        for key, names in self.contingencies.items():
            place = ("security", "contingencies", key)
            table = network.tables[KINDS[key]]
            for name in names:
                matched = [known for known in table.names if name_pattern(name).fullmatch(known)]
                if "*" in name and matched:
                    yield from (known for known in matched if known not in bridges)
                    continue
                if name not in table.position:
                    raise SecurityError(
                        f"{name!r}: no {table.kind.kind} in service has this name; "
                        f"{nearest(name, table.names)}",
                        *place,
                    )
                if name in bridges:
                    raise SecurityError(
                        f"{name!r}: its outage splits the grid and cuts off {bridges[name]:.4g} MW of demand",
                        *place,
                    )
                yield name

    def notes(self, network: PerUnitNetwork) -> tuple[str, ...]:
        """Return which branches are left out because their outage splits the grid."""
        bridges = splitting(network)
        if not bridges:
            return ()
        lost = sum(bridges.values())
        return (
            f"not secured, because their outage splits the grid: {listed(bridges)} ({lost:.4g} MW in all)",
        )

    @property
    def response_minutes(self) -> float:
        """Time in which units move; a preventive response takes none."""
        return self.minutes if self.response == "corrective" else _AT_ONCE

    def hold(self, model: Model) -> None:
        """State in a model what a preventive response leaves as it was before the outage."""
        nodes = model.horizon.contingencies
        if self.response == "corrective" or not nodes.size:
            return
        network, before = model.network, model.horizon.owner[nodes]
        decided = [
            (name, p) for name, p in model.published.items()
            if name in model.build.variables
            and p.kind not in ("bus", "branch")
            and name.removesuffix("_moves") not in model.settings  # held in any case
            and not (name in model.states and model.states[name].role == "stock")
        ]  # fmt: skip
        for name, published in decided:
            kind, block = published.kind, model.build.variables[name]
            moves = (block.spread(block.lower) < block.spread(block.upper))[:, nodes].any(axis=1)
            kept = np.flatnonzero(np.asarray(moves))
            if name == "qg" or not kept.size:
                continue
            change, holds = published.values[kept][:, nodes] - published.values[kept][:, before], _there
            if name == "pg":
                change, holds = change - self._slack(model, kept, nodes), _left
            model.rows(kind, f"{name} held", change, *_zero_if(holds, kept), nodes=nodes)
        units = network.generator
        at, position = np.unique(units.bus, return_inverse=True)
        magnitude = model.published.get("w") or model.published.get("vm")
        if magnitude is not None and at.size:
            change = magnitude.values[at][:, nodes] - magnitude.values[at][:, before]

            def regulated(table: Table) -> npt.NDArray[np.bool_]:
                left = np.zeros((at.size, table.status.shape[1]), dtype=bool)
                np.logical_or.at(left, position, table.status > 0)
                return left

            bounds = _zero_if(regulated)
            model.rows("generator", "voltage held", change, *bounds, nodes=nodes)

    def _slack(self, model: Model, kept: Index, nodes: Index) -> Expression:
        """Return what each of some units adds, its share in the slack of its island."""
        network = model.network
        island = network.island[network.generator.bus]
        slack = model.build.variable("slack held", network.n_islands, nodes.size)
        share = model.of_fields("generator", "share held", lambda t: self.shares(t, island)[kept], nodes)
        added: Expression = share * slack[island[kept]]
        return added

    def shares(self, units: Table, island: Index) -> Array:
        """Return the share of each unit in a preventive response, ``(units, nodes)``.

        Units that are out of service, or cannot move in a node, take no part in it.

        Parameters
        ----------
        island
            Island of each unit.
        """
        moves = _left(units)
        weights = np.where(moves, participation_of(units, moves, self.participation), 0.0)
        return np.column_stack([divide(column, island) for column in weights.T])


def _there(table: Table) -> npt.NDArray[np.bool_]:
    """Return which components are in service, by node."""
    return np.asarray(table.arrays.get("status", np.ones((len(table), 1))) > 0)


def _left(table: Table) -> npt.NDArray[np.bool_]:
    """Return which components are in service and can change their active power, by node."""
    return np.asarray(_there(table) & (table.p_min < table.p_max))


def _zero_if(
    holds: Callable[[Table], npt.NDArray[np.bool_]], items: Index | slice = slice(None)
) -> tuple[Bound, Bound]:
    """Return the bounds of rows that are zero where something holds of an item, and free elsewhere."""

    def most(table: Table) -> Array:
        return np.where(holds(table)[items], 0.0, np.inf)

    return lambda table: -most(table), most


def outage_fields(security: Security | None, horizon: Horizon) -> list[tuple[str, str]]:
    """Return the fields that differ in contingencies whatever goes out, by ``(kind, field)``."""
    if security is None or not horizon.contingencies.size:
        return []
    held = _HELD if security.response == "preventive" else {}
    return [("branch", "rating"), *held]


def rating_after(rating: Array, emergency: Array, multiple: float) -> Array:
    """Return the ratings after an outage: the emergency ratings, or a multiple of those without one."""
    return np.where(np.isfinite(emergency), emergency, multiple * rating)


def at_contingencies(
    series: Mapping[tuple[str, str], Array],
    security: Security | None,
    horizon: Horizon,
    network: PerUnitNetwork,
    idle: Index,
) -> Fields:
    """Return series at the nodes with the fields that differ in contingencies.

    Parameters
    ----------
    idle
        Contingencies that cannot happen: nothing is limited in them.
    """
    made = dict(series)
    for kind, field in outage_fields(security, horizon):
        assert security is not None
        table = network.tables[kind]
        values = series.get((kind, field), table.arrays[field])
        values = np.array(np.broadcast_to(values, (len(table), len(horizon))))
        if field == "rating":
            stated = series.get(("branch", "emergency_rating"), network.branch.emergency_rating)
            stated = np.broadcast_to(stated, values.shape)[:, horizon.contingencies]
            after = rating_after(values[:, horizon.contingencies], stated, security.rating)
            values[:, horizon.contingencies] = after
            values[:, idle] = np.inf
        else:
            values[:, horizon.contingencies] = _HELD[kind, field]
        made[kind, field] = values
    return made
