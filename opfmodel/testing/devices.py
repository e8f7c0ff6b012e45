"""The contract of a device."""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import is_dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from opfmodel import plugins
from opfmodel.check import check
from opfmodel.errors import PluginError
from opfmodel.formulations.base import Formulation
from opfmodel.horizon import Horizon
from opfmodel.model import Device, Model, NumericStage
from opfmodel.network.arrays import per_unit
from opfmodel.network.component import Component
from opfmodel.network.components import BUILT_IN, Branch, Bus, Generator, Load
from opfmodel.network.costs import Polynomial
from opfmodel.network.network import Network
from opfmodel.network.units import UNITS
from opfmodel.plan import MultiStage
from opfmodel.plan.parts import make_devices
from opfmodel.simulation import simulate
from opfmodel.testing.grids import HORIZONS
from opfmodel.testing.options import check_documentation
from opfmodel.testing.sampling import at_random
from solvers import Kind, classify
from solvers.testing import Contract

__all__ = ["check_device"]

_VIOLATION = 1e-6  # p.u.


def check_device(device: Device, example: Component) -> None:
    """Raise :class:`ContractError` unless a device satisfies its contract.

    - Its component is a frozen dataclass of declared fields.
    - It declares the same quantities under every formulation, and injects power at its buses if it has some.
    - With a linear network, the program is at most conic and every cost is convex.
    - Its own cost is finite and convex, has one value per stage, and is the same when evaluated
      numerically and in the program.
    - It supports one stage, several stages, and networks without its components.
    - A closed loop passes on its states, and results report its injections.

    Parameters
    ----------
    example
        A component of its kind; the names of its buses do not matter.
    """
    rules = Contract(f"device {type(device).__name__}")
    rules.require(isinstance(device, Device), "is a Device")
    check_documentation(rules, type(device))
    _check_component(rules, device, example)
    grid = _grid(example)
    _check_declarations(rules, device, grid)
    rng = np.random.default_rng(1)
    for horizon in HORIZONS:
        problem = MultiStage(grid, horizon, formulation="dc", regularisation=0.0, devices=[device])
        with rules.rule("compiles with a linear network"):
            program = problem.compile()
        structure = classify(program)
        found = f"{', '.join(structure.culprits)} make it a {structure.kind}"
        rules.require(structure.kind <= Kind.CONIC, "is convex with a linear network", found)
        with rules.rule("can be solved with a linear network"):
            plan = problem.solve()
        rules.require(plan.optimal, "can be solved with a linear network", plan.termination)
        points = [at_random(plan, rng) for _ in range(4)]
        for point in points:
            value, compiled = point.objective, point.solution.objective
            same = abs(value - compiled) <= 1e-9 * (1.0 + abs(value))
            rules.require(
                same, "has the same cost numerically and in the program", f"{value:.12g}, {compiled:.12g}"
            )
        for one, other in pairwise(points):
            _check_cost(rules, device, one.stage, other.stage, len(horizon))
    _check_loop(rules, device, grid)


def _check_component(rules: Contract, device: Device, example: Component) -> None:
    """The component class and the example are well formed."""
    component = device.component
    ready = isinstance(component, type) and issubclass(component, Component) and is_dataclass(component)
    rules.require(ready, "its component is a dataclass and a Component", repr(component))
    frozen = getattr(component, "__dataclass_params__").frozen  # noqa: B009 - no stub has it
    rules.require(frozen, "its component is frozen", component.__name__)
    named = all(isinstance(getattr(component, name, None), str) for name in ("kind", "plural"))
    rules.require(named, "its component has a kind and a plural")
    taken = [
        c for c in BUILT_IN if c is not component and {c.kind, c.plural} & {component.kind, component.plural}
    ]
    rules.require(not taken, "its kind and plural are unique", component.kind)
    rules.require(type(example) is component, "the example is an instance of its component", repr(example))
    with rules.rule("its fields are declared by number, span, flag and at_bus"):
        strange = [f.name for f in component.fields().values() if f.metadata["unit"] not in UNITS]
        example.check("example")
        rules.require(not strange, "its fields have known units", ", ".join(strange))
    silent = [f.name for f in component.fields().values() if not f.metadata.get("description")]
    rules.require(not silent, "its fields are described", ", ".join(silent))
    rules.require("in_service" in component.fields(), "its component has the field in_service")


