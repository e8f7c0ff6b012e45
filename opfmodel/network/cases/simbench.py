"""Grids of SimBench with their time series, from the package ``simbench``, which holds the data."""

from __future__ import annotations

import importlib.util
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import Calendar
from opfmodel.data.series import Profiles
from opfmodel.errors import CaseError, nearest
from opfmodel.network.cases.pandapower import convert
from opfmodel.network.cases.pandapower.source import element_names
from opfmodel.network.costs import Cost
from opfmodel.network.network import Network

__all__ = ["read_simbench"]

_PREFIX = "simbench:"
# The year 2016 in local time, every quarter of an hour, with both clock changes.
_CALENDAR = Calendar(np.datetime64("2015-12-31T23:00"), 0.25, "Europe/Berlin")


def read_simbench(
    path: Path,
    format: str | None,  # noqa: ARG001
    *,
    default_cost: Cost | None = None,
    lossy: bool = False,
) -> Network | None:
    """Read a grid of SimBench by its code, with its time series of the year 2016.

    Returns None unless the path is ``simbench:CODE``; a folder before it is ignored. Loads follow their
    profiles. Static generators may be curtailed below theirs and inject no reactive power. Storages are
    decided between plus and minus their rated power, without reactive power, in place of the profiles that
    SimBench gives them.

    Raises
    ------
    CaseError
        The package ``simbench`` is not installed, has no such grid, or something would be lost.

    References
    ----------
    Meinecke et al., "SimBench—A Benchmark Dataset of Electric Power Systems to Compare Innovative
    Solutions Based on Power Flow Analysis", Energies 13 (2020) 3290.
    """
    if not path.name.startswith(_PREFIX):
        return None
    code = path.name.removeprefix(_PREFIX)
    if importlib.util.find_spec("simbench") is None:
        raise CaseError(
            f"{path.name}: needs the package simbench, which is not installed: "
            "pip install 'opfmodel[simbench]'"
        )
    import simbench

    known = simbench.collect_all_simbench_codes()
    if code not in known:
        raise CaseError(f"{path.name}: SimBench has no grid {code!r}; {nearest(code, known)}")
    with warnings.catch_warnings(action="ignore"):
        net = simbench.get_simbench_net(code)
        values = simbench.get_absolute_values(net, profiles_instead_of_study_cases=True)
    _release(net)
    network = convert(net, path.name, default_cost, lossy, code)
    network.attach(_profiles(net, values))
    return network


def _release(net: Any) -> None:
    """Let static generators and storages be decided."""
    rated = net.storage.sn_mva
    for table, low, high in (("sgen", 0.0, net.sgen.p_mw), ("storage", -rated, rated)):
        frame = net[table]
        frame["controllable"] = True
        frame["min_p_mw"], frame["max_p_mw"] = low, high
        frame["min_q_mvar"], frame["max_q_mvar"] = 0.0, 0.0


def _profiles(net: Any, values: Any) -> Profiles:
    """Time series of loads and of the available power of static generators."""
    names = element_names(net)
    series: dict[tuple[str, str], npt.NDArray[np.float64]] = {}
    for (table, column), field in {
        ("load", "p_mw"): "p",
        ("load", "q_mvar"): "q",
        ("sgen", "p_mw"): "p_max",
    }.items():
        frame = values[table, column]
        scaling = net[table].scaling.reindex(frame.columns).to_numpy()
        scaled = frame.to_numpy() * scaling
        if field == "p_max":
            scaled = np.maximum(scaled, 0.0)  # some draw a few watts at night
        for number, index in enumerate(frame.columns):
            series[names[table, index], field] = np.ascontiguousarray(scaled[:, number])
    return Profiles(series, _CALENDAR)
