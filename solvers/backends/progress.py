"""Recognising an attempt of an interior-point method that goes nowhere."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from solvers.assembly import Assembly
from solvers.program import Array, Instance

__all__ = ["EVERY", "Progress", "Verdict"]

EVERY = 25  # iterations between two looks: each costs a Jacobian and a call of Python
_NEARLY = 1e-4  # infeasibility from which on an attempt is not given up
_STEEP = 100.0  # slope from which on rows are scaled down: nlp_scaling_max_gradient
_PATIENCE = 6  # looks without a new minimum of the infeasibility, by a factor of two


class Verdict:
    """Whether an attempt goes nowhere, from what is seen of it at regular intervals.

    It does if it crawls, that is if between looks, twice in a row, the infeasibility falls by less than half
    while the residual of the dual grows; or if the infeasibility has no new minimum for long. Of 108 cases of
    PGLib this holds for the three that take more than 250 iterations, and for none of the others.
    """

    def __init__(self) -> None:
        self._primal: list[float] = []
        self._dual: list[float] = []

    def lost(self, primal: float, dual: float) -> bool:
        """Return the verdict after another look.

        Parameters
        ----------
        primal, dual
            Largest violation of a row, and of the stationarity of the Lagrangian.
        """
        self._primal.append(primal)
        self._dual.append(dual)
        if primal < _NEARLY:
            return False
        return self._crawls() or self._stands()

    def _crawls(self) -> bool:
        p, d = self._primal[-3:], self._dual[-3:]
        return len(p) == 3 and all(p[k + 1] > 0.5 * p[k] and d[k + 1] > d[k] for k in range(2))

    def _stands(self) -> bool:
        before, late = self._primal[:-_PATIENCE], self._primal[-_PATIENCE:]
        return bool(before) and min(late) > 0.5 * min(before)


class Progress(ca.Callback):
    """Iteration callback that stops an attempt which goes nowhere."""

    def __init__(self, assembly: Assembly) -> None:
        ca.Callback.__init__(self)
        self._assembly = assembly
        self._sizes = {
            "x": assembly.program.n_variables,
            "lam_x": assembly.program.n_variables,
            "g": assembly.program.n_rows,
            "lam_g": assembly.program.n_rows,
            "f": 1,
        }
        self._at = assembly.program.default
        self._verdict = Verdict()
        self._first: Sequence[Any] | None = None
        self._weights: Array | None = None
        self.lost = False
        self.construct("progress", {})

    @property
    def options(self) -> dict[str, Any]:
        """Options of ``nlpsol`` that install it."""
        return {"iteration_callback": self, "iteration_callback_step": EVERY}

    def begin(self, instance: Instance) -> None:
        """Watch a solve of an instance."""
        self._at, self._verdict, self.lost = instance, Verdict(), False
        self._first = self._weights = None

    def get_n_in(self) -> int:
        """Number of results of ``nlpsol``."""
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        """One: whether to stop."""
        return 1

    def get_sparsity_in(self, position: int) -> Any:
        """Shape of a result; multipliers of parameters are not computed."""
        return ca.Sparsity.dense(self._sizes.get(ca.nlpsol_out(position), 0), 1)

    def eval(self, arguments: Sequence[Any]) -> list[Any]:
        """Look at an iterate, and return 1 to stop; at the first one not before there is a second."""
        if self._first is None:
            self._first = arguments
            return [0]
        if self._weights is None:
            self._verdict.lost(*self._residuals(self._first))
        self.lost = self._verdict.lost(*self._residuals(arguments))
        return [int(self.lost)]

    def _residuals(self, arguments: Sequence[Any]) -> tuple[float, float]:
        """Infeasibility, and residual of the dual, of an iterate."""
        at = dict(zip(map(ca.nlpsol_out, range(len(arguments))), arguments, strict=True))
        g, p = _vector(at["g"]), self._at.parameters
        jacobian = self._assembly.jacobian(at["x"], p)[1]
        if self._weights is None:
            self._weights = _weights(jacobian)
        outside = np.maximum(self._at.row_lower - g, g - self._at.row_upper)
        slope = self._assembly.gradient(at["x"], p)[1] + at["lam_x"] + ca.mtimes(jacobian.T, at["lam_g"])
        primal = float((self._weights * outside).max(initial=0.0))
        return primal, float(np.abs(_vector(slope)).max(initial=0.0))


def _weights(jacobian: Any) -> Array:
    """Weights of rows as in IPOPT's scaling: steep rows at the start count less."""
    steepest = np.full(jacobian.shape[0], _STEEP)
    np.maximum.at(steepest, np.array(jacobian.sparsity().row(), dtype=np.intp), np.abs(jacobian.nonzeros()))
    return np.asarray(_STEEP / steepest)


def _vector(value: Any) -> Array:
    return np.asarray(value, dtype=float).ravel()
