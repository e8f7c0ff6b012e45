"""The contract checks detect violations: one planted fault per rule."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from numpy.testing import assert_allclose

import opfmodel as om
import solvers
from opfmodel.devices.generator import GeneratorDevice
from opfmodel.devices.storage import StorageDevice
from opfmodel.errors import ModelError
from opfmodel.formulations.base import Formulation, shunts
from opfmodel.formulations.copperplate import Copperplate
from opfmodel.formulations.dc import DC
from opfmodel.model import Device
from opfmodel.network import Component, at_bus, in_service, number
from opfmodel.objectives.base import Objective
from opfmodel.objectives.economic import Economic
from opfmodel.plan import End
from opfmodel.plan.request import Request
from opfmodel.profiles.base import ProfileRule
from opfmodel.simulation import Step
from opfmodel.testing import (
    ContractError,
    check_back_end,
    check_device,
    check_formulation,
    check_objective,
    check_plant,
    check_profile,
)
from opfmodel.testing.grids import feeder
from opfmodel.testing.sampling import at_random
from solvers import Kind, ProgramBuilder, Solution, SolutionStatus, largest, total
from solvers.backends.osqp import OSQP
from solvers.backends.qp import QP

# Objectives -------------------------------------------------------------------------------------


class Sound(Objective):
    """Power of the generators."""

    needs = ("pg",)

    def stage_cost(self, stage) -> Any:
        return total(largest(stage.generator.pg, 0.1) ** 2)


def objective(**changes) -> Objective:
    return type("Planted", (Sound,), {"__doc__": "Planted.", **changes})()


def undocumented_option() -> Objective:
    class Planted(Sound):
        """Planted."""

        def __init__(self, weight: float = 1.0) -> None:
            self.weight = weight

    return Planted()


def unannotated_option() -> Objective:
    class Planted(Sound):
        """Planted.

        Parameters
        ----------
        weight
            A weight.
        """

        def __init__(self, weight=1.0) -> None:
            self.weight = weight

    return Planted()


def odd_option() -> Objective:
    class Planted(Sound):
        """Planted.

        Parameters
        ----------
        weight
            A weight.
        """

        def __init__(self, weight: np.random.Generator | None = None) -> None:
            self.weight = weight

    return Planted()


def shifty(self, stage) -> Any:
    """Return a different cost on numbers than on symbols."""
    cost = total(stage.generator.pg**2)
    return cost * 1.001 if isinstance(cost, np.ndarray) else cost


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: objective(__doc__=None), "docstring"),
        (undocumented_option, "documents its options under Parameters': weight"),
        (unannotated_option, "annotates its options .*': weight"),
        (odd_option, "options that a file can express"),
        (lambda: objective(needs="pg"), "needs is a tuple of names"),
        (lambda: objective(needs=("pg", "unheard")), "some formulation publishes': pg, unheard"),
        (lambda: objective(needs=()), r"generator.pg is not in needs = \(\)"),
        (
            lambda: objective(stage_cost=lambda self, s: total(s.generator.pg * s.generator.qg)),
            "generator.qg is not in needs",
        ),
        (lambda: objective(stage_cost=lambda self, s: total(s.generator.pg - 5.0) ** 2), "compiles"),
        (lambda: objective(stage_cost=lambda self, s: s.generator.pg**2), "has one value per stage"),
        (lambda: objective(stage_cost=lambda self, s: 0.0 * total(s.generator.pg) - total(s.generator.pg**2)), "is convex"),
        (lambda: objective(stage_cost=shifty), "the same cost numerically and in the program"),
        (
            lambda: objective(stage_cost=lambda self, s: total(s.generator.pg) + 1e999),
            "its cost is finite|compiles",
        ),
    ],
)  # fmt: skip
def test_an_objective_that_breaks_a_rule_is_caught(make, message: str) -> None:
    with pytest.raises(ContractError, match=message) as caught:
        check_objective(make())
    assert "breaks the rule '" in str(caught.value)


def test_sound_objectives_pass() -> None:
    check_objective(Sound())
    check_objective(Economic(0.1, 0.2) + 3.0 * Sound())
    odd = objective(convex=False, stage_cost=lambda self, s: total(s.generator.pg - s.generator.pg**2))
    check_objective(odd)


# Formulations -----------------------------------------------------------------------------------


class Modest(DC):
    """Planted."""

    publishes = ("va",)


class Boastful(DC):
    """Planted."""

    publishes = ("va", "pf", "pt", "vm")


class Leaky(DC):
    """Planted: injects power that no device produces."""

    def declare(self, model) -> None:
        super().declare(model)
        model.inject(np.array([0]), p=model.build.expression(np.full((1, model.stages), 0.01)))


class Unlimited(DC):
    """Planted: forgets ratings."""

    def declare(self, model) -> None:
        model.network.branch.arrays["rating"] = np.full(len(model.network.branch), np.inf)
        super().declare(model)


class Unshunted(Copperplate):
    """Planted: forgets shunts."""

    def declare(self, model) -> None:
        return


class Brittle(DC):
    """Planted: needs a branch."""

    def declare(self, model) -> None:
        model.network.branch.from_bus[0]
        super().declare(model)


class Rude(DC):
    """Planted: rejects a ring without naming it."""

    def declare(self, model) -> None:
        if "tie" in model.network.branch.names:
            raise ModelError("no loops please")
        super().declare(model)


class Nameless(Formulation):
    """Planted."""


class Mispriced(Copperplate):
    """Planted: prices are ten times too low."""

    def declare(self, model) -> None:
        shunts(model, 1.0)
        price = model.prices["lmp"]
        model.prices["lmp"] = replace(price, read=lambda *at: 0.1 * price.read(*at))


@pytest.mark.parametrize(
    ("formulation", "message"),
    [
        (Nameless, "states name, a str': None"),
        (Modest, "states what it publishes': pf, pt"),
        (Boastful, "publishes what it states': vm"),
        (Leaky, "limits and balances of a feeder': active balance"),
        (Unlimited, "limits and balances of a feeder': branch rating"),
        (Unshunted, "limits and balances of a feeder': active balance"),
        (Brittle, "can be declared on any grid': IndexError"),
        (Rude, "names the grid"),
        (Mispriced, r"the price of a bus .*': at \w+, .* \$/MWh"),
    ],
)
def test_a_formulation_that_breaks_a_rule_is_caught(formulation: type[Formulation], message: str) -> None:
    with pytest.raises(ContractError, match=message):
        check_formulation(formulation())


# Devices ----------------------------------------------------------------------------------------

UNIT = om.Generator("x", p=(0, 30), q=(-5, 5), cost=om.Polynomial(0.01, 20, 1))
CELL = om.Storage("x", energy=10, power=2, charge_efficiency=0.9)


@dataclass(frozen=True)
class Furnace(Component):
    """A demand that can be reduced."""

    kind: ClassVar[str] = "furnace"
    plural: ClassVar[str] = "furnaces"

    bus: str = at_bus()
    power: float = number("MW", description="Power.")
    in_service: bool = in_service()


@dataclass
class Ladle(Component):
    """Planted: can be modified after validation."""

    kind: ClassVar[str] = "ladle"
    plural: ClassVar[str] = "ladles"


class FurnaceDevice(Device):
    """Demand that can be reduced."""

    component = Furnace

    def declare(self, model, table) -> None:
        heat = model.variable("furnace", "heat", 0.0, "power", unit="MW")
        model.inject(table.bus, p=-heat)

    def cost(self, stage) -> Any:
        return total((stage.furnace.power - stage.furnace.heat) ** 2)


def furnace(**changes) -> Device:
    return type("Planted", (FurnaceDevice,), {"__doc__": "Planted.", **changes})()


def idle(self, model, table) -> None:
    model.variable("furnace", "heat", 0.0, "power", unit="MW")


def moody(self, model, table) -> None:
    FurnaceDevice.declare(self, model, table)
    if "vm" in model.published:
        model.variable("furnace", "mood", 0.0, 1.0, unit="")


def bent(self, model, table) -> None:
    FurnaceDevice.declare(self, model, table)
    heat = model.furnace.heat
    model.rows("furnace", "bent", heat**2, 0.001, np.inf)


def grumpy(self, model, table) -> None:
    table.power[0]
    FurnaceDevice.declare(self, model, table)


@pytest.mark.parametrize(
    ("device", "message"),
    [
        (furnace(__doc__=None), "docstring"),
        (furnace(component=int), "its component is a dataclass and a Component"),
        (furnace(component=Ladle), "its component is frozen': Ladle"),
        (furnace(component=om.Load), "the example is an instance of its component"),
        (furnace(declare=idle), "injects power where it has a bus"),
        (furnace(declare=moody), "declares the same quantities under every formulation"),
        (furnace(declare=bent), "is convex .*': bent .* nonlinear program"),
        (furnace(declare=grumpy), "without components over 2 stages of 1 h under ac': IndexError"),
        (furnace(cost=lambda self, s: -total(s.furnace.heat**2)), "is convex .*': cost .* nonlinear program"),
        (furnace(cost=lambda self, s: total(s.furnace.haet)), "ModelError|QuantityError"),
        (furnace(cost=lambda self, s: 1e999 * total(s.furnace.heat)), "can be solved with a linear network|finite"),
        (furnace(cost=lambda self, s: _shifty_cost(s)), "the same cost numerically and in the program"),
    ],
)  # fmt: skip
def test_a_device_that_breaks_a_rule_is_caught(device: Device, message: str) -> None:
    with pytest.raises(ContractError, match=message):
        check_device(device, Furnace("x", power=5))


def _shifty_cost(stage) -> Any:
    cost = total(stage.furnace.heat)
    return 2.0 * cost if isinstance(cost, np.ndarray) else cost


class Forgetful(StorageDevice):
    """Planted: its energy falls at half the power that it delivers."""

    def declare(self, model, table) -> None:
        model.step *= 0.5
        super().declare(model, table)
        model.step /= 0.5


def test_a_device_with_inconsistent_states_is_caught() -> None:
    with pytest.raises(ContractError, match="limits and balances': storage dynamics"):
        check_device(Forgetful(), CELL)


def test_sound_devices_pass() -> None:
    check_device(GeneratorDevice(), UNIT)
    check_device(FurnaceDevice(), Furnace("x", power=5))


# Profile rules ----------------------------------------------------------------------------------


class Rule(ProfileRule):
    """Planted."""

    def __init__(self) -> None:
        self.calls = 0

    def apply(self, book) -> None:
        self.calls += 1
        self.make(book)

    def make(self, book) -> None:
        book.set("town", "p", 2.0 * book.get("town", "p"))


def short(self, book) -> None:
    book.set("town", "p", np.ones(book.steps + 1))


def endless(self, book) -> None:
    book.set("town", "p", np.full(book.steps, np.nan))


def elsewhere(self, book) -> None:
    book.set("twon", "p", np.ones(book.steps))


def fieldless(self, book) -> None:
    book.set("town", "colour", np.ones(book.steps))


def fickle(self, book) -> None:
    book.set("town", "p", np.full(book.steps, self.calls))


def greedy(self, book) -> None:
    series = book.get("town", "p")
    series *= 2.0
    book.set("town", "p", series)


def builder(self, book) -> None:
    book.network.update("town", p=float(self.calls))
    book.set("town", "p", np.ones(book.steps))


def crude(self, book) -> None:
    book.set("town", "p", np.full(book.steps, {"town": 3.0}["town" if "town" in book.network else "none"]))


def blind(self, book) -> None:
    if "town" not in book.network:
        book.set("town", "p", np.ones(book.steps))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (short, r"writes one value per step': town.p has shape \(2,\)"),
        (endless, "writes finite values': town.p"),
        (elsewhere, "writes series of fields .*': ProfileError: profile 'twon.p'"),
        (fieldless, "writes series of fields .*': .*'town.colour'"),
        (fickle, "writes the same series"),
        (greedy, "replaces arrays of other rules"),
        (builder, "does not modify the network"),
        (crude, "an OpfmodelError .*': KeyError"),
        (blind, "no series of unknown components': town.p"),
    ],
)
def test_a_profile_rule_that_breaks_a_rule_is_caught(make, message: str) -> None:
    with pytest.raises(ContractError, match=message):
        check_profile(type("Planted", (Rule,), {"__doc__": "Planted.", "make": make})())


def test_a_sound_rule_passes() -> None:
    check_profile(Rule(), feeder())


# Plants -----------------------------------------------------------------------------------------


class Steady(om.NominalPlant):
    """The nominal plant."""


def meddled(change, base: type[om.Plant] = om.NominalPlant) -> om.Plant:
    """Return a plant that changes its steps before returning them."""

    def apply(self, plan):
        return change(base.apply(self, plan))

    return type("Planted", (base,), {"__doc__": base.__doc__, "apply": apply})()


def moody(step: Step) -> Step:
    return replace(step, values={k: v * (1 + 1e-3 * next(MOODS)) for k, v in step.values.items()})


MOODS = itertools.count()


def drained(step: Step) -> Step:
    return replace(step, state={**step.state, "e": 0.9 * step.state["e"]})


def scribbling(self, plan) -> Step:
    plan.solution.x[:] *= 1.001
    return om.NominalPlant.apply(self, plan)


def forgetful(step: Step) -> Step:
    return replace(step, values={k: v for k, v in step.values.items() if k != ("generator", "qg")})


@pytest.mark.parametrize(
    ("plant", "message"),
    [
        (om.NominalPlant, "is a Plant"),
        (type("Mute", (Steady,), {"__doc__": ""})(), "docstring"),
        (type("Lazy", (om.Plant,), {"__doc__": "Lazy."})(), "responds to every plan': NotImplementedError"),
        (meddled(lambda step: None), "responds to every plan"),
        (meddled(lambda step: replace(step, described={})), "describes reported quantities, with units"),
        (
            meddled(lambda s: replace(s, values={k: np.append(v, 0.0) for k, v in s.values.items()})),
            "reports one value per component|responds to every plan",
        ),
        (
            meddled(lambda s: replace(s, values={k: np.full_like(v, np.nan) for k, v in s.values.items()})),
            "reports no NaN in solved steps|responds to every plan",
        ),
        (meddled(lambda step: replace(step, state={})), "returns every state of the plan"),
        (meddled(drained), "physical equations': energy continuity"),
        (meddled(moody), "returns the same values in another run"),
        (type("Scribbling", (Steady,), {"__doc__": "Scribbling.", "apply": scribbling})(), "does not modify plans"),
        (meddled(forgetful, om.PowerFlow), "reports results that can be checked|physical equations"),
        (
            type("Bold", (Steady,), {"__doc__": "Bold.", "needs_perfect_forecast": False})(),
            "physical equations': active balance",
        ),
    ],
)  # fmt: skip
def test_a_plant_that_breaks_a_rule_is_caught(plant, message: str) -> None:
    with pytest.raises(ContractError, match=message):
        check_plant(plant)


# Random points ----------------------------------------------------------------------------------


def test_maxima_at_random_points_are_identified_by_type_not_by_name() -> None:
    build = ProgramBuilder()
    load = build.variable("largest_load", 3, 2, 1.0, 2.0)
    build.minimize(largest(1.5, load))
    program = build.build()
    solved = SimpleNamespace(
        solution=solvers.solve(program), problem=SimpleNamespace(model=None), stage=SimpleNamespace(network=None),
        request=Request(0, None, End(), None, om.Horizon.chain(1)),
    )  # fmt: skip
    solution = at_random(solved, np.random.default_rng(1)).solution
    value = solution.value("largest_load")
    assert ((value >= 1.0) & (value <= 2.0)).all()
    assert_allclose(solution.value(program.epigraphs[0].variables.name), np.maximum(1.5, value))
    assert solution.objective == pytest.approx(np.maximum(1.5, value).sum())


# Back ends --------------------------------------------------------------------------------------


class Meddling(QP):
    """A back end that changes its solutions before returning them."""

    def __init__(self, change) -> None:
        self.change = change

    def prepare(self, program, solver, options, verbose):
        session, change = super().prepare(program, solver, options, verbose), self.change

        class Meddled:
            def solve(self, instance, start=None) -> Solution:
                return change(session.solve(instance, start))

        return Meddled()


def claimed(solution: Solution) -> Solution:
    return replace(solution, status=SolutionStatus.GLOBALLY_OPTIMAL)


def complaining(solution: Solution) -> Solution:
    if not solution.status.is_optimal:
        raise RuntimeError("infeasible")
    return solution


def stale(solution: Solution) -> Solution:
    return replace(solution, instance=solution.program.default)


@pytest.mark.parametrize(
    ("end", "message"),
    [
        (Meddling(lambda s: replace(s, lam_g=-s.lam_g)), "returns the multipliers of rows of 'dispatch'"),
        (
            Meddling(lambda s: replace(s, lam_x=-s.lam_x)),
            "returns the multipliers of bounds of 'bounds only'",
        ),
        (Meddling(lambda s: replace(s, x=s.x + 0.1)), "finds the optimum of 'bounds only'"),
        (Meddling(lambda s: replace(s, solver="magic")), "which solver it called"),
        (Meddling(claimed), "reports infeasibility as a status"),
        (Meddling(complaining), "reports infeasibility as a status': RuntimeError: infeasible"),
        (Meddling(stale), "returns the instance that it solved|solves the next instance"),
        (type("Nameless", (QP,), {"name": ""})(), "has a name"),
        (type("Bare", (QP,), {"solvers": lambda self: iter(())})(), "names its installed solvers"),
        (type("Bold", (OSQP,), {"accepts": Kind.CONIC})(), "breaks the rule .*'disc'"),
    ],
)
def test_a_back_end_that_breaks_a_rule_is_caught(end, message: str) -> None:
    with pytest.raises(ContractError, match=message):
        check_back_end(end)
