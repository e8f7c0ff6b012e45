"""The model builder: collects declarations of devices, formulation and objective into a program."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from opfmodel.errors import IncompatibleError
from opfmodel.horizon import Horizon
from opfmodel.model.declared import (
    Bound,
    BoundSource,
    Injection,
    Price,
    Published,
    State,
    resolved,
)
from opfmodel.model.device import Device
from opfmodel.model.elastic import Elastic, Side, Slack, Soft
from opfmodel.model.setting import Setting
from opfmodel.model.stage import Costed, Quantities, RegularStage, per_node, sum_of_costs
from opfmodel.network.arrays import PerUnitNetwork, Table
from opfmodel.network.components import BUILT_IN
from opfmodel.network.physics import Admittance
from opfmodel.results.dataset import DEMAND
from solvers import Expression, ProgramBuilder, Rows, Solution, Sum, total

__all__ = ["Model"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]


_UNLIMITED = 1e4  # times the total demand, or 1 p.u. if that is larger


def number_of(values: Array, network: PerUnitNetwork) -> Array:
    """Replace infinite values of a parameter with a limit that is never reached.

    Bounds may be infinite, but parameters are coefficients of the equations.
    """
    if not np.isinf(values).any():
        return np.asarray(values)
    demand = float(np.abs(network.load.p).sum(axis=0).max(initial=1.0))
    never = _UNLIMITED * demand
    return np.asarray(np.nan_to_num(values, nan=np.nan, posinf=never, neginf=-never))


class Model:
    """The declarations of devices, a formulation and an objective, collected into a program.

    Parameters
    ----------
    network
        Arrays of the network.
    horizon
        The nodes in time; each is a stage.
    delay
        1 if the dispatch of a node is decided at its parent, so that siblings share it; else 0.
    reactive
        Whether the formulation balances reactive power.
    zones
        Balance row of each bus.
    series
        ``(kind, field)`` pairs that have time series.
    elastic
        Penalty prices of soft limits; None keeps every limit hard.
    split_shedding
        Whether different shares of active and reactive demand may be unserved, to diagnose a shortage.
    regularisation
        Weight in $/(h p.u.²) of the squares of regularised quantities.
    shrinks
        Whether plans may begin at a later stage of the program; see :mod:`opfmodel.plan.shrinking`.
    outages
        Names of the components that solves may take out of service in any node.

    Attributes
    ----------
    stages
        Number of nodes.
    step
        Length of each node in hours: a number if all are equal, else an array ``(1, stages)``.
    weight
        Probability times length of each regular node, in h: a number if all are equal, an array
        ``(1, nodes)``, or a parameter if the probabilities may vary.
    stage
        What objectives, costs of devices and constraints see: the regular nodes.
    starts
        Nodes at which plans may begin.
    series
        Fields that have time series, by ``(kind, field)``.
    slacks
        Slack variables of soft limits, by name; empty unless elastic.
    settings
        Adjustable quantities of the network, by name; see :func:`opfmodel.model.setting.declare_setting`.
    costed
        The formulation and the devices, which have operating costs.
    shares
        Names of the variables of an elastic problem that are shares of demand; see :meth:`share`.
    penalties
        Penalties of the slacks by item and stage, $.
    whole
        Names of the rows that tie the end of the horizon to its beginning, in plans of any number of stages.
    """

    def __init__(
        self,
        network: PerUnitNetwork,
        horizon: Horizon,
        *,
        delay: int = 0,
        reactive: bool,
        zones: Index,
        series: Iterable[tuple[str, str]] = (),
        elastic: Elastic | None = None,
        split_shedding: bool = False,
        regularisation: float = 0.0,
        shrinks: bool = False,
        outages: Iterable[str] = (),
    ) -> None:
        self.network = network
        self.regularisation = regularisation
        self.elastic = elastic
        self.slacks: dict[str, Slack] = {}
        self.shares: list[str] = []
        self.split_shedding = split_shedding
        self.penalties: list[Expression] = []
        self.horizon = horizon
        self.delay = delay
        self.stages = stages = len(horizon)
        self.step = per_node(horizon.hours)
        self.starts = np.arange(stages) if shrinks else horizon.roots
        self.reactive = reactive
        self.zones = zones
        self.build = ProgramBuilder(f"{network.name}, {horizon}", ordered=horizon.is_chain)
        self.probability = (
            self.build.parameter("probability", 1, len(horizon.regular), horizon.regular.probability)
            if horizon.varying
            else horizon.regular.probability[None, :]
        )
        self.weight = self._hours_of(np.arange(len(horizon.regular)))
        self.stage = self if horizon.regular is horizon else RegularStage(self)
        self.published: dict[str, Published] = {}
        self.reported: dict[str, Published] = {}
        self.prices: dict[str, Price] = {}
        self.states: dict[str, State] = {}
        self.settings: dict[str, Setting] = {}
        self.whole: list[str] = []
        self.bounds: dict[str, BoundSource] = {}
        self.parameters: dict[str, tuple[str, Bound]] = {}
        self.injections: list[Injection] = []
        self.devices: list[Device] = []
        self.costed: list[Costed] = []
        self._declaring: str | None = None
        self.series = set(series)
        self.outages = frozenset(outages)
        self._fields: dict[tuple[str, str], Expression] = {}
        self._quantities: dict[str, Quantities] = {}
        n_zones = int(zones.max()) + 1
        self.balance_p = self.build.rows("p_balance", n_zones, stages)
        self.balance_q = self.build.rows("q_balance", n_zones, stages) if reactive else None
        self.price("bus", "lmp", self._balance_price("p_balance"), "$/MWh", "cost of one more MW of demand")
        if reactive:
            about = "cost of one more MVAr of demand"
            self.price("bus", "lmp_q", self._balance_price("q_balance"), "$/MVArh", about)
        self._soften_balance()

    def connect(self, device: Device) -> None:
        """Add the declarations of a device.

        Injections by devices of other packages are kept in :attr:`injections`: results contain them, and a
        balance can be verified without knowing the devices.
        """
        kind = device.component.kind
        self.devices.append(device)
        self.costed.append(device)
        self._declaring = None if device.component in BUILT_IN else kind
        device.declare(self, self.network.tables[kind])
        self._declaring = None

    # Variables ---------------------------------------------------------------------------

    def variable(
        self,
        kind: str,
        name: str,
        lower: Bound = -np.inf,
        upper: Bound = np.inf,
        *,
        unit: str,
        description: str = "",
        start: npt.ArrayLike | None = None,
        nodes: Index | None = None,
        publish: bool = True,
        soft: Soft | None = None,
    ) -> Expression:
        """Declare a variable for every component of a kind and every stage.

        Parameters
        ----------
        lower, upper
            Numbers, a field of the component's table, or a function of the table. Fields follow
            their time series in every solve.
        unit
            Physical unit of the quantity.
        nodes
            Node to which each column belongs, if there is not one per node; -1 for values before the first.
        soft
            How the bounds are softened in an elastic problem; by default they stay hard. Soft bounds
            become the rows ``name_limit``; the variable itself keeps at most a lower bound of zero.
        """
        if publish:
            self._name(name)
        table = self.network.tables[kind]
        source = BoundSource(kind, lower, upper, nodes)
        low, high = source.resolve(table)
        if start is None:
            start = _middle(low, high)
        limited = np.isfinite(low).any() or np.isfinite(high).any()
        if soft is None or self.elastic is None or not limited:
            values = self.build.variable(name, len(table), self._columns(nodes), low, high, start)
            self.bounds[name] = source
        else:
            least = np.where(low >= 0.0, 0.0, -np.inf)
            values = self.build.variable(name, len(table), self._columns(nodes), least, np.inf, start)
            self.rows(kind, f"{name}_limit", values, lower, upper, soft, nodes)
        if publish:
            self.publish(kind, name, values, unit=unit, description=description)
        return values

    def _columns(self, nodes: Index | None) -> int:
        return self.stages if nodes is None else nodes.size

    def previous(self, values: Any) -> Any:
        """Return a quantity at the parent of each node that has one, in the order of :attr:`Horizon.inner`.

        ``model.current(x) - model.previous(x)`` is the change of ``x`` from stage to stage, on every horizon.
        """
        return values[:, self.horizon.parent[self.horizon.inner]]

    def current(self, values: Any) -> Any:
        """Return a quantity at the nodes that have a parent; see :meth:`previous`."""
        return values[:, self.horizon.inner]

    def leaves(self, values: Any) -> Any:
        """Return a quantity at the end of the horizon: at the last node of each scenario."""
        return values[:, self.horizon.leaves]

    def dispatch(
        self,
        kind: str,
        name: str,
        lower: Bound,
        upper: Bound,
        *,
        unit: str,
        description: str = "",
        ramp: str | None = None,
    ) -> Expression:
        """Declare a dispatched quantity with limited change from stage to stage.

        ``|x(k) - x(parent of k)| <= ramp * h``, with the mean length h of the two stages. The first stage
        follows the value applied last. With a delay of 1, the children of a node share their dispatch.

        Parameters
        ----------
        ramp
            Field with the limit per hour; infinite entries mean no limit.
        """
        values = self.variable(kind, name, lower, upper, unit=unit, description=description)
        ramped = None
        if ramp is not None:
            ramped = np.flatnonzero(np.isfinite(self.network.tables[kind].arrays[ramp]))
            if ramped.size:
                self._ramp(kind, name, values, unit, ramp, ramped)
        later, eldest = self.horizon.siblings
        if self.delay == 1 and later.size:
            self.rows(kind, f"{name}_shared", values[:, later] - values[:, eldest], 0.0, 0.0)
        first = () if ramped is None or not ramped.size else (f"{name}_ramp_first",)
        self.states[name] = State(name, kind, unit, "dispatch", ramped=ramped, first=first)
        return values

    def _ramp(self, kind: str, name: str, values: Expression, unit: str, ramp: str, ramped: Index) -> None:
        """Limit the change of some items of a dispatch from stage to stage."""
        horizon, moving = self.horizon, values[ramped]
        alone = horizon.parent < 0
        alone[horizon.contingencies] = True  # units respond for as long as it lasts
        hours = per_node(
            np.where(alone, horizon.hours, 0.5 * (horizon.hours + horizon.hours[horizon.parent]))
        )

        def most(table: Table) -> npt.NDArray[Any]:
            return np.asarray(table.arrays[ramp][ramped] * hours)

        def least(table: Table) -> npt.NDArray[Any]:
            return -most(table)

        soft = Soft(
            "ramp", ramped, unit,
            below="must fall {} faster than its ramp allows",
            above="must rise {} faster than its ramp allows",
        )  # fmt: skip
        if horizon.inner.size:
            change = self.current(moving) - self.previous(moving)
            self.rows(kind, f"{name}_ramp", change, least, most, soft, horizon.inner)
        before = self.build.parameter(f"{name}_previous", ramped.size)
        # each solve enables or frees it through its bounds
        self.rows(kind, f"{name}_ramp_first", moving[:, self.starts] - before, least, most, soft, self.starts)
        self.price(
            kind, f"{name}_ramp_price", self._ramp_price(name, len(self.network.tables[kind]), ramped),
            "$/MW", "value of one more MW of change since the previous stage",
            rate=False,
        )  # fmt: skip

    def _ramp_price(self, name: str, items: int, ramped: Index) -> Callable[..., Array]:
        rows = ("ramp", "ramp_first") if self.horizon.inner.size else ("ramp_first",)

        def read(solution: Solution, _: PerUnitNetwork) -> Array:
            duals = {row: np.abs(solution.dual(f"{name}_{row}")) for row in rows}
            first = duals["ramp_first"]
            stages = solution.dual(self.balance_p.name).shape[1]
            skipped = self.stages - stages  # by a plan that ends with the data
            roots = self.horizon.roots if not skipped else np.zeros(1, dtype=np.intp)
            inner = self.horizon.inner[self.horizon.parent[self.horizon.inner] >= skipped] - skipped
            price = np.zeros((items, stages))
            price[np.ix_(ramped, roots)] = first[:, : roots.size]
            if inner.size:
                price[np.ix_(ramped, inner)] = duals["ramp"][:, -inner.size :]
            return price

        return read

    def stock(
        self,
        kind: str,
        name: str,
        lower: Bound,
        upper: Bound,
        *,
        unit: str,
        description: str = "",
        initial: str | None = None,
        ends: bool = True,
        capacity: Bound | None = None,
    ) -> tuple[Expression, Expression]:
        """Declare a stored quantity, with its initial value and its value at the end of each stage.

        A stage starts where its parent ended. The values at the start of each stage are published as
        ``name``, those at the end as ``name_next``.

        Parameters
        ----------
        ends
            Whether the terminal conditions of stored energy apply, to a quantity in MWh. The rows that tie
            the end of the horizon to its beginning are free unless a solve requires a cyclic end, and the
            final value is worth nothing unless a solve sets its price.
        capacity
            What a terminal condition states a share of, if that is not the upper bound.

        Returns
        -------
        Expression, Expression
            The values at the start and at the end of each stage.
        """
        horizon, items = self.horizon, np.arange(len(self.network.tables[kind]))
        soft = Soft("stock", items, unit, "is {} below its minimum", "is {} above its capacity", "balance")
        nodes = np.arange(-1, self.stages)
        values = self.variable(kind, name, lower, upper, unit=unit, nodes=nodes, publish=False, soft=soft)
        start, end = values[:, horizon.parent + 1], values[:, np.arange(self.stages) + 1]
        self.publish(kind, name, start, unit=unit, description=f"{description} at the start of a stage")
        self.publish(kind, f"{name}_next", end, unit=unit, description=f"{description} at the end of a stage")
        ends = ends and unit == "MWh"
        most = upper if capacity is None else capacity
        self.states[name] = State(name, kind, unit, "stock", initial, ends=ends, capacity=most)
        if ends:
            self._end(kind, name, values, self.leaves(end))
        return start, end

    def _end(self, kind: str, name: str, values: Expression, last: Expression) -> None:
        """Declare the terminal conditions of a stock; see :meth:`stock`."""
        horizon, items = self.horizon, np.arange(values.items)
        cyclic = self.build.rows(f"{name}_cyclic", values.items, last.stages, -np.inf, np.inf)
        self.whole.append(cyclic.name)
        self.build.add(last - values[:, 0], into=cyclic)
        tied = Soft(
            "cyclic end", items, self.states[name].unit,
            "ends {} short of where it began", "ends {} above where it began", "balance",
        )  # fmt: skip
        self.soften(kind, cyclic, tied, nodes=horizon.leaves)
        worth = self.build.parameter(f"{name}_end_price", 1) * last
        self.build.minimize(-self.probability_of(horizon.leaves) * worth)

    # Rows and costs ----------------------------------------------------------------------

    def limit(
        self,
        kind: str,
        name: str,
        items: int,
        lower: Bound,
        upper: Bound,
        soft: Soft | None = None,
        nodes: Index | None = None,
    ) -> Rows:
        """Declare empty rows for every stage; bounds, ``soft`` and ``nodes`` as for :meth:`variable`."""
        return self._rows(kind, name, items, self._columns(nodes), lower, upper, soft, nodes)

    def rows(
        self,
        kind: str,
        name: str,
        body: Expression | Sum,
        lower: Bound,
        upper: Bound,
        soft: Soft | None = None,
        nodes: Index | None = None,
    ) -> Rows:
        """State ``lower <= body <= upper``; bounds, ``soft`` and ``nodes`` as for :meth:`variable`."""
        items = 1 if isinstance(body, Sum) else body.items
        rows = self._rows(kind, name, items, body.stages, lower, upper, soft, nodes)
        self.build.add(body, into=rows)
        return rows

    def _rows(
        self,
        kind: str,
        name: str,
        items: int,
        stages: int,
        lower: Bound,
        upper: Bound,
        soft: Soft | None,
        nodes: Index | None = None,
    ) -> Rows:
        source = BoundSource(kind, lower, upper, nodes)
        low, high = source.resolve(self.network.tables[kind])
        rows = self.build.rows(name, items, stages, low, high)
        self.bounds[name] = source
        if soft is not None:
            self.soften(kind, rows, soft, lower, upper, nodes=nodes)
        return rows

    def regularise(self, values: Expression) -> None:
        """Add a small multiple of the squares of a quantity to the minimised cost, but to no reported cost.

        This makes a problem well posed that otherwise leaves the quantity undetermined. The objective or
        the user chooses the weight.
        """
        if self.regularisation:
            self.build.minimize(
                self.regularisation * total(values**2) * self._hours_of(np.arange(self.stages))
            )

    # Soft limits -------------------------------------------------------------------------

    def slack(self, kind: str, name: str, soft: Soft, side: Side, nodes: Index | None = None) -> Expression:
        """Declare the violation of limits on one side, penalised in an elastic problem."""
        return self._slack(Slack(name, kind, soft, side, nodes))

    def soften(
        self,
        kind: str,
        rows: Rows,
        soft: Soft,
        lower: Bound = 0.0,
        upper: Bound = 0.0,
        names: tuple[str, str] | None = None,
        nodes: Index | None = None,
    ) -> None:
        """Soften rows in an elastic problem: ``lower <= rows + below - above <= upper``.

        Parameters
        ----------
        lower, upper
            Bounds of the rows; a side that is infinite for all items needs no slack.
        names
            Names of the two variables; by default ``rows_below`` and ``rows_above``.
        nodes
            Node to which each column of the rows belongs, as for :meth:`variable`.
        """
        if self.elastic is None:
            return
        below, above = names or (f"{rows.name}_below", f"{rows.name}_above")
        for name, side, bound in ((below, Side.BELOW, lower), (above, Side.ABOVE, upper)):
            table = self.network.tables.get(kind, self.network.bus)  # constraints have numeric bounds
            if soft.sentence(side) and np.isfinite(resolved(table, bound)).any():
                exceeded = self._slack(Slack(name, kind, soft, side, nodes), rows.index.shape[1])
                if soft.squared:  # (limit ± slack)² in place of limit²
                    limit = self._number(kind, f"{name}_limit", _root(bound), rows.index.shape)
                    exceeded = 2.0 * limit * exceeded + side.value * exceeded**2
                self.build.add(-side.value * exceeded, into=rows)

    def _slack(self, slack: Slack, columns: int | None = None) -> Expression:
        assert self.elastic is not None
        soft, nodes = slack.soft, slack.nodes
        columns = self._columns(nodes) if columns is None else columns
        values = self.build.variable(slack.block, soft.members.size, columns, 0.0, np.inf)
        charged = nodes if soft.timed else np.zeros(columns, dtype=np.intp)
        self.penalise(self.penalty(soft, charged) * values)
        self.slacks[slack.block] = slack
        return values

    def share(self, kind: str, name: str) -> Expression:
        """Declare the unserved share of every component of a kind, from 0 to 1, without a penalty."""
        self.shares.append(name)
        return self.build.variable(name, len(self.network.tables[kind]), self.stages, 0.0, 1.0)

    def penalise(self, cost: Expression) -> None:
        """Add the penalty of a shortfall, in $; it is part of no objective."""
        self.penalties.append(cost)
        self.build.minimize(cost)

    def probability_of(self, nodes: Index) -> Any:
        """Return the probability of nodes, in the form of :attr:`weight`."""
        chosen = self.probability[:, nodes]
        return chosen if isinstance(chosen, Expression) else per_node(chosen[0])

    def _hours_of(self, nodes: Index) -> Any:
        """Return the influence of nodes, in the form of :attr:`weight`; see :attr:`Horizon.influence`."""
        if isinstance(self.probability, Expression):
            owner = self.horizon.owner[nodes]
            return self.probability[:, owner] * self.horizon.hours[None, owner]
        return per_node(self.horizon.influence[nodes])

    def penalty(self, soft: Soft, nodes: Index | None = None) -> Any:
        """Return the penalty in $ of one internal unit of a soft limit over each stage.

        Values before the first stage weigh as much as those of the first one.
        """
        assert self.elastic is not None
        unit = self.network.base_mva if soft.unit else 1.0
        nodes = np.arange(self.stages) if nodes is None else np.maximum(nodes, 0)
        weights = self._hours_of(nodes)
        if self.horizon.contingencies.size:
            weights = weights * self._urgency[None, nodes]
        return soft.share * float(getattr(self.elastic, soft.price)) * unit * weights

    @cached_property
    def _urgency(self) -> Array:
        """Factor of the penalties in each node: together, those of all contingencies are below any real one.

        No limit is violated and no load is shed for an outage that has not happened.
        """
        assert self.elastic is not None
        prices = (self.elastic.limit, self.elastic.shedding, self.elastic.balance)
        real = self.horizon.regular.weights
        share = min(prices) / max(prices) * real.min() / real.max()
        urgency = np.ones(self.stages)
        urgency[self.horizon.contingencies] = 0.5 * share / self.horizon.contingencies.size
        return urgency

    def _soften_balance(self) -> None:
        """Add penalised slack injections and withdrawals at every bus, or in every zone."""
        _, first = np.unique(self.zones, return_index=True)
        for rows, unit in ((self.balance_p, "MW"), (self.balance_q, "MVAr")):
            if rows is not None:
                letter = rows.name[0]
                soft = self.soft_balance(first, unit, "balance")
                self.soften("bus", rows, soft, names=(f"{letter}_shortage", f"{letter}_surplus"))

    def soft_balance(self, bus: Index, unit: str, price: Literal["shedding", "balance"]) -> Soft:
        """Return how the balance of buses is softened; without a network, the first bus names its zone."""
        _, first = np.unique(self.zones, return_index=True)
        noun = "bus" if len(first) == len(self.network.bus) else "island of bus"
        sort = " of reactive power" if unit == "MVAr" else ""
        sentences = f"lacks {{}}{sort}", f"has {{}}{sort} too much"
        return Soft("balance", first[self.zones[bus]], unit, *sentences, price, noun=noun)

    def inject(self, bus: Index, p: Expression | None = None, q: Expression | None = None) -> None:
        """Add power to the balance of buses, one entry of ``bus`` per row of ``p`` and ``q``.

        Formulations without a reactive balance ignore ``q``.
        """
        rows = self.zones[bus]
        if p is not None and p.items:
            self.build.add(p, into=self.balance_p[rows])
            self._keep(bus, p, "p", "MW", "active")
        if q is not None and q.items and self.balance_q is not None:
            self.build.add(q, into=self.balance_q[rows])
            self._keep(bus, q, "q", "MVAr", "reactive")

    def _keep(self, bus: Index, power: Expression, name: str, unit: str, sort: str) -> None:
        """Record the injections of a device from another package."""
        kind = self._declaring
        if kind is None:
            return
        output = f"injection {len(self.injections) + 1}"
        spread = power + np.zeros((len(bus), self.stages))
        self.build.output(output, spread)
        about = f"{sort} power that the {self.network.tables[kind].kind.plural} inject at the bus"
        self.injections.append(Injection(f"{kind}_{name}", unit, about, bus, output))

    def publish(self, kind: str, name: str, values: Expression, *, unit: str, description: str = "") -> None:
        """Name a quantity that objectives and constraints can use and that plans report."""
        self._name(name)
        self.published[name] = Published(kind, unit, description, values)

    def report(self, kind: str, name: str, values: Expression, *, unit: str, description: str = "") -> None:
        """Name a quantity that only results contain: objectives and constraints do not see it."""
        self._name(name)
        self.reported[name] = Published(kind, unit, description, values)

    def _name(self, name: str) -> None:
        """Raise an error if a quantity or price of that name exists, for results are keyed by name."""
        if self.has_name(name):
            raise IncompatibleError(f"two quantities are named {name!r}")

    def has_name(self, name: str) -> bool:
        """Whether results have a quantity or price of that name."""
        return name in (*self.published, *self.reported, *self.prices, *DEMAND)

    def field(self, kind: str, field: str) -> Any:
        """Return a field of the network: a parameter if it has time series, else numbers ``(items, 1)``."""
        return (
            self.parameter(kind, field)
            if (kind, field) in self.series
            else self.network.tables[kind].arrays.get(field)
        )

    def parameter(self, kind: str, field: str, fixed: bool | npt.NDArray[np.bool_] = False) -> Expression:
        """Return a field of the network as a parameter, ``(items, stages)``, which may change between solves.

        Infinite entries, which mean "no limit", are replaced as in :func:`number_of`.

        Parameters
        ----------
        fixed
            Entries that are program data.
        """
        if (kind, field) not in self._fields:
            table = self.network.tables[kind]
            name = f"{kind}.{field}"
            value = number_of(table.arrays[field], self.network)
            self._fields[kind, field] = self.build.parameter(name, len(value), self.stages, value, fixed)
            self.parameters[name] = (kind, field)
        return self._fields[kind, field]

    def _number(self, kind: str, name: str, value: Bound, shape: tuple[int, ...]) -> Any:
        """Return a number computed from fields of a kind: a parameter if one of them has time series."""
        given = number_of(resolved(self.network.tables[kind], value), self.network)
        if not any(changing == kind for changing, _ in self.series):
            return given
        self.parameters[name] = kind, value
        items, stages = shape
        return self.build.parameter(name, items, stages, given)

    def of_fields(
        self, kind: str, name: str, value: Callable[[Table], Array], nodes: Index | None = None
    ) -> Any:
        """Return a number that follows from fields of the components of a kind.

        A parameter if one of the fields has time series; else it is program data.
        """
        table, source = self.network.tables[kind], BoundSource(kind, 0.0, value, nodes)
        if not any(changing == kind for changing, _ in self.series):
            return source.resolve(table)[1]
        self.parameters[name] = kind, lambda table: source.resolve(table)[1]
        items = value(table).shape[0]
        stages = self.stages if nodes is None else nodes.size
        return self.build.parameter(name, items, stages, source.resolve(table)[1])

    def price(
        self,
        kind: str,
        name: str,
        read: Callable[[Solution, PerUnitNetwork], Array],
        unit: str,
        description: str,
        rate: bool = True,
    ) -> None:
        """Name a shadow price, the value of one more unit; ``read`` and ``rate`` as in :class:`Price`."""
        self._name(name)
        self.prices[name] = Price(kind, unit, description, read, rate)

    def _balance_price(self, rows: str) -> Callable[[Solution, PerUnitNetwork], Array]:
        # more demand lowers the right-hand side of the balance
        def read(solution: Solution, _: PerUnitNetwork) -> Array:
            price = -solution.dual(rows)[self.zones]
            return self._with_contingencies(price)  # demand is the same in a node and after an outage

        return read

    def price_security(self) -> None:
        """Name the part of the ``lmp`` that arises in contingencies, which is zero if there are none."""
        about = "part of the cost of one more MW of demand that arises after outages"
        self.price("bus", "security_price", self._security_price, "$/MWh", about)

    def _security_price(self, solution: Solution, _: PerUnitNetwork) -> Array:
        price = -solution.dual("p_balance")[self.zones]
        price[:, : len(self.horizon.regular)] = 0.0
        return self._with_contingencies(price)

    def _with_contingencies(self, price: Array) -> Array:
        """Add to the prices of each regular node those of its contingencies."""
        for node in self.horizon.contingencies:
            price[:, self.horizon.owner[node]] += price[:, node]
        return price

    # Access to declared quantities -------------------------------------------------------

    def __getattr__(self, kind: str) -> Quantities:
        if kind.startswith("_") or kind not in self.network.tables:
            raise AttributeError(kind)
        if kind not in self._quantities:

            def get(name: str) -> Any:
                published = self.published.get(name)
                if published is not None and published.kind == kind:
                    return published.values
                return self.field(kind, name)

            self._quantities[kind] = Quantities(kind, get, lambda: self._names(kind))
        return self._quantities[kind]

    def _names(self, kind: str) -> list[str]:
        published = [n for n, p in self.published.items() if p.kind == kind]
        return [*published, *self.network.tables[kind].arrays]

    def has(self, name: str) -> bool:
        """Whether a quantity is published."""
        return name in self.published

    @property
    def operating_cost(self) -> Any:
        """Operating cost of all equipment, $/h."""
        return sum_of_costs(self.costed, self)

    @cached_property
    def status(self) -> Any:
        """1 for each branch that is in service, else 0, ``(branches, stages)``; None if none ever goes out.

        A parameter for branches that a solve may take out of service; program data for all others.
        """
        table = self.network.branch
        if ("branch", "status") not in self.series:
            return None
        moving = np.array([[name in self.outages] for name in table.names], dtype=bool)
        return self.parameter("branch", "status", fixed=~moving) if moving.any() else table.status

    def switched(self, values: Any) -> Any:
        """Return a quantity of the branches, zero where a branch is out of service."""
        return values if self.status is None else values * self.status

    @property
    def admittance(self) -> Admittance:
        """Admittances of the branches, zero where a branch is out of service."""
        return self.network.admittance if self.status is None else self.network.admittance * self.status


def _root(bound: Bound) -> Callable[[Table], Array]:
    """Return a function that computes the square roots of a bound."""
    return lambda table: np.sqrt(resolved(table, bound))


def _middle(lower: npt.NDArray[Any], upper: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the midpoint of finite bounds, else the feasible point nearest to zero."""
    finite = np.isfinite(lower) & np.isfinite(upper)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(finite, 0.5 * (lower + upper), np.clip(0.0, lower, upper)))
