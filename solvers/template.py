"""Templates: small symbolic functions that a program places many times."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from solvers.errors import ProgramError

__all__ = ["Degree", "Template", "column", "nonzeros"]


class Degree(IntEnum):
    """Degree of a function in its variables, derived from its derivatives."""

    CONSTANT = 0
    LINEAR = 1
    QUADRATIC = 2
    NONLINEAR = 3


class Template:
    """A vector function of a few local variables and a few local parameters.

    Values and first and second derivatives are derived here once, on a few symbols, and then
    mapped over all places where the template is used.

    Parameters
    ----------
    name
        What the template computes; used in error messages.
    variables, parameters
        Column vectors of CasADi ``SX`` symbols on which the outputs depend.
    outputs
        Column vector of ``SX`` expressions in those symbols.

    Raises
    ------
    ProgramError
        The outputs use a symbol that is neither a variable nor a parameter.
    """

    def __init__(self, name: str, variables: Any, parameters: Any, outputs: Any) -> None:
        self.name = name
        self.variables = ca.SX(variables)
        self.parameters = ca.SX(parameters)
        self.outputs = ca.densify(ca.SX(outputs))
        symbols: list[Any] = [*self.variables.elements(), *self.parameters.elements()]
        known = {s.element_hash() for s in symbols}
        stray = [str(s) for s in ca.symvar(self.outputs) if s.element_hash() not in known]
        if stray:
            raise ProgramError(
                f"template {name!r}: unknown symbols {', '.join(stray)}; "
                "outputs may use its variables and parameters only"
            )

    def __reduce__(self) -> tuple[Any, tuple[str, str]]:
        """Templates travel to other processes as CasADi functions; symbols cannot."""
        return _received, (self.name, self.serialized)

    @property
    def serialized(self) -> str:
        """The outputs as text, which does not depend on the name."""
        whole = ca.Function("template", [self.variables, self.parameters], [self.outputs])
        return str(whole.serialize())

    def __repr__(self) -> str:
        shape = f"{self.n_variables} variables, {self.n_parameters} parameters"
        return f"Template({self.name!r}: {shape} -> {self.n_outputs} outputs)"

    @property
    def n_variables(self) -> int:
        """Number of local variables."""
        return int(self.variables.numel())

    @property
    def n_parameters(self) -> int:
        """Number of local parameters."""
        return int(self.parameters.numel())

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return int(self.outputs.numel())

    @cached_property
    def is_identity(self) -> bool:
        """Whether the outputs are the variables themselves."""
        return self.n_outputs == self.n_variables and bool(ca.is_equal(self.outputs, self.variables))

    @cached_property
    def value(self) -> Any:
        """CasADi function ``(variables, parameters) -> outputs``."""
        return ca.Function(f"{_slug(self.name)}_value", [self.variables, self.parameters], [self.outputs])

    @cached_property
    def _jacobian(self) -> Any:
        return ca.jacobian(self.outputs, self.variables)

    @cached_property
    def jacobian_pattern(self) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """Output and variable index of each structural nonzero of the Jacobian."""
        rows, columns = self._jacobian.sparsity().get_triplet()
        return np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp)

    @cached_property
    def jacobian(self) -> Any:
        """CasADi function ``(variables, parameters) -> nonzeros of the Jacobian``."""
        return ca.Function(
            f"{_slug(self.name)}_jacobian", [self.variables, self.parameters], [nonzeros(self._jacobian)]
        )

    @cached_property
    def _weights(self) -> Any:
        return ca.SX.sym("weight", self.n_outputs)

    @cached_property
    def _hessian(self) -> Any:
        curved = [i for i, degree in enumerate(self.degrees) if degree >= Degree.QUADRATIC]
        lagrangian = ca.SX(0)
        for i in curved:
            lagrangian += self._weights[i] * self.outputs[i]
        hessian, _ = ca.hessian(lagrangian, self.variables)
        return ca.tril(hessian)

    @cached_property
    def hessian_pattern(self) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """Row and column (row >= column) of each nonzero of the weighted Hessian's lower triangle."""
        rows, columns = self._hessian.sparsity().get_triplet()
        return np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp)

    @cached_property
    def hessian_parameters(self) -> npt.NDArray[np.intp]:
        """Local parameters that the weighted Hessian depends on."""
        used = ca.which_depends(ca.vec(self._hessian), self.parameters, 1, False) if self.n_parameters else []
        return np.flatnonzero(used)

    @cached_property
    def hessian(self) -> Any:
        """CasADi function ``(variables, parameters, weights) -> nonzeros of sum_i w_i hess(output_i)``."""
        return ca.Function(
            f"{_slug(self.name)}_hessian",
            [self.variables, self.parameters, self._weights],
            [nonzeros(self._hessian)],
        )

    @cached_property
    def degrees(self) -> tuple[Degree, ...]:
        """Degree of each output in the local variables."""
        return tuple(_degree(self._jacobian[i, :], self.variables) for i in range(self.n_outputs))

    @cached_property
    def degree(self) -> Degree:
        """Largest degree among the outputs."""
        return max(self.degrees, default=Degree.CONSTANT)


def _received(name: str, serialized: str) -> Template:
    """Return a template with new symbols."""
    whole = ca.Function.deserialize(serialized)
    variables, parameters = (ca.SX.sym(key, whole.numel_in(i)) for i, key in enumerate(("v", "p")))
    return Template(name, variables, parameters, whole(variables, parameters))


def column(parts: Sequence[Any]) -> Any:
    """Stack scalar ``SX`` expressions; a single one, as most often, needs no conversion."""
    return parts[0] if len(parts) == 1 else ca.vertcat(*parts)


def nonzeros(expression: Any) -> Any:
    """Return the structural nonzeros of an ``SX`` matrix as a dense column."""
    return ca.vec(expression.nz[:])


def _degree(gradient: Any, variables: Any) -> Degree:
    """Degree of a scalar function, given the row of its first derivatives."""
    if gradient.nnz() == 0:
        return Degree.CONSTANT
    if not ca.depends_on(gradient, variables):
        return Degree.LINEAR
    second = ca.jacobian(gradient.T, variables)
    return Degree.NONLINEAR if ca.depends_on(second, variables) else Degree.QUADRATIC


def _slug(name: str) -> str:
    """Convert a name to one that CasADi accepts for a function."""
    slug = "".join(c if c.isalnum() else "_" for c in name).strip("_") or "template"
    while "__" in slug:
        slug = slug.replace("__", "_")
    return slug if slug[0].isalpha() else f"t_{slug}"
