"""The model builder: collects declarations of devices, formulation and objective into a program."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from opfmodel.errors import IncompatibleError
from opfmodel.model.declared import Bound, BoundSource, Injection, Price, Published, State, resolved
from opfmodel.model.device import Device
from opfmodel.model.elastic import Elastic, Side, Slack, Soft
from opfmodel.model.stage import Quantities, sum_of_costs
from opfmodel.network.arrays import PerUnitNetwork, Table
from opfmodel.network.components import BUILT_IN
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
    stages, step
        Number of stages, and length of a stage in hours.
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

    Attributes
    ----------
    starts
        Number of stages at which plans may begin.
    series
        Fields that have time series, by ``(kind, field)``.
    slacks
        Slack variables of soft limits, by name; empty unless elastic.
    shares
        Names of the variables of an elastic problem that are shares of demand; see :meth:`share`.
    penalties
        Penalties of the slacks by item and stage, $.
    """

    def __init__(
        self,
        network: PerUnitNetwork,
        stages: int,
        step: float,
        *,
        reactive: bool,
        zones: Index,
        series: Iterable[tuple[str, str]] = (),
        elastic: Elastic | None = None,
        split_shedding: bool = False,
        regularisation: float = 0.0,
        shrinks: bool = False,
    ) -> None:
        self.network = network
        self.regularisation = regularisation
        self.elastic = elastic
        self.slacks: dict[str, Slack] = {}
        self.shares: list[str] = []
        self.split_shedding = split_shedding
        self.penalties: list[Expression] = []
        self.stages = stages
        self.starts = stages if shrinks else 1
        self.step = step
        self.reactive = reactive
        self.zones = zones
        noun = "stage" if stages == 1 else "stages"
        self.build = ProgramBuilder(f"{network.name}, {stages} {noun} of {step:g} h")
        self.published: dict[str, Published] = {}
        self.reported: dict[str, Published] = {}
        self.prices: dict[str, Price] = {}
        self.states: dict[str, State] = {}
        self.bounds: dict[str, BoundSource] = {}
        self.parameters: dict[str, tuple[str, Bound]] = {}
        self.injections: list[Injection] = []
        self.devices: list[Device] = []
        self._declaring: str | None = None
        self.series = set(series)
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
        points: int | None = None,
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
        points
            Number of points in time, if it differs from the number of stages.
        soft
            How the bounds are softened in an elastic problem; by default they stay hard. Soft bounds
            become the rows ``name_limit``; the variable itself keeps at most a lower bound of zero.
        """
        if publish:
            self._name(name)
        table = self.network.tables[kind]
        low, high = (resolved(table, bound) for bound in (lower, upper))
        if start is None:
            start = _middle(low, high)
        if soft is None or self.elastic is None:
            values = self.build.variable(name, len(table), points or self.stages, low, high, start)
            self.bounds[name] = BoundSource(kind, lower, upper)
        else:
            least = np.where(low >= 0.0, 0.0, -np.inf)
            values = self.build.variable(name, len(table), points or self.stages, least, np.inf, start)
            self.rows(kind, f"{name}_limit", values, lower, upper, soft)
        if publish:
            self.publish(kind, name, values, unit=unit, description=description)
        return values

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

        ``|x(k) - x(k-1)| <= ramp * step``, where the first stage follows the value applied last.

        Parameters
        ----------
        ramp
            Field with the limit per hour; infinite entries mean no limit.
        """
        values = self.variable(kind, name, lower, upper, unit=unit, description=description)
        ramped = None
        if ramp is not None:
            table = self.network.tables[kind]
            ramped = np.flatnonzero(np.isfinite(table.arrays[ramp]))
            moving = values[ramped]

            def limit(t: Table, sign: float = 1.0) -> npt.NDArray[Any]:
                return np.asarray(sign * t.arrays[ramp][ramped] * self.step)

            def floor(t: Table) -> npt.NDArray[Any]:
                return limit(t, -1.0)

            soft = Soft(
                "ramp", ramped, unit,
                below="must fall {} faster than its ramp allows",
                above="must rise {} faster than its ramp allows",
            )  # fmt: skip
            if self.stages > 1 and ramped.size:
                change = moving[:, 1:] - moving[:, :-1]
                self.rows(kind, f"{name}_ramp", change, floor, limit, replace(soft, first=1))
            if ramped.size:  # each solve enables or frees it through its bounds
                before = self.build.parameter(f"{name}_previous", ramped.size)
                first = self.starts
                self.rows(
                    kind, f"{name}_ramp_first", moving[:, :first] - before,
                    lambda t: floor(t)[:, :first], lambda t: limit(t)[:, :first], soft,
                )  # fmt: skip
                self.price(
                    kind, f"{name}_ramp_price", self._ramp_price(name, len(table), ramped),
                    "$/MW", "value of one more MW of change since the previous stage",
                )  # fmt: skip
        self.states[name] = State(name, kind, unit, "dispatch", ramped=ramped)
        return values

    def _ramp_price(self, name: str, items: int, ramped: Index) -> Callable[..., Array]:
        def read(solution: Solution, _: PerUnitNetwork) -> Array:
            stages = solution.dual(self.balance_p.name).shape[1]
            price = np.zeros((items, stages))
            if stages > 1:
                price[ramped, 1:] = np.abs(solution.dual(f"{name}_ramp"))
            price[ramped, :1] = np.abs(solution.dual(f"{name}_ramp_first")[:, :1])
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
    ) -> Expression:
        """Declare a stored quantity with ``stages + 1`` points, the first of which is the initial value.

        The points at the start of each stage are published as ``name``, those at the end as ``name_next``.
        The rows that tie the last point to the first are free unless a solve requires a cyclic end, and
        the final value is worth nothing unless a solve sets its price.
        """
        items = np.arange(len(self.network.tables[kind]))
        soft = Soft(
            "stock", items, unit, "is {} below its minimum", "is {} above its capacity", "balance", first=-1
        )
        values = self.variable(
            kind, name, lower, upper, unit=unit, points=self.stages + 1, publish=False, soft=soft
        )
        self.publish(
            kind, name, values[:, :-1], unit=unit, description=f"{description} at the start of a stage"
        )
        self.publish(
            kind, f"{name}_next", values[:, 1:], unit=unit, description=f"{description} at the end of a stage"
        )
        cyclic = self.build.rows(f"{name}_cyclic", values.items, 1, -np.inf, np.inf)
        self.build.add(values[:, -1:] - values[:, :1], into=cyclic)
        end = Soft(
            "cyclic end", items, unit,
            "ends {} short of where it began", "ends {} above where it began",
            "balance", first=None,
        )  # fmt: skip
        self.soften(kind, cyclic, end)
        self.build.minimize(-self.build.parameter(f"{name}_end_price", 1) * values[:, -1:])
        self.states[name] = State(name, kind, unit, "stock", initial)
        return values

    # Rows and costs ----------------------------------------------------------------------

    def limit(
        self, kind: str, name: str, items: int, lower: Bound, upper: Bound, soft: Soft | None = None
    ) -> Rows:
        """Declare empty rows for every stage; bounds and ``soft`` as for :meth:`variable`."""
        return self._rows(kind, name, items, self.stages, lower, upper, soft)

    def rows(
        self,
        kind: str,
        name: str,
        body: Expression | Sum,
        lower: Bound,
        upper: Bound,
        soft: Soft | None = None,
    ) -> Rows:
        """State ``lower <= body <= upper``; bounds and ``soft`` as for :meth:`variable`."""
        items = 1 if isinstance(body, Sum) else body.items
        rows = self._rows(kind, name, items, body.stages, lower, upper, soft)
        self.build.add(body, into=rows)
        return rows

    def _rows(
        self, kind: str, name: str, items: int, stages: int, lower: Bound, upper: Bound, soft: Soft | None
    ) -> Rows:
        table = self.network.tables[kind]
        low, high = resolved(table, lower), resolved(table, upper)
        rows = self.build.rows(name, items, stages, low, high)
        self.bounds[name] = BoundSource(kind, lower, upper)
        if soft is not None:
            self.soften(kind, rows, soft, lower, upper)
        return rows

    def regularise(self, values: Expression) -> None:
        """Add a small multiple of the squares of a quantity to the minimised cost, but to no reported cost.

        This makes a problem well posed that otherwise leaves the quantity undetermined. The objective or
        the user chooses the weight.
        """
        if self.regularisation:
            self.build.minimize(self.regularisation * self.step * total(values**2))

    # Soft limits -------------------------------------------------------------------------

    def slack(self, kind: str, name: str, soft: Soft, side: Side, stages: int | None = None) -> Expression:
        """Declare the violation of limits on one side, penalised in an elastic problem."""
        return self._slack(Slack(name, kind, soft, side), stages or self.stages)

    def soften(
        self,
        kind: str,
        rows: Rows,
        soft: Soft,
        lower: Bound = 0.0,
        upper: Bound = 0.0,
        names: tuple[str, str] | None = None,
    ) -> None:
        """Soften rows in an elastic problem: ``lower <= rows + below - above <= upper``.

        Parameters
        ----------
        lower, upper
            Bounds of the rows; a side that is infinite for all items needs no slack.
        names
            Names of the two variables; by default ``rows_below`` and ``rows_above``.
        """
        if self.elastic is None:
            return
        below, above = names or (f"{rows.name}_below", f"{rows.name}_above")
        for name, side, bound in ((below, Side.BELOW, lower), (above, Side.ABOVE, upper)):
            table = self.network.tables.get(kind, self.network.bus)  # constraints have numeric bounds
            if soft.sentence(side) and np.isfinite(resolved(table, bound)).any():
                exceeded = self._slack(Slack(name, kind, soft, side), rows.index.shape[1])
                if soft.squared:  # (limit ± slack)² in place of limit²
                    limit = self._number(kind, f"{name}_limit", _root(bound), rows.index.shape)
                    exceeded = 2.0 * limit * exceeded + side.value * exceeded**2
                self.build.add(-side.value * exceeded, into=rows)

    def _slack(self, slack: Slack, stages: int) -> Expression:
        assert self.elastic is not None
        soft = slack.soft
        values = self.build.variable(slack.block, soft.members.size, stages, 0.0, np.inf)
        self.penalise(self.penalty(soft) * values)
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

    def penalty(self, soft: Soft) -> float:
        """Return the penalty in $ of one internal unit of a soft limit over a stage."""
        assert self.elastic is not None
        unit = self.network.base_mva if soft.unit else 1.0
        return soft.share * float(getattr(self.elastic, soft.price)) * unit * self.step

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

    def parameter(self, kind: str, field: str) -> Expression:
        """Return a field of the network as a parameter, ``(items, stages)``, which may change between solves.

        Infinite entries, which mean "no limit", are replaced as in :func:`number_of`.
        """
        if (kind, field) not in self._fields:
            table = self.network.tables[kind]
            name = f"{kind}.{field}"
            value = number_of(table.arrays[field], self.network)
            self._fields[kind, field] = self.build.parameter(name, len(table), self.stages, value)
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

    def price(
        self,
        kind: str,
        name: str,
        read: Callable[[Solution, PerUnitNetwork], Array],
        unit: str,
        description: str,
    ) -> None:
        """Name a shadow price: the value of one more unit, independent of the back end."""
        self._name(name)
        self.prices[name] = Price(kind, unit, description, read)

    def _balance_price(self, rows: str) -> Callable[[Solution, PerUnitNetwork], Array]:
        # more demand lowers the right-hand side of the balance
        return lambda solution, _: -solution.dual(rows)[self.zones] / self.step

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
        """Operating cost of all devices, $/h."""
        return sum_of_costs(self.devices, self)


def _root(bound: Bound) -> Callable[[Table], Array]:
    """Return a function that computes the square roots of a bound."""
    return lambda table: np.sqrt(resolved(table, bound))


def _middle(lower: npt.NDArray[Any], upper: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the midpoint of finite bounds, else the feasible point nearest to zero."""
    finite = np.isfinite(lower) & np.isfinite(upper)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(finite, 0.5 * (lower + upper), np.clip(0.0, lower, upper)))
