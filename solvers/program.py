"""The solver-neutral form of an optimisation problem.

A :class:`Program` is frozen data. It states::

    minimise    sum of cost templates over (x, p)
    subject to  row_lower  <=  rows(x, p)  <=  row_upper
                lower      <=      x       <=  upper
                s(x, p) = (t, u)  with  ||u||_2 <= t    for every cone

where ``x`` and ``p`` are divided into named blocks of shape ``(items, stages)``. An
:class:`Instance` holds the data of one solve: the next problem of a receding horizon is a new
instance of the same program.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from solvers.errors import ProgramError
from solvers.template import Template

__all__ = [
    "POSITION",
    "Array",
    "Block",
    "Composition",
    "Cone",
    "Epigraph",
    "Index",
    "Instance",
    "Output",
    "Placement",
    "Program",
]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.signedinteger[Any]]
POSITION = np.int32
"""Type of positions in a vector, which are most of a program of many stages: half the size of NumPy's own."""

Numbers = Mapping[str, "npt.ArrayLike"]


@dataclass(frozen=True, eq=False)
class Block:
    """A named, contiguous part of a vector, with ``items`` rows and ``stages`` columns.

    Attributes
    ----------
    lower, upper
        Bounds of shape ``(items, stages)``; infinite for parameters. Like the value they are read-only views,
        of one column where all stages have the same.
    value
        Starting point of a variable, default of a parameter; zero for rows.
    fixed
        Whether a parameter is program data that no instance may change: for all entries, or for each.
    """

    name: str
    items: int
    stages: int
    offset: int
    lower: Array
    upper: Array
    value: Array
    fixed: bool | npt.NDArray[np.bool_] = False

    @property
    def size(self) -> int:
        """Number of entries."""
        return self.items * self.stages

    @property
    def shape(self) -> tuple[int, int]:
        """``(items, stages)``."""
        return self.items, self.stages

    @property
    def slice(self) -> slice:
        """Position of the block in its vector."""
        return slice(self.offset, self.offset + self.size)

    @cached_property
    def index(self) -> Index:
        """Position of each entry in its vector; the entries of one stage are contiguous."""
        end = self.offset + self.size
        return np.arange(self.offset, end, dtype=POSITION).reshape(self.shape, order="F")

    def read(self, vector: Array) -> Array:
        """The block's part of ``vector`` as an array of shape ``(items, stages)``."""
        return vector[self.slice].reshape(self.shape, order="F")

    def spread(self, values: npt.ArrayLike) -> Array:
        """Broadcast ``values`` to ``(items, stages)``; a vector of length ``items`` gives one per item."""
        array = np.asarray(values, dtype=float)
        if array.shape == (self.items,):
            array = array[:, None]
        try:
            array = np.broadcast_to(array, self.shape)
        except ValueError:
            raise ProgramError(
                f"block {self.name!r}: shape {array.shape}; must broadcast to {self.shape} (items, stages)"
            ) from None
        if np.isnan(array).any():
            item, stage = (int(i) for i in np.argwhere(np.isnan(array))[0])
            raise ProgramError(f"block {self.name!r}, item {item}, stage {stage}: value is not a number")
        return array

    def check_order(self, lower: Array, upper: Array) -> None:
        """Raise :class:`solvers.ProgramError` where a lower bound exceeds the upper bound."""
        crossed = np.argwhere(lower > upper)
        if crossed.size:
            item, stage = (int(i) for i in crossed[0])
            raise ProgramError(
                f"block {self.name!r}, item {item}, stage {stage}: lower bound "
                f"{lower[item, stage]:g} exceeds upper bound {upper[item, stage]:g}"
            )


@dataclass(frozen=True, eq=False)
class Cone:
    """A named block of ``items * stages`` second-order cones of the same dimension.

    The values ``(t, u_1, ..., u_d)`` of each cone must satisfy ``||u||_2 <= t``.
    """

    name: str
    dimension: int
    items: int
    stages: int
    offset: int

    @property
    def size(self) -> int:
        """Number of scalar values over all cones of the block."""
        return self.dimension * self.items * self.stages

    @property
    def slice(self) -> slice:
        """Position of the block in the vector of cone values."""
        return slice(self.offset, self.offset + self.size)

    @cached_property
    def index(self) -> Index:
        """Positions of shape ``(dimension, items * stages)`` in the vector of cone values."""
        end = self.offset + self.size
        return np.arange(self.offset, end, dtype=POSITION).reshape(self.dimension, -1, order="F")

    def read(self, vector: Array) -> Array:
        """The block's part as an array of shape ``(dimension, items, stages)``."""
        return vector[self.slice].reshape(self.dimension, self.items, self.stages, order="F")


@dataclass(frozen=True, eq=False)
class Epigraph:
    """Variables ``t`` that represent a maximum: ``t - piece >= 0`` for each piece.

    Attributes
    ----------
    variables
        Variable block.
    pieces
        Row blocks, one for each piece.
    """

    variables: Block
    pieces: tuple[Block, ...]


@dataclass(frozen=True, eq=False)
class Composition:
    """A template as a function of a few intermediate quantities.

    Attributes
    ----------
    inner
        The intermediate quantities, of the template's variables and parameters.
    outer
        The template's outputs, of the intermediate quantities and the template's parameters.
    """

    inner: Template
    outer: Template


@dataclass(frozen=True, eq=False)
class Placement:
    """A template placed ``M`` times.

    Attributes
    ----------
    variables, parameters
        Positions in ``x`` and ``p``, of shapes ``(n_variables, M)`` and ``(n_parameters, M)``.
    into
        Positions to which the outputs are added, shape ``(n_outputs, M)``; -1 discards an output.
    block
        Name of the block that the placement belongs to, for messages.
    parts
        The template as a composition, if it was stated as one; see :func:`solvers.expansion.expand`.
    """

    template: Template
    variables: Index
    parameters: Index
    into: Index
    block: str
    parts: Composition | None = None

    @property
    def count(self) -> int:
        """Number of places ``M``."""
        return int(self.into.shape[1])


