"""Arrays of values that share one formula, from which templates are made.

An :class:`Expression` of shape ``(items, stages)`` is one small symbolic formula together with
the positions from which its symbols are read. Arithmetic, slicing and NumPy functions act once on
the formula, whatever the size of the array, and a :class:`solvers.ProgramBuilder` turns the
result into a template placed ``items * stages`` times. The functions of this module also accept
NumPy arrays, so the same code states a cost to a solver and evaluates it numerically.
"""

from __future__ import annotations

import hashlib
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, overload

import casadi as ca
import numpy as np
import numpy.typing as npt

from solvers.errors import ProgramError
from solvers.program import Array, Index
from solvers.template import column

if TYPE_CHECKING:
    from solvers.builder import ProgramBuilder

__all__ = ["Constraint", "Expression", "Leaf", "Sum", "largest", "largest_by", "stacked", "total"]

LeafKind = Literal["variable", "parameter", "constant"]

_UFUNCS: dict[np.ufunc, Callable[..., Any]] = {
    np.add: lambda a, b: a + b,
    np.subtract: lambda a, b: a - b,
    np.multiply: lambda a, b: a * b,
    np.true_divide: lambda a, b: a / b,
    np.power: lambda a, b: a**b,
    np.float_power: lambda a, b: a**b,
    np.negative: lambda a: -a,
    np.positive: lambda a: a,
    np.reciprocal: lambda a: 1.0 / a,
    np.square: lambda a: a * a,
    np.sqrt: ca.sqrt,
    np.cbrt: lambda a: ca.sign(a) * ca.fabs(a) ** (1.0 / 3.0),
    np.hypot: ca.hypot,
    np.exp: ca.exp,
    np.exp2: lambda a: 2.0**a,
    np.expm1: ca.expm1,
    np.log: ca.log,
    np.log2: lambda a: ca.log(a) / np.log(2.0),
    np.log10: ca.log10,
    np.log1p: ca.log1p,
    np.deg2rad: lambda a: a * (np.pi / 180.0),
    np.radians: lambda a: a * (np.pi / 180.0),
    np.rad2deg: lambda a: a * (180.0 / np.pi),
    np.degrees: lambda a: a * (180.0 / np.pi),
    np.sin: ca.sin,
    np.cos: ca.cos,
    np.tan: ca.tan,
    np.arcsin: ca.asin,
    np.arccos: ca.acos,
    np.arctan: ca.atan,
    np.arctan2: ca.atan2,
    np.sinh: ca.sinh,
    np.cosh: ca.cosh,
    np.tanh: ca.tanh,
    np.arcsinh: ca.asinh,
    np.arccosh: ca.acosh,
    np.arctanh: ca.atanh,
}

_NOT_SMOOTH: dict[np.ufunc, str] = {
    np.absolute: "an absolute value is not smooth; write largest(x, -x)",
    np.fabs: "an absolute value is not smooth; write largest(x, -x)",
    np.maximum: "a maximum is not smooth; write largest(x, y)",
    np.fmax: "a maximum is not smooth; write largest(x, y)",
    np.minimum: "a minimum is not smooth; write -largest(-x, -y)",
    np.fmin: "a minimum is not smooth; write -largest(-x, -y)",
    np.sign: "a sign is not smooth; it cannot be used in a formula",
}

# NumPy passes array <= expression to __array_ufunc__ with the operands in this order: swap them
_TURNED: dict[np.ufunc, Callable[..., Any]] = {
    np.less_equal: lambda expression, array: expression >= array,
    np.greater_equal: lambda expression, array: expression <= array,
    np.less: lambda expression, array: expression > array,
    np.greater: lambda expression, array: expression < array,
    np.equal: lambda expression, array: expression == array,
}
_TURNED_SUMS = _TURNED | {
    np.add: lambda total, array: total + array,
    np.subtract: lambda total, array: -total + array,
    np.multiply: lambda total, array: total * array,
}


@dataclass(frozen=True, eq=False)
class Leaf:
    """A symbol of a formula and the source of its values.

    ``source`` broadcasts to the shape of the expression. It holds positions in the vector of
    variables or parameters or, for a constant, the values themselves.
    """

    kind: LeafKind
    symbol: Any
    source: Any


class _Symbolic:
    """Base of symbolic operands: comparisons give constraints, and NumPy functions raise."""

    __slots__ = ()
    __hash__ = None  # type: ignore[assignment]

    @abstractmethod
    def __sub__(self, other: Any) -> Any: ...

    def __le__(self, other: Any) -> Constraint:
        return Constraint(self - other, -np.inf, 0.0)

    def __ge__(self, other: Any) -> Constraint:
        return Constraint(self - other, 0.0, np.inf)

    def __eq__(self, other: object) -> Constraint:  # type: ignore[override]
        return Constraint(self - other, 0.0, 0.0)

    def __lt__(self, other: Any) -> Constraint:
        raise ProgramError(  # Python's max and min compare in this way
            "a quantity cannot be compared by < or >; write <= or >= in a constraint, largest(0, x) for "
            "max(0, x), and -largest(0, -x) for min(0, x)"
        )

    __gt__ = __lt__

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        raise _unavailable(function.__name__)


