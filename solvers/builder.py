"""Stating a program: declare blocks, then add terms to them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any
from weakref import WeakValueDictionary

import casadi as ca
import numpy as np
import numpy.typing as npt

from solvers.errors import ProgramError
from solvers.expression import Constraint, Expression, Leaf, Sum, constant, reference
from solvers.program import (
    POSITION,
    Array,
    Block,
    Composition,
    Cone,
    Epigraph,
    Index,
    Output,
    Placement,
    Program,
)
from solvers.template import Template, column

__all__ = ["ProgramBuilder", "Rows"]


class Rows:
    """Rows of a program, addressed like an array of shape ``(items, stages)``."""

    def __init__(self, name: str, index: Index) -> None:
        self.name = name
        self.index = index

    def __getitem__(self, key: Any) -> Rows:
        """Select rows; items may repeat, so that several terms are added to one row."""
        return Rows(self.name, np.atleast_2d(self.index[key]))


class ProgramBuilder:
    """Collect blocks, rows, costs and cones, and freeze them into a :class:`solvers.Program`.

    Parameters
    ----------
    name
        Name of the program, used in messages.
    ordered
        Whether the stages of its expressions follow one another in time. If not, a slice of stages has no
        meaning and is an error; positions and masks select as usual.

    Examples
    --------
    Minimise ``(x - 1)^2 + y`` subject to ``x + y >= 3``, ``y >= 0``:

    >>> from solvers import ProgramBuilder, solve
    >>> build = ProgramBuilder("example")
    >>> x = build.variable("x", 1)
    >>> y = build.variable("y", 1, lower=0.0)
    >>> build.minimize((x - 1.0) ** 2 + y)
    >>> _ = build.constrain("enough", x + y >= 3.0)
    >>> round(solve(build.build(), "ipopt").objective, 6)
    1.75
    """

    def __init__(self, name: str = "program", ordered: bool = True) -> None:
        self.name = name
        self.ordered = ordered
        self.leaves: WeakValueDictionary[str, Leaf] = WeakValueDictionary()  # of all expressions, by symbol
        self._variables: dict[str, Block] = {}
        self._parameters: dict[str, Block] = {}
        self._rows: dict[str, Block] = {}
        self._cones: dict[str, Cone] = {}
        self._constraints: list[Placement] = []
        self._costs: list[Placement] = []
        self._cone_values: list[Placement] = []
        self._outputs: dict[str, Output] = {}
        self._epigraphs: list[Epigraph] = []
        self._data: dict[str, Block] = {}

    # Blocks ------------------------------------------------------------------------------

    @property
    def variables(self) -> Mapping[str, Block]:
        """Blocks of variables declared so far, by name."""
        return self._variables

    def variable(
        self,
        name: str,
        items: int,
        stages: int = 1,
        lower: npt.ArrayLike = -np.inf,
        upper: npt.ArrayLike = np.inf,
        start: npt.ArrayLike | None = None,
    ) -> Expression:
        """Declare a block of variables, which start at the point within their bounds nearest to zero."""
        block = self._block(self._variables, name, items, stages, lower, upper, 0.0)
        value = np.clip(0.0, *map(_distinct, (block.lower, block.upper))) if start is None else start
        self._variables[name] = replace(block, value=block.spread(value))
        return reference(self, "variable", block.index)

    def parameter(
        self,
        name: str,
        items: int,
        stages: int = 1,
        value: npt.ArrayLike = 0.0,
        fixed: bool | npt.NDArray[np.bool_] = False,
    ) -> Expression:
        """Declare a block of parameters, whose values may change from instance to instance.

        Parameters
        ----------
        fixed
            Entries that are program data, ``(items, 1)`` or ``(items, stages)``: coefficients that they
            determine are constant.
        """
        block = self._block(self._parameters, name, items, stages, -np.inf, np.inf, value, fixed)
        return reference(self, "parameter", block.index)

    def rows(
        self,
        name: str,
        items: int,
        stages: int = 1,
        lower: npt.ArrayLike = 0.0,
        upper: npt.ArrayLike = 0.0,
    ) -> Rows:
        """Declare a block of empty rows; :meth:`add` adds terms to them."""
        block = self._block(self._rows, name, items, stages, lower, upper, 0.0)
        return Rows(name, block.index)

    # Terms -------------------------------------------------------------------------------

    def add(
        self,
        what: Template | Expression | Sum | Sequence[Expression],
        *,
        into: Rows | Sequence[Rows] | Index,
        variables: Index | None = None,
        parameters: Index | None = None,
    ) -> None:
        """Add terms to rows; terms added to the same row are summed.

        Parameters
        ----------
        what
            An expression, a sum, or several expressions that share a template (cheaper than one
            template each if they have common sub-expressions); or a :class:`Template`, placed by
            index arrays.
        into
            Rows for each expression, which broadcast against it; for a template, positions of
            shape ``(n_outputs, M)``, with -1 to discard an output.
        variables, parameters
            For a template only: positions of shape ``(n_variables, M)`` and ``(n_parameters, M)``.
        """
        if isinstance(what, Template):
            count = np.asarray(into).shape[1]
            empty = np.zeros((0, count), dtype=POSITION)
            self._constraints.append(
                Placement(
                    what,
                    np.asarray(empty if variables is None else variables, dtype=POSITION),
                    np.asarray(empty if parameters is None else parameters, dtype=POSITION),
                    np.asarray(into, dtype=POSITION),
                    what.name,
                )
            )
            return
        if isinstance(what, Sum):
            assert isinstance(into, Rows)
            for term in what.terms:
                self.add(term, into=into)
            return
        expressions = [what] if isinstance(what, Expression) else list(what)
        rows = [into] if isinstance(into, Rows) else list(into)
        name = "+".join(dict.fromkeys(r.name for r in rows))
        index = [r.index for r in rows]
        placement = self._place(name, expressions, index)
        if placement.count:
            self._constraints.append(placement)

    def compose(
        self,
        outer: Callable[..., Sequence[Expression]],
        inner: Sequence[Expression],
        *,
        into: Sequence[Rows],
    ) -> None:
        """Add ``outer(*inner)`` to rows, like :meth:`add`.

        The program then has a second form, in which the intermediate quantities ``inner`` are variables; see
        :func:`solvers.expansion.expand`.
        """
        index = [rows.index for rows in into]
        name = "+".join(dict.fromkeys(rows.name for rows in into))
        whole = outer(*inner)  # kept, so that the constants of its formulas are those of the terms
        placement = self._place(name, whole, index)
        if not placement.count:
            return
        template = placement.template
        symbols = [ca.SX.sym(f"{name} {position + 1}") for position in range(len(inner))]
        terms = outer(
            *(Expression(self, symbol, {}, e.shape) for symbol, e in zip(symbols, inner, strict=True))
        )
        parts = Composition(
            Template(
                f"quantities of {name} ({len(self._constraints) + 1})",
                template.variables,
                template.parameters,
                column([expression.formula for expression in inner]),
            ),
            Template(name, column(symbols), template.parameters, column([term.formula for term in terms])),
        )
        self._constraints.append(replace(placement, parts=parts))

    def minimize(self, cost: Expression | Sum) -> None:
        """Add the sum of all entries of ``cost`` to the objective."""
        for term in cost.spread() if isinstance(cost, Sum) else (cost,):
            if term.items * term.stages:
                self._costs.append(self._place(f"cost {len(self._costs) + 1}", [term], None))

    def constrain(self, name: str, constraint: Constraint) -> Rows:
        """Add a comparison of expressions or sums as a new block of rows."""
        body = constraint.body
        items, stages = (1, body.stages) if isinstance(body, Sum) else body.shape
        rows = self.rows(name, items, stages, constraint.lower, constraint.upper)
        self.add(body, into=rows)
        return rows

    def cone(self, name: str, bound: Any, *entries: Any) -> None:
        """State ``||(entries)||_2 <= bound`` entrywise; all arguments must be affine in the variables.

        Expressions without entries add no cone.
        """
        expressions = [self.expression(e) for e in (bound, *entries)]
        shape = np.broadcast_shapes(*(e.shape for e in expressions))
        self._check_new(name)
        if not shape[0] * shape[1]:
            return
        offset = sum(c.size for c in self._cones.values())
        cone = Cone(name, len(expressions), shape[0], shape[1], offset)
        self._cones[name] = cone
        index = [row.reshape((shape[0], shape[1]), order="F") for row in cone.index]
        self._cone_values.append(self._place(name, expressions, index))

    def output(self, name: str, expression: Expression) -> None:
        """Declare a named expression whose values every solution reports."""
        template, variables, parameters = self._template(name, [expression])
        self._outputs[name] = Output(name, *expression.shape, template, variables, parameters)

    # Expressions -------------------------------------------------------------------------

    def expression(self, values: Any) -> Expression:
        """Return an expression unchanged, and numbers as a constant expression."""
        if isinstance(values, Expression):
            return values
        if isinstance(values, Sum):
            raise ProgramError("a sum cannot be used in a formula; sums can be added, scaled and compared")
        return constant(self, values)

    def epigraph(
        self, pieces: Sequence[Expression | Sum], owner: Index | None = None, items: int | None = None
    ) -> Expression:
        """Declare a variable bounded from below by each piece. See :func:`solvers.largest`."""
        shape = np.broadcast_shapes(*(p.shape for p in pieces))
        if shape[0] != 1 and any(isinstance(p, Sum) for p in pieces):
            raise ProgramError(f"a sum has one value per stage; it cannot be combined with {shape[0]} items")
        name = f"largest {len(self._epigraphs) + 1}"
        above = self.variable(name, shape[0] if items is None else items, shape[1])
        rows = [f"{name}, piece {position + 1}" for position in range(len(pieces))]
        for row, piece in zip(rows, pieces, strict=True):
            self.constrain(row, (above if owner is None else above[owner]) - piece >= 0.0)
        self._epigraphs.append(Epigraph(self._variables[name], tuple(self._rows[row] for row in rows)))
        return above

    def build(self) -> Program:
        """Freeze the declarations into a program."""
        return Program(
            name=self.name,
            variables=dict(self._variables),
            parameters=dict(self._parameters),
            rows=dict(self._rows),
            cones=dict(self._cones),
            constraints=tuple(self._constraints),
            costs=tuple(self._costs),
            cone_values=tuple(self._cone_values),
            outputs=dict(self._outputs),
            epigraphs=tuple(self._epigraphs),
        )

    # -------------------------------------------------------------------------------------

    def _check_new(self, name: str) -> None:
        taken: tuple[dict[str, Any], ...] = (self._variables, self._parameters, self._rows, self._cones)
        if any(name in blocks for blocks in taken):
            raise ProgramError(f"program {self.name!r}: block {name!r} already exists")

    def _block(
        self,
        blocks: dict[str, Block],
        name: str,
        items: int,
        stages: int,
        lower: npt.ArrayLike,
        upper: npt.ArrayLike,
        value: npt.ArrayLike,
        fixed: bool | npt.NDArray[np.bool_] = False,
    ) -> Block:
        self._check_new(name)
        offset = sum(b.size for b in blocks.values())
        none = np.zeros((0, 0))
        bare = Block(name, items, stages, offset, none, none, none)
        low, high, default = (bare.spread(np.array(v, dtype=float)) for v in (lower, upper, value))
        block = Block(name, items, stages, offset, low, high, default, fixed)
        block.check_order(low, high)
        blocks[name] = block
        return block

    def _place(self, name: str, expressions: Sequence[Expression], into: Sequence[Index] | None) -> Placement:
        """Turn expressions into one template and its placement."""
        shape = np.broadcast_shapes(*(e.shape for e in expressions), *(i.shape for i in into or ()))
        count = shape[0] * shape[1]
        template, variables, parameters = self._template(name, expressions)

        def flat(sources: Sequence[Index]) -> Index:
            made = np.empty((len(sources), count), dtype=POSITION)
            for row, source in zip(made, sources, strict=True):
                row[:] = np.broadcast_to(source, shape).ravel(order="F")
            return made

        # all entries of a cost add to one value
        index = np.broadcast_to(POSITION(0), (1, count)) if into is None else flat(into)
        return Placement(template, flat(variables), flat(parameters), index, name)

    def _template(
        self, name: str, expressions: Sequence[Expression]
    ) -> tuple[Template, tuple[Index, ...], tuple[Index, ...]]:
        """Turn expressions into a template, with the positions of its variables and of its parameters."""
        leaves: dict[str, Leaf] = {}
        for expression in expressions:
            leaves.update(expression.leaves)
        variables = [leaf for leaf in leaves.values() if leaf.kind == "variable"]
        parameters = [leaf for leaf in leaves.values() if leaf.kind != "variable"]
        template = Template(
            name,
            column([leaf.symbol for leaf in variables]),
            column([leaf.symbol for leaf in parameters]),
            column([e.formula for e in expressions]),
        )
        variable, parameter = (tuple(map(self._positions, each)) for each in (variables, parameters))
        return template, variable, parameter

    def _positions(self, leaf: Leaf) -> Index:
        """Positions from which a leaf is read; constants of the formulas are blocks of parameters."""
        source: Index = self._data_block(leaf).index if leaf.kind == "constant" else leaf.source
        return source

    def _data_block(self, leaf: Leaf) -> Block:
        """Parameter block that holds a constant of the formulas; equal constants share a block."""
        key = leaf.symbol.name()
        if key not in self._data:
            values = np.asarray(leaf.source, dtype=float)
            name = f"data {len(self._data) + 1}"
            self._data[key] = self._block(
                self._parameters,
                name,
                values.shape[0],
                values.shape[1],
                -np.inf,
                np.inf,
                values,
                fixed=True,
            )
        return self._data[key]


def _distinct(view: Array) -> Array:
    """The part of a view that does not repeat: one row or column along each axis that it was broadcast to."""
    return view[tuple(slice(None if step else 1) for step in view.strides)]