def _grid(example: Component) -> Network:
    """Build a two-bus grid with ample supply and the example at one bus."""
    grid = Network("device", base_mva=100)
    grid.add("north", Bus(reference=True))
    grid.add("south", Bus())
    grid.add("line", Branch("north", "south", r=0.001, x=0.01))
    cost = Polynomial(0.01, 30, 0)
    grid.add("slack", Generator("north", p=(-400, 400), q=(-400, 400), cost=cost))
    grid.add("town", Load("south", p=10, q=2))
    places = dict(zip(example.bus_fields(), ("south", "north"), strict=False))
    grid.add("example", replace(example, **places))  # type: ignore[type-var]
    return grid


def _formulations() -> Iterator[Formulation]:
    for plugin in plugins.plugins("formulation").values():
        try:
            yield plugin.load()()
        except PluginError:
            continue  # not the fault of this device


def _check_declarations(rules: Contract, device: Device, grid: Network) -> None:
    """Quantities do not depend on the formulation, power is injected, an empty table is accepted."""
    empty = grid.copy()
    empty.remove("example")
    empty.add("example", replace(grid["example"], in_service=False))  # type: ignore[type-var]
    seen: dict[bool, set[str]] = {}
    for formulation in _formulations():
        for horizon in HORIZONS:
            model, injected = _declared(rules, device, grid, formulation, horizon)
            at_bus = bool(device.component.bus_fields())
            rules.require(bool(injected) == at_bus, "injects power where it has a bus (model.inject)")
            names = {name for name, p in model.published.items() if p.kind == device.component.kind}
            same = names == seen.setdefault(formulation.reactive, names)
            found = f"{', '.join(sorted(names))} with {formulation.name}"
            rules.require(same, "declares the same quantities under every formulation", found)
        _declared(rules, device, empty, formulation, Horizon.chain(2))


def _declared(
    rules: Contract, device: Device, grid: Network, formulation: Formulation, horizon: Horizon
) -> tuple[Model, list[Any]]:
    """Return the model of a device under a formulation, and the injections of the device."""
    arrays = per_unit(grid)
    zones = formulation.zones(arrays)
    model = _Watching(arrays, horizon, reactive=formulation.reactive, zones=zones)
    formulation.declare(model)
    for other in make_devices(arrays, [device]):  # to whose quantities the device may refer
        if other is not device:
            model.connect(other)
    model.watched = []
    how = "without" if not len(arrays.tables[device.component.kind]) else "with"
    with rules.rule(f"can be declared {how} components over {horizon} under {formulation.name}"):
        model.connect(device)
        device.cost(model)
    return model, model.watched


class _Watching(Model):
    """A model that records injections."""

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **keywords)
        self.watched: list[Any] = []

    def inject(self, bus: Any, p: Any = None, q: Any = None) -> None:
        """Record the injection and pass it on."""
        self.watched += [power for power in (p, q) if power is not None]
        super().inject(bus, p, q)


def _check_cost(rules: Contract, device: Device, one: NumericStage, other: NumericStage, stages: int) -> None:
    """The cost of the device alone is finite and convex, with one value per stage."""
    middle = copy(one)
    middle.values = {key: 0.5 * (one.values[key] + other.values[key]) for key in one.values}
    with rules.rule("its cost can be evaluated numerically"):
        costs = [device.cost(stage) for stage in (one, other, middle)]
    if all(cost is None for cost in costs):
        return
    first, second, between = (np.asarray(cost, dtype=float) for cost in costs)
    rules.require(first.shape == (stages,), "its cost has one value per stage", f"shape {first.shape}")
    rules.require(np.isfinite(first).all(), "its cost is finite", str(first))
    chord = 0.5 * (first + second)
    rules.require(
        (between <= chord + 1e-9 * (1 + np.abs(chord))).all(), "its cost is convex in its quantities"
    )


def _check_loop(rules: Contract, device: Device, grid: Network) -> None:
    """A closed loop with the AC equations passes on states, and its results are complete."""
    problem = MultiStage(grid, 2, devices=[device])
    with rules.rule("runs in a closed loop"):
        run = simulate(problem, steps=3)
        data = run.data
    rules.require(run.status == "done", "runs in a closed loop", run.termination)
    for state in problem.model.states.values():
        if state.role == "stock":
            before, after = data[f"{state.name}_next"].values[:-1], data[state.name].values[1:]
            rules.require(np.allclose(before, after, atol=1e-6), "a stock is carried from step to step")
    report = check(grid, data)
    unknown = [what for what in report.unchecked if what.startswith("balance")]
    rules.require(not unknown, "results report its injections", "; ".join(unknown))
    found = "" if report.worst is None else f"{report.worst.family}: {report.worst.value:.1e} p.u."
    rules.require(report.max_violation <= _VIOLATION, "satisfies limits and balances", found)