def _unavailable(name: str) -> ProgramError:
    known = ", ".join(sorted(ufunc.__name__ for ufunc in _UFUNCS))
    return ProgramError(
        f"numpy.{name} does not support expressions; use arithmetic, slicing, total, largest or: {known}"
    )


class Expression(_Symbolic):
    """An array of shape ``(items, stages)`` whose values share one formula.

    Created by :class:`solvers.ProgramBuilder`; supports arithmetic, NumPy functions and slicing.
    In combination with an expression, a numeric array of shape ``(items,)`` gives one value per
    item and one of shape ``(items, stages)`` one per entry.
    """

    __slots__ = ("builder", "formula", "leaves", "shape")

    def __init__(
        self, builder: ProgramBuilder, formula: Any, leaves: dict[str, Leaf], shape: tuple[int, int]
    ) -> None:
        self.builder = builder
        self.formula = formula
        self.leaves = leaves
        self.shape = shape

    def __repr__(self) -> str:
        return f"Expression(shape={self.shape})"

    @property
    def items(self) -> int:
        """Number of items."""
        return self.shape[0]

    @property
    def stages(self) -> int:
        """Number of stages."""
        return self.shape[1]

    @property
    def varies(self) -> bool:
        """Whether it depends on variables, and not on parameters and numbers alone."""
        return any(leaf.kind == "variable" for leaf in self.leaves.values())

    def __getitem__(self, key: Any) -> Expression:
        """Select items, or items and stages, as in a two-dimensional NumPy array.

        Raises
        ------
        ProgramError
            The key is not one of positions, slices and masks, or a position does not exist; or it is a
            slice of stages that have no order in time.
        """
        keys = key if isinstance(key, tuple) else (key, slice(None))
        if len(keys) != 2:
            raise ProgramError(f"{key!r}: must select items, or items and stages, not {len(keys)} axes")
        rows, columns = (np.atleast_1d(k) if not isinstance(k, slice) else k for k in keys)
        if isinstance(columns, slice) and columns != slice(None) and not self.builder.ordered:
            raise ProgramError(
                "a slice of stages has no meaning here: the stages are nodes of a tree, or have "
                "contingencies, and do not follow one another; select them by position"
            )
        old, new, leaves = [], [], {}
        try:
            shape = np.broadcast_to(np.empty(()), self.shape)[rows][:, columns].shape
        except IndexError:
            raise ProgramError(
                f"{key!r}: there are {self.items} items and {self.stages} stages; select them by "
                "positions from 0 on, a slice or a mask"
            ) from None
        for leaf in self.leaves.values():
            source: Any = leaf.source  # an axis along which it repeats stays as it is
            source = source[rows] if source.shape[0] > 1 else source
            source = source[:, columns] if source.shape[1] > 1 else source
            moved = _leaf(self.builder, leaf.kind, source)
            leaves[moved.symbol.name()] = moved
            old.append(leaf.symbol)
            new.append(moved.symbol)
        formula = self.formula
        if old:
            formula = ca.substitute(formula, column(old), column(new))
        return Expression(self.builder, formula, leaves, shape)

    def __iter__(self) -> Iterator[Expression]:
        """Iterate over the items."""
        return (self[item] for item in range(self.items))

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        if any(isinstance(i, Sum) for i in inputs):
            return NotImplemented  # left to Sum, which raises
        if ufunc in _TURNED and isinstance(inputs[1], Expression):
            return _TURNED[ufunc](inputs[1], inputs[0])
        if ufunc in _NOT_SMOOTH:
            raise ProgramError(_NOT_SMOOTH[ufunc])
        if method != "__call__" or ufunc not in _UFUNCS:
            raise _unavailable(ufunc.__name__ if method == "__call__" else f"{ufunc.__name__}.{method}")
        if kwargs:
            raise ProgramError(f"numpy.{ufunc.__name__} does not support {', '.join(kwargs)} for expressions")
        return self._combine(_UFUNCS[ufunc], *inputs)

    def _combine(self, operation: Callable[..., Any], *inputs: Any) -> Expression:
        operands = [self.builder.expression(i) for i in inputs]
        if any(operand.builder is not self.builder for operand in operands):
            raise ProgramError("cannot combine expressions of two different programs")
        try:
            shape = np.broadcast_shapes(*(o.shape for o in operands))
        except ValueError:
            shapes = " and ".join(str(o.shape) for o in operands)
            raise ProgramError(f"cannot broadcast expressions of shapes {shapes} (items, stages)") from None
        leaves: dict[str, Leaf] = {}
        for operand in operands:
            leaves.update(operand.leaves)
        formula = operation(*(o.formula for o in operands))
        return Expression(self.builder, formula, leaves, (shape[0], shape[1]))

    def __add__(self, other: Any) -> Any:
        return NotImplemented if isinstance(other, Sum) else self._combine(_UFUNCS[np.add], self, other)

    def __radd__(self, other: Any) -> Any:
        return self._combine(_UFUNCS[np.add], other, self)

    def __sub__(self, other: Any) -> Any:
        return NotImplemented if isinstance(other, Sum) else self._combine(_UFUNCS[np.subtract], self, other)

    def __rsub__(self, other: Any) -> Any:
        return self._combine(_UFUNCS[np.subtract], other, self)

    def __mul__(self, other: Any) -> Expression:
        return self._combine(_UFUNCS[np.multiply], self, other)

    def __rmul__(self, other: Any) -> Expression:
        return self._combine(_UFUNCS[np.multiply], other, self)

    def __truediv__(self, other: Any) -> Any:
        return self._combine(_UFUNCS[np.true_divide], self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return self._combine(_UFUNCS[np.true_divide], other, self)

    def __pow__(self, other: Any) -> Any:
        return self._combine(_UFUNCS[np.power], self, other)

    def __neg__(self) -> Any:
        return self._combine(_UFUNCS[np.negative], self)

    def __abs__(self) -> Any:
        raise ProgramError(_NOT_SMOOTH[np.absolute])

    def __pos__(self) -> Any:
        return self


class Sum(_Symbolic):
    """A sum of expressions over their items, with one value per stage. Created by :func:`total`.

    Sums can be added, subtracted, multiplied by numbers and compared. They cannot be arguments of
    a nonlinear function because a program sums only the outputs of templates.
    """

    __slots__ = ("terms",)

    def __init__(self, terms: tuple[Expression, ...]) -> None:
        self.terms = terms

    def __repr__(self) -> str:
        return f"Sum of {len(self.terms)} terms"

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        known = method == "__call__" and not kwargs and ufunc in _TURNED_SUMS
        if known and not isinstance(inputs[0], _Symbolic):
            return _TURNED_SUMS[ufunc](inputs[1], inputs[0])
        raise ProgramError(
            f"numpy.{ufunc.__name__} does not support sums; sums can be added, scaled and compared"
        )

    @property
    def stages(self) -> int:
        """Number of stages."""
        return max(term.stages for term in self.terms)

    @property
    def shape(self) -> tuple[int, int]:
        """``(1, stages)``."""
        return 1, self.stages

    def spread(self) -> tuple[Expression, ...]:
        """Return the terms, repeating those of a single stage in every stage."""
        return tuple(
            Expression(term.builder, term.formula, term.leaves, (term.items, self.stages))
            for term in self.terms
        )

    def _other(self, other: Any) -> tuple[Expression, ...]:
        if isinstance(other, Sum):
            return other.terms
        builder = self.terms[0].builder
        values = other
        if not isinstance(other, Expression):
            array = np.asarray(other, dtype=float)
            values = array.reshape(1, -1) if array.ndim < 2 else array
        expression = builder.expression(values)
        if expression.items != 1:
            raise ProgramError(
                f"a sum has one value per stage; it cannot be combined with {expression.items} items"
            )
        return (expression,)

    def __add__(self, other: Any) -> Sum:
        return Sum(self.terms + self._other(other))

    def __radd__(self, other: Any) -> Sum:
        return self.__add__(other)

    def __neg__(self) -> Sum:
        return Sum(tuple(-term for term in self.terms))

    def __sub__(self, other: Any) -> Sum:
        return Sum(self.terms + tuple(-term for term in self._other(other)))

    def __rsub__(self, other: Any) -> Sum:
        return (-self).__add__(other)

    def __mul__(self, other: Any) -> Sum:
        if isinstance(other, Expression) and other.items == 1 and not other.varies:
            return Sum(tuple(term * other for term in self.spread()))
        if isinstance(other, Sum | Expression):
            raise ProgramError("a sum can only be multiplied by numbers, or by one parameter per stage")
        factor = np.asarray(other, dtype=float)
        factor = factor.reshape(1, -1) if factor.ndim < 2 else factor
        return Sum(tuple(term * factor for term in self.terms))

    def __rmul__(self, other: Any) -> Sum:
        return self.__mul__(other)

    def __truediv__(self, other: Any) -> Sum:
        if isinstance(other, Sum | Expression):
            raise ProgramError("a sum can only be divided by numbers; multiply both sides instead")
        return self.__mul__(1.0 / np.asarray(other, dtype=float))

    def __pow__(self, other: Any) -> Sum:
        raise ProgramError(
            "a sum cannot be raised to a power; square its terms, or define the sum as a variable"
        )


@dataclass(frozen=True, eq=False)
class Constraint:
    """``lower <= body <= upper``. Created by comparing expressions or sums."""

    body: Expression | Sum
    lower: float
    upper: float

    def __bool__(self) -> bool:
        raise ProgramError("a constraint has no truth value; write each comparison separately")


@overload
def total(values: Expression) -> Sum: ...
@overload
def total(values: npt.NDArray[Any]) -> Array: ...
def total(values: Any) -> Any:
    """Sum over items: ``out[k] = sum_i values[i, k]``.

    Parameters
    ----------
    values
        Expression or array of shape ``(items, stages)``.

    Returns
    -------
    Sum or ndarray
        One value per stage.
    """
    if isinstance(values, Expression):
        return Sum((values,))
    array = np.asarray(values, dtype=float)
    return array.sum(axis=0)


def stacked(*values: Expression) -> Expression:
    """Join the items of variables that have the same stages, one block after the other.

    Raises
    ------
    ProgramError
        A value is not a variable itself, but a formula.
    """
    sources = []
    for value in values:
        leaves = list(value.leaves.values())
        if (
            len(leaves) != 1
            or leaves[0].kind != "variable"
            or not ca.is_equal(value.formula, leaves[0].symbol)
        ):
            raise ProgramError("only variables can be stacked, not formulas of them")
        sources.append(np.broadcast_to(leaves[0].source, value.shape))
    return reference(values[0].builder, "variable", np.concatenate(sources))


def largest(*values: Any) -> Any:
    """Entrywise maximum of expressions or arrays: ``max(0, x)``, ``|x| = max(x, -x)``.

    In a program the maximum is a new variable bounded from below by each argument. This is exact
    where the result is minimised or bounded from above; any other use would not be convex. The
    maximum of sums (``largest(0.0, total(x) - 5.0)``) has one value per stage.
    """
    builder = _builder(values)
    if builder is None:
        return np.maximum.reduce(np.broadcast_arrays(*values))
    return builder.epigraph([v if isinstance(v, Sum) else builder.expression(v) for v in values])


def largest_by(owner: npt.NDArray[np.intp], pieces: Any, items: int) -> Any:
    """Maximum over groups of rows: ``out[j] = max of pieces[i] over i with owner[i] = j``.

    Parameters
    ----------
    owner
        Item, from 0 to ``items - 1``, to which each row of ``pieces`` belongs.
    pieces
        Expression or array of shape ``(len(owner), stages)``.
    items
        Number of rows of the result; each must have at least one piece.
    """
    if isinstance(pieces, Expression):
        return pieces.builder.epigraph([pieces], owner=owner, items=items)
    array = np.asarray(pieces, dtype=float)
    out = np.full((items, *array.shape[1:]), -np.inf)
    np.maximum.at(out, owner, array)
    return out


def _builder(values: Sequence[Any]) -> ProgramBuilder | None:
    for value in values:
        if isinstance(value, Expression):
            return value.builder
        if isinstance(value, Sum):
            return value.terms[0].builder
    return None


def constant(builder: ProgramBuilder, values: Any) -> Expression:
    """Numbers as an expression; a uniform value becomes part of the formula."""
    array = np.asarray(values, dtype=float)
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim > 2 or not np.isfinite(array).all():
        raise ProgramError(
            f"an array of shape {array.shape} cannot be used in an expression; values must be finite, "
            "with at most two dimensions (leave out entries without a limit)"
        )
    shape = (1, 1) if array.ndim == 0 else (array.shape[0], array.shape[1])
    if array.size and (array == array.flat[0]).all():
        return Expression(builder, ca.SX(float(array.flat[0])), {}, shape)
    leaf = _leaf(builder, "constant", array)
    return Expression(builder, leaf.symbol, {leaf.symbol.name(): leaf}, shape)


def reference(builder: ProgramBuilder, kind: LeafKind, index: Index) -> Expression:
    """Entries of the variables or parameters at ``index``, shape ``(items, stages)``."""
    leaf = _leaf(builder, kind, index)
    return Expression(builder, leaf.symbol, {leaf.symbol.name(): leaf}, (index.shape[0], index.shape[1]))


def _leaf(builder: ProgramBuilder, kind: LeafKind, source: Index | Array) -> Leaf:
    """The leaf of a source: one for all equal sources, so that x - x is 0."""
    digest = hashlib.blake2b(np.ascontiguousarray(source).tobytes(), digest_size=8).hexdigest()
    name = f"{kind}_{source.shape[0]}_{source.shape[1]}_{digest}"
    leaf = builder.leaves.get(name)
    if leaf is None:
        leaf = builder.leaves[name] = Leaf(kind, ca.SX.sym(name), source)
    return leaf
