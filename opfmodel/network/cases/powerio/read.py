"""Reading of one file with powerio.

Diagnostics of powerio that state a loss, and equipment and fields that opfmodel does not represent, are an
error unless the user accepts the losses. Other diagnostics are issued as :class:`CaseWarning`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from opfmodel.data.files import check_file, is_folder
from opfmodel.errors import CaseError, OpfmodelError, listed, shown
from opfmodel.network.cases.losses import Losses
from opfmodel.network.cases.matpower import CaseFile, read_case
from opfmodel.network.cases.powerio.components import Reader
from opfmodel.network.cases.powerio.unrepresented import add_losses, harmless
from opfmodel.network.cases.warn import warn
from opfmodel.network.components import Bus
from opfmodel.network.costs import Cost
from opfmodel.network.network import Network

__all__ = ["read_powerio"]

_Fused = tuple[str, str, tuple[float, float]]
"""A bus, the bus that carries it, and the limits of its voltage, p.u."""


def read_powerio(
    path: Path, format: str | None, *, default_cost: Cost | None = None, lossy: bool = False
) -> Network:
    """Read a file of any format that powerio reads.

    Parameters and errors are those of :func:`opfmodel.network.cases.read.read_network`. Only generators
    whose cost cannot be represented and that are out of service are left out, with a warning. MATPOWER
    files are checked by :mod:`opfmodel.network.cases.matpower` first.
    """
    losses = Losses(str(path))
    module, source = _parse(path, format, losses)
    case, fused = _balanced(path, module.value, losses, merge_lines=source is None)
    add_losses(case, losses, every_field=source is None)
    try:
        name = path.stem if case.name in ("", "case") else str(case.name)
        network = Reader(path, case, Network(name, case.base_mva), default_cost, source, losses).read()
        _fuse(network, fused)
    except CaseError:
        raise
    except OpfmodelError as error:
        raise CaseError(f"{path}: {error}") from error
    losses.settle(lossy)
    return network


def _parse(path: Path, format: str | None, losses: Losses) -> tuple[Any, CaseFile | None]:
    """Parse a file with powerio; report what is lost, and warn about the rest of the diagnostics."""
    import powerio

    source = read_case(path) if _is_matpower(path, format) else None
    try:
        if source is not None:
            module = powerio.parse(source.text.encode(), format="matpower", name=path.name)
        else:
            for file in sorted(path.iterdir()) if is_folder(path) else [path]:
                if not is_folder(file):
                    check_file(file, CaseError)
            # powerio refuses symbolic links, so they are resolved first.
            module = powerio.parse(str(path.resolve()), format=format)
    except (powerio.PowerIOError, OSError, UnicodeError) as error:
        raise CaseError(f"{path}: {_reason(error, format)}") from error
    diagnostics = list(module.diagnostics)
    if source is not None:
        if source.changes and any(d.code == _NOT_EVALUATED for d in diagnostics):
            # powerio evaluates all of them or none, but does not report their lines.
            source.losses.append(source.unevaluated(source.changes))
            diagnostics = [d for d in diagnostics if d.code != _NOT_EVALUATED]
        for loss in source.losses:
            losses.add(loss)
        for remark in source.remarks:
            warn(remark)
    for diagnostic in diagnostics:
        if harmless(diagnostic):
            warn(f"{path}: {diagnostic.message} [{diagnostic.code}]")
        else:
            losses.add(f"{diagnostic.message.partition(': preserved only')[0]} [{diagnostic.code}]")
    return module, source


def _reason(error: Exception, format: str | None) -> str:
    """Describe why powerio cannot read a file, without its error codes."""
    code = getattr(error, "code", None)
    if code == _UNKNOWN_FORMAT:
        unknown = "the format cannot be inferred" if format is None else f"no format is named {shown(format)}"
        return f"cannot be read as a network: {unknown}; accepted are {_FORMATS}"
    return f"cannot be read as a network: {str(error).removeprefix(f'{code}: ')}"


_FORMATS = "MATPOWER .m, PSS/E .raw, pandapower JSON, PyPSA CSV folders and the other formats of powerio"
_UNKNOWN_FORMAT = "REQUEST.FORMAT.UNKNOWN"
_NOT_EVALUATED = "READ.MATPOWER.INDEXED_ASSIGNMENT"


def _is_matpower(path: Path, format: str | None) -> bool:
    import powerio

    if format is None:
        return path.suffix.lower() == ".m"
    known = powerio.resolve_format(format)
    return known is not None and known.token == "matpower"


def _balanced(path: Path, value: Any, losses: Losses, *, merge_lines: bool) -> tuple[Any, Sequence[_Fused]]:
    """Extract the balanced network, and the buses of the file if some of them were merged.

    Parameters
    ----------
    merge_lines
        Whether lines without impedance connect their buses as closed switches do.
    """
    import powerio

    if isinstance(value, powerio.TimeSeries):
        losses.add(f"{len(value)} snapshots: only the first is used")
        value = value[0]
    if not isinstance(value, powerio.BalancedNetwork) and hasattr(value, "network"):
        losses.add(f"a {type(value).__name__}: only its network is read")
        value = value.network
    if not isinstance(value, powerio.BalancedNetwork):
        raise CaseError(f"{path}: contains a {type(value).__name__}; must be a balanced transmission network")
    closed = [switch for switch in value.switches if switch["closed"]]
    lines = [b for b in value.branches if b["in_service"] and b["r"] == b["x"] == 0] if merge_lines else []
    rated = [
        f"{end['from_id']}-{end['to_id']}"
        for end in (*closed, *lines)
        if any(end.get(key) for key in ("thermal_rating", "current_rating", "rate_a"))
    ]
    if rated:
        losses.add(f"ratings of closed switches and lines without impedance: {listed(rated)}")
    if not closed and not lines:
        return value, []
    merged = value.merge_buses(closed_switches=True, zero_impedance="exact" if lines else None)
    warn(f"{path}: buses joined by closed switches or lines without impedance were merged")
    into = merged.merged_buses
    return merged.network, [
        (str(record["id"]), str(into.get(record["id"], record["id"])), (record["vmin"], record["vmax"]))
        for record in value.buses
    ]


def _fuse(network: Network, fused: Sequence[_Fused]) -> None:
    """State which bus carries each bus of the file, and apply the voltage limits of all of them."""
    for bus, into, (low, high) in fused:
        if bus != into:
            limits = network.of(Bus)[into].vm
            network.update(into, vm=(max(low, limits[0]), min(high, limits[1])))
    network.alias({bus: into for bus, into, _ in fused})