@dataclass(frozen=True, eq=False)
class Output:
    """A named quantity of shape ``(items, stages)``, computed from a solution.

    Attributes
    ----------
    variables, parameters
        Positions of each local variable and parameter of the template, which broadcast to the shape.
    """

    name: str
    items: int
    stages: int
    template: Template
    variables: tuple[Index, ...]
    parameters: tuple[Index, ...]


@dataclass(frozen=True, eq=False)
class Instance:
    """Data of one solve. Created by :meth:`Program.instance`."""

    parameters: Array
    lower: Array
    upper: Array
    row_lower: Array
    row_upper: Array
    start: Array


@dataclass(frozen=True, eq=False)
class Program:
    """An optimisation problem over named blocks. Created by :class:`solvers.ProgramBuilder`."""

    name: str
    variables: Mapping[str, Block]
    parameters: Mapping[str, Block]
    rows: Mapping[str, Block]
    cones: Mapping[str, Cone]
    constraints: tuple[Placement, ...]
    costs: tuple[Placement, ...]
    cone_values: tuple[Placement, ...]
    outputs: Mapping[str, Output] = field(default_factory=dict)
    epigraphs: tuple[Epigraph, ...] = ()

    def __repr__(self) -> str:
        return (
            f"Program({self.name!r}: {self.n_variables} variables, {self.n_rows} rows, "
            f"{sum(c.items * c.stages for c in self.cones.values())} cones)"
        )

    @property
    def composed(self) -> bool:
        """Whether it has an expanded form; see :func:`solvers.expansion.expand`."""
        return any(placement.parts is not None for placement in self.constraints)

    @property
    def n_variables(self) -> int:
        """Length of ``x``."""
        return sum(b.size for b in self.variables.values())

    @property
    def n_parameters(self) -> int:
        """Length of ``p``."""
        return sum(b.size for b in self.parameters.values())

    @property
    def n_rows(self) -> int:
        """Number of scalar rows."""
        return sum(b.size for b in self.rows.values())

    @property
    def n_cone_values(self) -> int:
        """Number of scalar values over all cones."""
        return sum(c.size for c in self.cones.values())

    @cached_property
    def fixed_parameters(self) -> npt.NDArray[np.bool_]:
        """Mask of the entries of ``p`` that no instance may change."""
        flags = [np.broadcast_to(b.fixed, b.shape).ravel(order="F") for b in self.parameters.values()]
        return np.concatenate([*flags, np.zeros(0, dtype=bool)])

    @cached_property
    def values(self) -> Array:
        """Default values of the parameters, in which the program data are."""
        return _join(self.parameters.values(), "value")

    @property
    def default(self) -> Instance:
        """Instance with the default bounds, values and starting point of each block."""
        return Instance(
            parameters=self.values.copy(),
            lower=_join(self.variables.values(), "lower"),
            upper=_join(self.variables.values(), "upper"),
            row_lower=_join(self.rows.values(), "lower"),
            row_upper=_join(self.rows.values(), "upper"),
            start=_join(self.variables.values(), "value"),
        )

    def instance(
        self,
        parameters: Numbers | None = None,
        lower: Numbers | None = None,
        upper: Numbers | None = None,
        start: Numbers | None = None,
    ) -> Instance:
        """Return the data for one solve: the defaults, overridden block by block.

        Parameters
        ----------
        parameters
            Values by parameter block, each broadcastable to ``(items, stages)``. Of a block that is program
            data in part, that part stays as it is.
        lower, upper
            Bounds by variable block or row block.
        start
            Starting point by variable block.

        Raises
        ------
        ProgramError
            Unknown block, wrong shape, NaN, or a lower bound above its upper bound.
        """
        new: dict[str, Array] = dict(vars(self.default))
        for name, values in (parameters or {}).items():
            block = self._block(name, self.parameters, "parameter")
            if np.all(block.fixed):
                raise ProgramError(f"parameter {name!r}: fixed program data; no instance may change it")
            given = np.where(block.fixed, block.value, block.spread(values))
            new["parameters"][block.slice] = given.ravel(order="F")
        for side, overrides in (("lower", lower), ("upper", upper)):
            for name, values in (overrides or {}).items():
                block = self._block(name, {**self.variables, **self.rows}, "variable or row")
                key = side if name in self.variables else f"row_{side}"
                new[key][block.slice] = block.spread(values).ravel(order="F")
        for name, values in (start or {}).items():
            block = self._block(name, self.variables, "variable")
            new["start"][block.slice] = block.spread(values).ravel(order="F")
        instance = Instance(**new)
        _check_order(self.variables.values(), instance.lower, instance.upper)
        _check_order(self.rows.values(), instance.row_lower, instance.row_upper)
        return instance

    @staticmethod
    def _block(name: str, blocks: Mapping[str, Block], kind: str) -> Block:
        try:
            return blocks[name]
        except KeyError:
            known = ", ".join(sorted(blocks)) or "none"
            raise ProgramError(f"unknown {kind} block {name!r}; available: {known}") from None


def _check_order(blocks: Iterable[Block], lower: Array, upper: Array) -> None:
    if (lower <= upper).all():
        return
    for block in blocks:
        block.check_order(block.read(lower), block.read(upper))


def _join(blocks: Iterable[Block], attribute: str) -> Array:
    parts: list[Array] = [getattr(b, attribute).ravel(order="F") for b in blocks]
    return np.concatenate([*parts, np.zeros(0)])
