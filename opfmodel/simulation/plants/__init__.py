"""Plants: the response of the grid to a plan, one file each. ``docs/plants.md`` has the equations."""

from opfmodel.simulation.plants.base import Plant, Step

__all__ = ["Plant", "Step"]
