"""Shares: how several units divide what they cover together."""

from __future__ import annotations

import numpy as np

from opfmodel.network.arrays import Array, Index

__all__ = ["WIDE", "divide"]

WIDE = 1e3  # p.u.; replaces an infinite range


def divide(weights: Array, group: Index) -> Array:
    """Return weights normalised within each group, equal ones if their sum is zero."""
    sums = np.bincount(group, weights)[group]
    equal = 1.0 / np.bincount(group)[group]
    return np.asarray(np.where(sums > 0, weights / np.where(sums > 0, sums, 1.0), equal))
