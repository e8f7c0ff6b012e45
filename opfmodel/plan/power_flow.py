"""Power flow: the voltages and flows of a network at the set-points of its units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import Times
from opfmodel.data.series import Profiles
from opfmodel.devices.held import HeldGenerators, held_devices, without_limits
from opfmodel.errors import ModelError
from opfmodel.formulations.ac import AC
from opfmodel.horizon import Horizon
from opfmodel.model import Model
from opfmodel.network.arrays import PerUnitNetwork, per_unit
from opfmodel.network.bounds import integer, number_within
from opfmodel.network.components import BUILT_IN, Budget, Connection, Reserve
from opfmodel.network.network import Network
from opfmodel.network.series import check_series, window
from opfmodel.plan.positions import without_moves
from opfmodel.plan.power_flow_result import PowerFlowResult
from opfmodel.plan.set_points import Held, held, slack_shares
from solvers import Evaluator, Program
from solvers.newton import Root, find_root

__all__ = ["PowerFlowResult", "power_flow"]

Array = npt.NDArray[np.float64]
SLACKS = ("single", "distributed")
_TAKEN = tuple(kind for kind in BUILT_IN if kind is not Connection)
_ON_PAPER = (Budget, Reserve)  # no part of the grid: a power flow has none of them


def power_flow(
    network: Network,
    *,
    slack: str = "single",
    participation: Mapping[str, float] | None = None,
    enforce_q_limits: bool = False,
    profiles: Mapping[str, npt.ArrayLike] | Profiles | None = None,
    step: int = 0,
    tolerance: float = 1e-8,
    limit: int = 30,
) -> PowerFlowResult:
    """Find the voltages of a network at its set-points, by Newton's method.

    Parameters
    ----------
    network
        The network. Generators inject ``pg_set``; those that regulate hold ``vm_set`` at their bus and share
        the reactive power that this takes in proportion to their ranges, the others inject ``qg_set``.
        Storages draw ``ps_set`` and ``qs_set``, renewables inject what is available. DC lines draw ``pf_set``
        at their from end, and their converters inject ``qf_set`` and ``qt_set`` without holding a voltage.
        Limits are not enforced.
    slack
        Which generators of an island cover what the set-points lack: ``single`` the first that regulates the
        reference bus, ``distributed`` all that participate.
    participation
        Weight of each generator in a distributed slack by name, others do not participate; by default
        ``Generator.participation``.
    enforce_q_limits
        Whether the generators of a bus stop holding its voltage when together they reach a limit of their
        reactive power, as in MATPOWER and pandapower; those at the reference bus always hold it.
    profiles, step
        Time series, which override those of the network one by one, and the step at which they are read.
    tolerance
        Largest missing power at a bus, in per unit on ``Network.scale_mva``.
    limit
        Largest number of Newton steps from one starting point.

    Returns
    -------
    PowerFlowResult
        Also if there is no solution, or none was found; then with the status ``diverged``.

    Raises
    ------
    OpfmodelError
        An option or time series is invalid, a component of another package has no set-points, or no
        generator in service holds the voltage of an island.

    Notes
    -----
    The equations are those of the formulation ``ac``. The first attempt starts from the angles of a linear
    power flow and 1 p.u., the second from the angle of the reference bus at all buses.

    Examples
    --------
    >>> import opfmodel as om
    >>> grid = om.Network("two-bus")
    >>> grid.north = om.Bus(reference=True)
    >>> grid.south = om.Bus()
    >>> grid.tie = om.Branch("north", "south", r=0.01, x=0.1)
    >>> grid.coal = om.Generator("north", p=(0, 200))
    >>> grid.town = om.Load("south", p=90, q=30)
    >>> flow = om.power_flow(grid)
    >>> flow.status, round(flow.slack["north"], 3)
    ('converged', 90.987)
    """
    if slack not in SLACKS:
        raise ModelError(f"slack = {slack!r}: must be {' or '.join(map(repr, SLACKS))}")
    if participation is not None and slack == "single":
        raise ModelError("participation: applies to slack = 'distributed' only")
    number_within("tolerance", tolerance, at_least=1e-12, at_most=1.0)
    integer("limit", limit, at_least=1)
    series = Profiles.of(profiles).or_else(network.profiles)
    check_series(series, network)
    arrays = per_unit(without_moves(network))
    arrays = arrays.with_series(window(series, arrays, integer("step", step, at_least=0), 1))
    _refuse_others(arrays)
    points = held(arrays)
    shares = slack_shares(points, participation) if slack == "distributed" else points.first_at_reference
    flow = _Flow(points, shares, tolerance, limit)
    root = flow.solve(enforce_q_limits)
    hours = 1.0 if series.calendar is None else series.calendar.step
    return flow.result(network, root, Times(np.array([step], dtype=np.intp), hours, series.calendar))


def _refuse_others(network: PerUnitNetwork) -> None:
    for table in network.tables.values():
        if table.kind not in _TAKEN and len(table):
            taken = ", ".join(kind.plural for kind in _TAKEN if kind not in _ON_PAPER)
            raise ModelError(
                f"{table.names[0]}: {table.kind.plural} have no set-points; a power flow takes {taken}"
            )


class _Flow:
    """The equations of a network at its set-points, and their unknowns."""

    def __init__(self, points: Held, shares: Array, tolerance: float, limit: int) -> None:
        self.points = points
        self.shares = shares
        self.network = points.network
        self.tolerance, self.limit = tolerance, limit
        self.limited = np.zeros(points.at.size, dtype=bool)
        self.iterations = 0
        model = Model(
            points.network.with_series(without_limits(points.network)),
            Horizon.chain(1),
            reactive=True,
            zones=np.arange(len(points.network.bus)),
        )
        for device in held_devices(points.network, HeldGenerators(shares, points.regulates)):
            model.connect(device)
        AC().declare(model)
        for name, published in model.published.items():
            model.build.output(name, published.values)
        self.model = model
        self.program: Program = model.build.build()
        self.evaluator = Evaluator(self.program)

    def solve(self, enforce_q_limits: bool) -> Root:
        """Solve, and again while generators exceed a limit of reactive power that is enforced."""
        root = self._find(self._starts())
        while enforce_q_limits and root.converged and self._limit(root.x):
            root = self._find(iter([self._with_voltages(root.x)]))
        return root

    def _find(self, starts: Iterator[Array]) -> Root:
        """Solve from the first start that leads to a solution."""
        best: Root | None = None
        for start in starts:
            parameters = self.program.default.parameters
            root = find_root(
                self.evaluator, parameters, start, self._free, tolerance=self.tolerance, limit=self.limit
            )
            self.iterations += root.iterations
            if best is None or root.residual < best.residual:
                best = root
            if root.converged:
                break
        assert best is not None
        return best

    def _starts(self) -> Iterator[Array]:
        """Starting points: angles of a linear power flow, then equal angles."""
        reference = self.points.va[self.network.island]
        for angles in (self.points.linear_angles(self.shares), reference):
            x = self.program.default.start.copy()
            x[self.program.variables["vm"].slice] = 1.0
            x[self.program.variables["va"].slice] = angles
            yield self._with_voltages(x)

    def _with_voltages(self, x: Array) -> Array:
        """Return a point with the held voltages and the reactive power of limited generators."""
        x = x.copy()
        holding = self.points.at[~self.limited]
        x[self.program.variables["vm"].index[holding, 0]] = self.points.vm[~self.limited]
        return x

    @property
    def _free(self) -> npt.NDArray[np.bool_]:
        """Mask of the unknowns."""
        free = np.ones(self.program.n_variables, dtype=bool)
        blocks = self.program.variables
        free[blocks["vm"].index[self.points.at[~self.limited], 0]] = False
        free[blocks["va"].index[self.points.reference, 0]] = False
        free[blocks["slack_q"].index[self.limited, 0]] = False
        for name in self.model.settings:  # taps, phase shifts and shunts stay at their neutral values
            free[blocks[name].slice] = False
        return free

    def _limit(self, x: Array) -> bool:
        """Hold generators at the limits of reactive power that they exceed; return whether there are any."""
        block = self.program.variables["slack_q"]
        extra = block.read(x)[:, 0]
        low, high = self.points.extra_range
        held = np.clip(extra, low, high)
        over = (np.abs(extra - held) > self.tolerance) & ~self.limited
        over &= ~np.isin(self.points.at, self.points.reference)
        self.limited |= over
        x[block.index[over, 0]] = held[over]
        return bool(over.any())

    def result(self, network: Network, root: Root, times: Times) -> PowerFlowResult:
        """Return what was found, in physical units."""
        base = self.network.base_mva
        values = self.evaluator.outputs(root.x, self.program.default.parameters)
        if not root.converged:
            values = {name: np.full_like(value, np.nan) for name, value in values.items()}
        slack = self.program.variables["slack"].read(root.x)[:, 0] * base
        names = self.network.bus.names
        return PowerFlowResult(
            network=network,
            status="converged" if root.converged else "diverged",
            max_mismatch=root.residual * base,
            iterations=self.iterations,
            slack={
                names[bus]: float(power) if root.converged else np.nan
                for bus, power in zip(self.points.reference, slack, strict=True)
            },
            limited=tuple(names[bus] for bus in self.points.at[self.limited]),
            notes=self.points.notes,
            _times=times,
            _arrays=self.network,
            _quantities={
                name: (p.kind, p.unit, p.description, values[name])
                for name, p in self.model.published.items()
            },
        )
