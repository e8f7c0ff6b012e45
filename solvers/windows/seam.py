"""The terms of a stage that contain variables of the stage before: what the end of a window is worth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solvers.folding import map_numbers
from solvers.program import Array, Index, Instance
from solvers.template import Template
from solvers.windows.staged import Staged
from solvers.windows.window import Window

__all__ = ["Seam"]


@dataclass(frozen=True, eq=False)
class _Term:
    """Places of a template; costs have no rows.

    Attributes
    ----------
    at
        Position among the variables of the seam of each local variable, -1 for those of the later stage.
    """

    template: Template
    variables: Index
    parameters: Array
    into: Index | None
    at: Index


@dataclass(frozen=True, eq=False)
class Seam:
    r"""The places of stage ``k + 1`` that contain variables of stage ``k``.

    The price of these variables is :math:`\partial_{x_k} (f_{k+1} + \lambda' g_{k+1})`.

    Attributes
    ----------
    variables
        Those of stage ``k`` that they contain, as positions in the whole program.
    """

    variables: Index
    terms: tuple[_Term, ...]

    @classmethod
    def after(cls, staged: Staged, stage: int, instance: Instance) -> Seam:
        """Return the seam after a stage, with positions in the whole program."""
        touched = staged.touched(stage)
        terms = []
        for kind in ("constraints", "costs"):
            for ordered in getattr(staged, kind):
                part = ordered.between(stage + 1, stage + 2)
                at = np.searchsorted(touched, part.variables).clip(max=max(touched.size - 1, 0))
                at = np.where(touched[at] == part.variables, at, -1) if touched.size else at * 0 - 1
                kept = (at >= 0).any(axis=0)
                if kept.any():
                    terms.append(
                        _Term(
                            part.template,
                            part.variables[:, kept],
                            instance.parameters[part.parameters[:, kept]],
                            part.into[:, kept] if kind == "constraints" else None,
                            at[:, kept],
                        )
                    )
        return cls(touched, tuple(terms))

    def inside(self, window: Window) -> Seam:
        """Return the seam with positions in a window."""
        terms = tuple(
            _Term(
                t.template,
                window.position(t.variables),
                t.parameters,
                None if t.into is None else np.where(t.into >= 0, np.searchsorted(window.rows, t.into), -1),
                t.at,
            )
            for t in self.terms
        )
        return Seam(self.variables, terms)

    def price(self, x: Array, lam_g: Array) -> Array:
        """Return the price of the variables at a point."""
        price = np.zeros(self.variables.size)
        for t in self.terms:
            outputs, local = t.template.jacobian_pattern
            slopes = map_numbers(t.template.jacobian, t.at.shape[1], x[t.variables], t.parameters)
            if t.into is not None:
                into = t.into[outputs]
                slopes = slopes * np.where(into >= 0, lam_g[into], 0.0)
            at = t.at[local]
            np.add.at(price, at[at >= 0], slopes[at >= 0])
        return price
