"""Scenarios with every section, and the files that they name."""

from __future__ import annotations

DECLARED = """\
name: declared
description: every section of a scenario
network:
  base_mva: 50
  buses: {a: {vm: [0.95, 1.05], reference: true}, b: {base_kv: 110}, 3: {}}
  branches:
    line: {from_bus: a, to_bus: b, r: 0.01, x: 0.1, b: 0.02, rating: 80, tap: 0.98, shift: 2, angle: [-30, 30]}
    cable: {from_bus: b, to_bus: 3, r: 0.01, x: 0.05}
  generators:
    coal: {bus: a, p: [0, 90], q: [-50, 50], ramp: 40% of p_max, cost: {c2: 0.01, c1: 20, c0: 5}}
    peaker: {bus: b, p: [0, 40], cost: {points: [[0, 0], [20, 800], [40, 2000]]}}
  storages: {cell*: {bus: "*", energy: 20, power: [-5, 5], q: 2, initial: 8, charge_efficiency: 0.9, standing_loss: 0.001}}
  loads: {town: {bus: b, p: 50, q: 10}, mill: {bus: 3, p: 12}}
  shunts: {capacitor: {bus: 3, b: 4}}
  update: {"cell*": {rating: 6}}
  remove: [cell3]
time: {step: 0.5, steps: 3}
profiles:
  - scale: {factor: 1.1, loads: [town]}
  - step: {loads: [mill], first: 1, last: 2, add: 3}
  - noise: {deviation: 0.02, correlation: 0.5, seed: 1}
  - power-factor: {value: 0.95}
  - table: {file: series.csv}
  - shape: {file: series.csv, column: curve}
cost: [{economic: {reactive_weight: 0.01}, weight: 2}, voltage-deviation]
controller:
  horizon: 2
  formulation: ac
  objective: {setpoint-tracking: {setpoints: {coal.pg: 40, cella.e: [8, 9, 10, 11]}, state_weight: 1}}
  generator_delay: 1
  initial_dispatch: free
  end: {cyclic: false, minimum: 0.2, price: 10}
  regularisation: 0.001
  on_infeasible: elastic
  solver: {name: ipopt, options: {max_iter: 200}}
forecast: {noisy: {deviation: 0.03, seed: 7, fields: [p, q]}}
plant: {mode: redispatch, price: 50, shedding_price: 5000}
constraints:
  reserve: {terms: {generator.p_max: 1, generator.pg: -1}, at_least: 5}
  mix: {terms: {"c*.pg": 0.4, peaker.pg: -0.6}, at_most: [50, 50, 50, 50]}
  contract: {terms: {line.pf: 1}, at_most: {file: series.csv, column: limit}}
published: {source: nobody, J_e: 1000.0}
variants:
  dc: {controller: {formulation: dc, objective: economic, solver: auto}}
"""
FROM_FILE = """\
network:
  file: case.m
  default_cost: 30
  update: {"gen*": {ramp: 50% of p_max}, gen1: {p: [10, 200]}}
  storages: &cells {cell*: {bus: "*", energy: 20, power: 5}}
time: &time {steps: 4}
profiles: [table: {file: demand.csv}]
cost: economic
controller: {horizon: 3, formulation: dc-losses, objective: [economic, {linear-quadratic: {Q: {pg: 1.0}, r: {ps: 0.5}}}]}
forecast: {file: {file: forecast.csv}}
plant: {mode: power-flow, participation: {gen1: 1, gen2: 2}}
variants:
  short: {time: {<<: *time, step: 0.25}, forecast: persistence}
  blind: {forecast: persistence, controller: {objective: loss-minimisation}}
"""
SERIES = "curve,limit,town.p,coal.p_max,line.rating\n" + "1,70,50,80,inf\n2,70,55,90,60\n" * 3
DEMAND = "# MW\nload5.p,load5.q\n" + "90,30\n95,31\n" * 4
FORECAST = "issued,load5.p\n" + "0,91\n" * 8 + "2,92\n" * 8

TABLE = """\
network:
  buses: {a: {}, b: {}}
  branches: {line: {from_bus: a, to_bus: b, r: 0.01, x: 0.1}}
  generators: {coal: {bus: a, p: [0, 200], cost: {c1: 20}}}
  loads: {town: {bus: b, p: 50, q: 10}}
time: {steps: 4}
profiles: [{table: {file: FILE}}]
controller: {horizon: 2, formulation: dc}
"""
CELLS = "hour,town.p,town.q,coal.p_max\n" + "".join(
    f"{n},{50 + n},{10 + n / 8},{180 - n}\n" for n in range(8)
)
STUDY = """\
name: grid
scenario: tiny.yaml
set: {controller.generator_delay: 0}
vary:
  controller.horizon: [1, 2]
  demand: {measured: {}, scaled: {profiles: [{table: {file: demand.csv}}, {scale: {factor: 1.1}}]}}
"""
TINY = """\
network:
  buses: {a: {}}
  generators: {unit: {bus: a, p: [0, 100], cost: {c1: 20}}}
  loads: {town: {bus: a, p: 50}}
time: {steps: 2}
profiles: [{table: {file: demand.csv}}]
controller: {formulation: copperplate}
"""
TINY_DEMAND = "town.p\n10\n20\n30\n40\n"
STAMPED = "time,town.p,town.q\n" + "".join(
    f"2025-03-29T{n:02}:00+01:00,{50 + n},{10 + n / 8}\n" for n in range(8)
)
QUARTERS = "time,town.p\n" + "".join(
    f"2025-03-29T{n // 4:02}:{n % 4 * 15:02}+01:00,{50 + n}\n" for n in range(32)
)
UNITS = """\
currency: EUR
network:
  base_mva: 100
  buses: {a: {vm: [0.95 pu, 1.05 pu], base_kv: 110 kV, reference: true}}
  generators: {unit: {bus: a, p: [0, 1.2 GW], ramp: 5 MW/min, cost: {c2: 0.01 EUR/MW²h, c1: 40 EUR/MWh}}}
  storages: {cell: {bus: a, energy: 200 MWh, power: [-500 kW, 0.5 pu], charge_efficiency: 95 %, initial: 25% of energy}}
  loads: {town: {bus: a, p: 100 MW, q: 20 MVAr}}
time: {start: 2025-03-29T00:00, zone: Europe/Berlin, step: 60 min, steps: 3, at_end: repeat}
profiles: [{table: {file: t.csv}}]
controller: {horizon: 2, formulation: dc, end: {price: 0.03 EUR/kWh}, elastic: {shedding: 9 kEUR/MWh}}
"""
