"""Objectives: the cost that a plan minimises, one file each."""

from opfmodel.objectives.base import Objective, WeightedSum

__all__ = ["Objective", "WeightedSum"]
