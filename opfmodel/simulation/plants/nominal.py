"""The nominal plant."""

from __future__ import annotations

from opfmodel.plan import Plan
from opfmodel.simulation.plants.base import Plant, Step, with_following

__all__ = ["NominalPlant"]


class NominalPlant(Plant):
    """Follow the plan exactly."""

    needs_perfect_forecast = True
    takes_outages = True

    def apply(self, plan: Plan) -> Step:
        """Return the first stage of the plan as the outcome."""
        known = {**plan.quantities(), **plan.exceeded(), **plan.prices()}
        first = {key: value[:, 0] for key, value in known.items()}
        values = with_following(plan, first, plan.network.over(slice(1)))
        formulation = plan.problem.formulation.name
        return Step(values, plan.next_state(values), plan.problem.described, formulation)
