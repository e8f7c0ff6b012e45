"""Voltages of imported networks compared with the tool that they come from.

python -m benchmarks.imports writes the tables of docs/inputs.md.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import opfmodel as om
from benchmarks.harness import splice

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "inputs.md"
CASES = (
    "case4gs case5 case6ww case9 case14 case24_ieee_rts case30 case33bw case39 case57 case89pegase case118 "
    "case145 case300 case_illinois200 case1888rte iceland GBreducednetwork create_cigre_network_hv "
    "create_cigre_network_mv create_cigre_network_lv mv_oberrhein example_multivoltage example_simple "
    "simple_four_bus_system simple_mv_open_ring_net create_kerber_landnetz_freileitung_1 "
    "create_kerber_dorfnetz create_kerber_vorstadtnetz_kabel_1 create_synthetic_voltage_control_lv_network"
)


def networks() -> Iterator[tuple[str, Callable[[], Any]]]:
    """Names and constructors of pandapower's networks."""
    import pandapower.networks as grids

    for name in CASES.split():
        yield name.removeprefix("create_"), getattr(grids, name)
    for der in ("all", "pv_wind"):
        yield f"cigre_network_mv, {der}", lambda der=der: grids.create_cigre_network_mv(with_der=der)


def differences() -> Iterator[tuple[str, int, float, float]]:
    """Name, buses, and the maximum differences of magnitudes (p.u.) and angles (degrees)."""
    import pandapower as pp

    from opfmodel.network.cases.pandapower.source import element_names

    for name, make in networks():
        net = make()
        net = net[0] if isinstance(net, tuple) else net
        network = om.from_pandapower(net)
        pp.runpp(net, calculate_voltage_angles=True, tolerance_mva=1e-9, max_iteration=50)
        names = element_names(net)
        found = net.res_bus[net.res_bus.vm_pu.notna()]
        theirs = {names["bus", i]: found.loc[i] for i in found.index}
        flow = om.power_flow(network)
        assert flow.converged, f"{name}: {flow.status}"
        mine = flow.data.isel(time=0).sel(bus=[network.aliases.get(bus, bus) for bus in theirs])
        vm = np.abs(mine["vm"].values - [v.vm_pu for v in theirs.values()]).max()
        turned = mine["va"].values - [v.va_degree for v in theirs.values()]
        va = np.abs((turned + 180) % 360 - 180).max()
        yield name, len(net.bus), vm, va


def main() -> None:
    """Write the tables."""
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("ignore")
    rows = [f"| {name} | {buses:,} | {vm:.1e} | {va:.1e} |" for name, buses, vm, va in differences()]
    head = f"pandapower {version('pandapower')}; maximum over all buses.\n\n"
    columns = "| network | buses | magnitude, p.u. | angle, degrees |\n| --- | ---: | ---: | ---: |\n"
    splice(PAGE, "pandapower voltages", head + columns + "\n".join(rows))


if __name__ == "__main__":
    main()
