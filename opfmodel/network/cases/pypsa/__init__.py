"""Networks of PyPSA, in memory and in files, with their snapshots and time series."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from opfmodel.data.series import Profiles
from opfmodel.errors import CaseError, OpfmodelError, listed
from opfmodel.network.cases.losses import Losses
from opfmodel.network.cases.pypsa.attributes import add_losses
from opfmodel.network.cases.pypsa.components import Converter
from opfmodel.network.cases.pypsa.file import is_pypsa, load
from opfmodel.network.cases.pypsa.snapshots import steps_of
from opfmodel.network.cases.pypsa.source import PREFIXES, UNNAMED, Source
from opfmodel.network.cases.pypsa.tables import check_tables
from opfmodel.network.cases.warn import warn
from opfmodel.network.components.dc_line import MOST_LOSS
from opfmodel.network.costs import Cost
from opfmodel.network.network import Network
from opfmodel.network.series import check_series

if TYPE_CHECKING:
    import pypsa

__all__ = ["from_pypsa", "read_pypsa"]

_VOLTAGE = (0.9, 1.1)  # limits of buses without, as those of opfmodel.Bus


def from_pypsa(
    n: pypsa.Network,
    *,
    lossy: bool = False,
    voltage: tuple[float, float] = _VOLTAGE,
    free_dispatch: bool = False,
) -> Network:
    """Convert a network of PyPSA; its time series become :attr:`Network.profiles`.

    Components keep their names. PyPSA's are unique within a class only: a name that several classes have
    stays with the bus, and the others are called ``line_NAME``, ``transformer_NAME``, ``generator_NAME``,
    ``load_NAME``, ``storage_unit_NAME``, ``store_NAME``, ``shunt_NAME`` and ``link_NAME``. Constant values
    are those of the first snapshot. Impedances are per unit on 1 MVA, as in PyPSA. Links become DC lines.

    Parameters
    ----------
    n
        The network, which is not changed.
    lossy
        Warn about what opfmodel does not represent, and convert the rest, instead of raising an error.
    voltage
        ``(min, max)`` of the voltage magnitude, p.u., at buses without ``v_mag_pu_min`` or
        ``v_mag_pu_max``, which PyPSA leaves at 0 and infinity.
    free_dispatch
        Take ``p_set`` of generators, storage units, stores and links for the set-point of a power flow only.
        By default it also fixes their power, as in ``n.optimize()``.

    Raises
    ------
    CaseError
        The network contains what opfmodel does not represent, or invalid data; or its snapshots are
        not equally spaced.

    Notes
    -----
    ``n.optimize()`` is the formulation ``dc-matpower``, except that it neglects phase shifts, the power
    of shunts, and the magnetising branch of transformers in their reactance. Standing losses, ramp limits
    and the power limits of stores depend on the length of the snapshots and are converted for it. The
    initial energy is larger than PyPSA's by the standing loss of one snapshot, which PyPSA leaves out.
    """
    import pypsa

    if not isinstance(n, pypsa.Network):
        raise CaseError(f"from_pypsa: {type(n).__name__}: must be a pypsa.Network")
    return _convert(n, Source.title_of(n), lossy, voltage, free_dispatch)


def read_pypsa(
    path: Path,
    format: str | None,
    *,
    default_cost: Cost | None = None,  # noqa: ARG001 - PyPSA states every cost
    lossy: bool = False,
) -> Network | None:
    """Read a netCDF file or a CSV folder of PyPSA.

    Returns None if the path has another format, or if PyPSA is not installed and a folder holds only what
    powerio reads faithfully. Parameters and errors are those of :func:`from_pypsa`.
    """
    if not is_pypsa(path, format):
        return None
    n = load(path)
    if n is None:
        return None
    if n.name in ("", UNNAMED):
        n.name = path.stem
    return _convert(n, str(path), lossy, _VOLTAGE, False)


def _convert(
    n: pypsa.Network, title: str, lossy: bool, voltage: tuple[float, float], free_dispatch: bool
) -> Network:
    losses = Losses(title)
    if n.has_scenarios:
        first = n.scenarios[0]
        losses.add(f"{len(n.scenarios)} scenarios: only {first!r} is read")
        n = n.get_scenario(first)
    check_tables(n, title)
    try:
        hours, calendar = steps_of(n, title, losses)
        source = Source(n, title, hours)
        _find_losses(source, losses)
        losses.settle(lossy)
        converter = Converter(source, voltage, free_dispatch)
        network = converter.convert()
        network.attach(Profiles(converter.series, calendar))
        check_series(network.profiles, network)
    except CaseError:
        raise
    except OpfmodelError as error:
        raise CaseError(f"{title}: {error}") from error
    _note(source, free_dispatch)
    return network


# What is lost --------------------------------------------------------------------------------------


def _find_losses(source: Source, losses: Losses) -> None:
    represented = set(source.buses)
    for bus, carrier in source.static("buses").carrier.items():
        if bus not in represented:
            losses.add(
                f"Bus {str(bus)!r}: carrier = {carrier!r}: only AC is represented; it is left out with "
                "everything at it"
            )
    kept = {"buses": source.buses} | {name: source.active(name) for name in PREFIXES}
    for components in source.n.components:
        if components.list_name not in kept:
            table = components.static
            kept[components.list_name] = list(table.index[table.active] if "active" in table else table.index)
    add_losses(source.n, kept, losses)
    for name in source.active("generators"):
        _add_ramp_losses(source, name, losses)
    for name in source.active("links"):
        _add_link_losses(source, name, losses)
    _add_cyclic_losses(source, losses)


def _add_ramp_losses(source: Source, name: str, losses: Losses) -> None:
    up, down = np.broadcast_arrays(*source.ramp_limits(name))
    if np.isnan(up).all() and np.isnan(down).all():
        return
    if not np.array_equal(up, down, equal_nan=True):
        losses.add(
            f"Generator ramp_limit_up, ramp_limit_down: differ for {str(name)!r}: one limit holds in both "
            "directions; the tighter is used"
        )
    start, up_time = (source.first("generators", name, a) for a in ("p_init", "up_time_before"))
    if not np.isnan(start) or up_time == 0:
        losses.add(
            f"Generator {'up_time_before' if np.isnan(start) else 'p_init'} of {str(name)!r}: the power "
            "before the first snapshot is free; MultiStage.solve(initial={'pg': ...}) gives it"
        )


def _add_link_losses(source: Source, name: str, losses: Losses) -> None:
    """Report links that gain energy, or are paid for carrying power."""
    efficiency, cost = (source.value("links", name, key) for key in ("efficiency", "marginal_cost"))
    first = source.first("links", name, "efficiency")
    if first > 1.0 or first < 1.0 - MOST_LOSS:
        losses.add(
            f"Link efficiency of {str(name)!r}: {first:g}: a DC line delivers at most what it is sent, and "
            f"at least {1.0 - MOST_LOSS:g} of it"
        )
    backward = bool(np.any(source.link_power(name)[0] < 0))
    if backward and np.any(efficiency != 1.0):
        losses.add(
            f"Link p_min_pu of {str(name)!r}: power that flows backward gains by the efficiency of "
            f"{first:g}; the loss of a DC line counts in both directions"
        )
    if np.any(cost < 0):
        losses.add(f"Link marginal_cost of {str(name)!r}: is negative; it is taken as 0")
    if backward and np.any(cost != 0):
        losses.add(
            f"Link marginal_cost of {str(name)!r}: is earned on power that flows backward; a DC line costs "
            "the same in both directions"
        )


def _add_cyclic_losses(source: Source, losses: Losses) -> None:
    """Report cyclic ends that are no end of a problem: of some storages only, or with varying limits."""
    storages = list(source.storages())
    cyclic = [key for key in storages if source.cyclic(*key)]
    if cyclic and len(cyclic) < len(storages):
        losses.add(
            f"cyclic end of {listed([repr(source.names[key]) for key in cyclic])}: the end of a problem is "
            "that of all storages or of none"
        )
    for key in cyclic:
        if any(np.ptp(limits) for limits in source.energy(*key)):
            losses.add(
                f"cyclic end of {source.names[key]!r}: its energy limits vary; those of the first snapshot "
                "also hold at its beginning"
            )


# What is represented, and yet surprising -----------------------------------------------------------


def _note(source: Source, free_dispatch: bool) -> None:
    cyclic = [key for key in source.storages() if source.cyclic(*key)]
    if cyclic:
        warn(
            f"{source.title}: {_names(source, cyclic)}: energy ends where it begins; the end belongs to the "
            "problem: solve it with end=End(cyclic=True) and initial={'e': None}"
        )
    fixed = [
        (class_name, member)
        for class_name in ("generators", "storage_units", "stores", "links")
        for member in source.active(class_name)
        if not np.isnan(source.value(class_name, member, "p_set")).all()
    ]
    if fixed and not free_dispatch:
        warn(
            f"{source.title}: {_names(source, fixed)}: p_set fixes the power, as in n.optimize(); without "
            "it, or with from_pypsa(..., free_dispatch=True), the power is free"
        )
    lines = source.static("lines")
    closed = [("lines", member) for member in source.active("lines") if lines.s_nom.at[member] == 0.0]
    if closed:
        warn(f"{source.title}: {_names(source, closed)}: s_nom = 0: carries nothing in an optimum")


def _names(source: Source, keys: list[tuple[str, str]]) -> str:
    return listed([repr(source.names[key]) for key in keys])
