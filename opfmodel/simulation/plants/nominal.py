"""The nominal plant."""

from __future__ import annotations

from opfmodel.plan import Plan
from opfmodel.simulation.plants.base import Plant, Step

__all__ = ["NominalPlant"]


class NominalPlant(Plant):
    """Follow the plan exactly."""

    needs_perfect_forecast = True
    takes_outages = True

    def apply(self, plan: Plan) -> Step:
        """Return the first stage of the plan as the outcome."""
        known = {**plan.quantities(), **plan.exceeded(), **plan.prices()}
        values = {key: value[:, 0] for key, value in known.items()}
        formulation = plan.problem.formulation.name
        return Step(values, plan.next_state(), plan.problem.described, formulation)
