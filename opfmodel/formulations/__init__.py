"""Formulations: the physics of the network, one file each."""

from opfmodel.formulations.base import Formulation

__all__ = ["Formulation"]
