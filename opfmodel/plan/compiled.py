"""Compilation: the declarations of a problem become one program, ready to be solved."""

from __future__ import annotations

import logging
import time as clock
from typing import TYPE_CHECKING, NamedTuple

from opfmodel.errors import IncompatibleError, ModelError, QuantityError, shown
from opfmodel.horizon import Horizon
from opfmodel.model import CustomConstraint, Model
from opfmodel.network.clock import clocked_fields
from opfmodel.network.governed import governed_fields, widest
from opfmodel.network.series import fields_with_series
from opfmodel.plan.outages import lost_fields, status_at
from opfmodel.plan.parts import absent_devices, publishing
from opfmodel.plan.result import penalty_outputs
from opfmodel.plan.security import outage_fields
from opfmodel.plan.shortage import SHORTAGE, limit_shortage
from opfmodel.plan.shrinking import Shrinking
from solvers import Expression, Program, Session, SolverError, Sum, prepare
from solvers.interrupt import interruptible

if TYPE_CHECKING:
    from opfmodel.plan.multistage import MultiStage

__all__ = ["Compiled", "compiled", "declared", "explained"]

_log = logging.getLogger(__name__)


class Compiled(NamedTuple):
    """A compiled problem.

    Attributes
    ----------
    model
        The declarations.
    program, session
        The program, and the solver that is prepared for it.
    shrinking
        How stages before a plan that ends with the data are left out; None unless plans shrink.
    seconds
        What it took.
    """

    model: Model
    program: Program
    session: Session
    shrinking: Shrinking | None
    seconds: float


@interruptible()
def compiled(problem: MultiStage) -> Compiled:
    """Compile a problem.

    Raises
    ------
    IncompatibleError
        The objective or a constraint needs a quantity that the formulation does not publish.
    ModelError
        The objective or a constraint is invalid.
    """
    began = clock.perf_counter()
    model = declared(problem, problem.horizon)
    _check_needs(problem, model)
    _minimize(problem, model)
    for constraint in problem.constraints.values():
        _constrain(problem, model, constraint)
    for name, published in {**model.published, **model.reported}.items():
        model.build.output(name, published.values)
    for name, cost in zip(penalty_outputs(model), model.penalties, strict=True):
        model.build.output(name, cost)
    if problem.rationed:
        limit_shortage(model)
    program = model.build.build()
    shrinking = None
    if problem.at_end == "shrink" and problem.stages > 1:
        stocks = [name for name, state in model.states.items() if state.role == "stock"]
        shrinking = Shrinking(program, problem.stages, stocks, [*model.whole, SHORTAGE])
    session = prepare(program, problem.solver, problem.options, problem.verbose)
    seconds = clock.perf_counter() - began
    _log.info(
        "%r compiled: %d variables, %d rows, %.3f s", problem, program.n_variables, program.n_rows, seconds
    )
    return Compiled(model, program, session, shrinking, seconds)


def declared(problem: MultiStage, horizon: Horizon) -> Model:
    """Return the declarations of formulation and devices, without objective and constraints; uncached.

    A kind without components in service publishes its quantities, all empty, if the objective needs one.
    """
    own = {key: values[:, :1] for key, values in problem.series_of(problem.objective).items()}
    lost = lost_fields(problem.arrays, horizon, problem.outages)
    at_nodes = status_at(problem.arrays, horizon)
    status = {(kind, field): at_nodes[kind] for kind, field in lost if field == "status"}
    model = Model(
        problem.arrays.with_series({**widest(problem.profiles, problem.arrays), **own, **status}),
        horizon,
        delay=problem.generator_delay,
        reactive=problem.formulation.reactive,
        zones=problem.formulation.zones(problem.arrays),
        series={
            *fields_with_series(problem.profiles, problem.arrays),
            *clocked_fields(problem.arrays),
            *governed_fields(problem.profiles, problem.arrays),
            *own,
            *outage_fields(problem.security, horizon),
            *lost,
        },
        elastic=problem.elastic,
        split_shedding=problem.split_shedding,
        regularisation=problem.regularisation,
        shrinks=problem.at_end == "shrink",
        outages=problem.outages,
    )
    problem.formulation.declare(model)
    model.costed.append(problem.formulation)
    _check_switched(problem, model)
    for device in problem.devices:
        model.connect(device)
    if not all(map(model.has, problem.objective.needs)):
        for device in absent_devices(problem.arrays):
            model.connect(device)
    if problem.security is not None:
        model.price_security()
        problem.security.hold(model)
    return model


def _check_switched(problem: MultiStage, model: Model) -> None:
    """Raise an error if branches go out of service and the formulation has not asked which."""
    asked = "status" in vars(model)
    if ("branch", "status") in model.series and not asked and model.has("pf"):
        raise IncompatibleError(
            f"formulation {problem.formulation.name!r} does not take branches out of service: what they "
            "carry must be multiplied by model.switched"
        )


def _check_needs(problem: MultiStage, model: Model) -> None:
    missing = [name for name in problem.objective.needs if not model.has(name)]
    if missing:
        able = publishing(missing, problem.arrays, problem.devices)
        raise IncompatibleError(
            f"objective {type(problem.objective).__name__} needs {', '.join(missing)}, which formulation "
            f"{problem.formulation.name!r} with the devices of {problem.network.name!r} does not publish"
            + (f"; formulations that do: {', '.join(able)}" if able else "")
        )


def explained(problem: MultiStage, error: QuantityError) -> ModelError:
    """Return the error of a constraint that uses an unpublished quantity.

    An :class:`IncompatibleError` if other formulations publish it, else the given error.
    """
    able = publishing([error.quantity], problem.arrays, problem.devices)
    if not able or problem.formulation.name in able:
        return error
    return IncompatibleError(
        f"formulation {problem.formulation.name!r} does not publish {error.kind}.{error.quantity}; "
        f"formulations that do: {', '.join(able)}"
    )


def _minimize(problem: MultiStage, model: Model) -> None:
    share = 1.0 if problem.risk is None else 1.0 - problem.risk.weight
    weights = {"stage": model.weight, "terminal": model.probability_of(model.horizon.leaves)}
    parts = []
    for part, weight in weights.items():
        what = f"{part}_cost"
        cost = getattr(problem.objective, what)(model.stage)
        if isinstance(cost, Expression | Sum):
            model.build.minimize(cost * (share * weight))
            parts.append((part, cost))
        elif cost is not None:
            raise ModelError(
                f"objective {type(problem.objective).__name__}: {what} = {shown(cost)}: "
                "must be a quantity or total of the stage, or None"
            )
    if problem.risk is not None and problem.risk.weight:
        problem.risk.minimise(model, parts)


def _constrain(problem: MultiStage, model: Model, constraint: CustomConstraint) -> None:
    try:
        constraint.declare(model)
    except QuantityError as error:
        raise _of_constraint(constraint.name, explained(problem, error)) from error
    except (ModelError, SolverError) as error:
        raise _of_constraint(constraint.name, error) from error


def _of_constraint(name: str, error: Exception) -> ModelError:
    """Return an error with the name of its constraint in front."""
    kind = IncompatibleError if isinstance(error, IncompatibleError) else ModelError
    return kind(f"constraint {name!r}: {error}")
