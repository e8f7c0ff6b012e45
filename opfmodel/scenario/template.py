"""A commented scenario to start from."""

from __future__ import annotations

from opfmodel.network.components import Generator, Load, Storage
from opfmodel.network.network import Network
from opfmodel.scenario.write import scalar

__all__ = ["template"]

_OWN_NETWORK = """\
network:
  base_mva: 100                # power base of impedances, MVA
  buses:                       # vm: [min, max] voltage, p.u.; one bus is the reference of the angles
    north: {vm: [0.95, 1.05], reference: true}
    south: {vm: [0.95, 1.05]}
  branches:                    # r, x in p.u. on base_mva; rating in MVA
    tie: {from_bus: north, to_bus: south, r: 0.01, x: 0.1, rating: 80}
  generators:                  # p, q: [min, max] in MW and MVAr; ramp in MW/h; cost c2 P^2 + c1 P + c0 in $/h
    coal: {bus: north, p: [0, 200], q: [-80, 80], ramp: 20% of p_max, cost: {c2: 0.01, c1: 15}}
    gas: {bus: south, p: [0, 60], q: [-30, 30], cost: {c1: 40}}
  loads:                       # demand in MW and MVAr, which profiles change over time
    town: {bus: south, p: 90, q: 30}
  storages:                    # energy in MWh; power and q: the number a stands for [-a, a], in MW and MVAr
    cell: {bus: south, energy: 40, power: 10, q: 5, charge_efficiency: 0.95, discharge_efficiency: 0.95}
"""
_REST = """\
time:
  step: 1                      # hours per stage
  steps: {steps}                     # stages that the closed loop runs

profiles:                      # rules that make time series, applied in order; 'opfmodel list' shows all
  - step: {{loads: [{load}], first: 2, last: 4, add: {more}}}   # MW more in these stages
  # - table: {{file: demand.csv}} # columns headed component.field, such as {load}.p

cost: economic                 # what is reported, and minimised unless the controller has another objective

controller:
  horizon: {horizon}                   # stages that each plan looks ahead
  formulation: ac              # or dc, soc, dc-losses, ...: 'opfmodel list'
  # end: {{cyclic: true}}        # storage ends each plan as full as it began

forecast: perfect              # or persistence, {{noisy: {{deviation: 0.05, seed: 1}}}}

plant: nominal                 # what answers the plans: nominal, power-flow or redispatch

variants:                      # overrides by name: opfmodel run FILE --variant dc
  dc:
    controller: {{formulation: dc}}
    plant: redispatch
"""


def template(
    network: Network | None = None, file: str = "", *, lossy: bool = False, price: bool = False
) -> str:
    """Text of a scenario that explains each key in a comment and runs as it is.

    Parameters
    ----------
    network, file
        A network that the scenario starts from, and its file relative to the scenario; without them,
        the scenario declares two buses.
    lossy
        Whether the file can only be read with losses.
    price
        Whether the file has no costs.
    """
    head = "# A scenario: network, time series, controller and closed loop. Keys: docs/scenarios.md.\n\n"
    if network is None:
        return head + _OWN_NETWORK + "\n" + _REST.format(steps=12, horizon=8, load="town", more=20)
    loads = {n: c for n, c in network.of(Load).items() if c.in_service and c.p > 0}
    largest = max(loads, key=lambda name: loads[name].p, default=None)
    section = ["network:", f"  file: {scalar(file):<22} # relative to this file"]
    if lossy:
        section.append("  lossy: true                  # what opfmodel does not represent is lost")
    if price:
        section.append("  default_cost: 30             # $/MWh of generators for which the file has no cost")
    units = [name for name, unit in network.of(Generator).items() if unit.in_service]
    if units:
        section += [
            "  # update:                    # changes to components, by name or pattern",
            f"  #   {scalar(units[0])}: {{ramp: 20% of p_max}}",
        ]
    if largest is not None and not network.of(Storage) and "cell" not in network:
        bus, power = loads[largest].bus, float(f"{0.1 * loads[largest].p:.2g}")
        section += [
            "  storages:                    # energy in MWh, power in MW; added to those of the file",
            f"    cell: {{bus: {scalar(bus)}, energy: {scalar(4 * power)}, power: {scalar(power)}}}",
        ]
    rest = _REST
    if largest is None:  # nothing to change over time
        before, _, after = rest.partition("profiles:")
        rest = before + after.partition("\n\n")[2]
        return head + "\n".join(section) + "\n\n" + rest.format(steps=4, horizon=4)
    more = float(f"{0.02 * loads[largest].p:.2g}")
    filled = rest.format(steps=4, horizon=4, load=scalar(largest), more=scalar(more))
    return head + "\n".join(section) + "\n\n" + filled
