"""The part of a program over a window of stages, as a program of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import blake2b

import casadi as ca
import numpy as np
import numpy.typing as npt

from solvers.program import POSITION, Array, Block, Cone, Index, Instance, Placement, Program
from solvers.solution import Start
from solvers.template import Template
from solvers.windows.staged import Ordered, Staged

__all__ = ["Span", "Window"]


@dataclass(frozen=True)
class Span:
    """The stages of a window, and those of them that are its own.

    Attributes
    ----------
    first, last
        Its stages are ``first`` to ``last - 1``.
    begin, end
        Those whose values the solution takes from it: ``begin`` to ``end - 1``.
    """

    first: int
    begin: int
    end: int
    last: int


class Window:
    r"""The stages of a window, with what lies before them given and what lies behind them priced.

    .. math::
        \min \sum_{k=a}^{b-1} f_k(x_{k-1}, x_k) + c' x_{b-1} + \tfrac{w}{2} |x_{b-1} - \bar x|^2
        \quad \text{s.t.} \quad g_k(x_{k-1}, x_k) \in [b_k^l, b_k^u], \; k = a, \dots, b - 1

    where :math:`x_{a-1}` is fixed and the price is :math:`c = \partial_{x_{b-1}} (f_b + \lambda_b' g_b)`. At
    an optimum of the whole program with multipliers :math:`\lambda`, its part over the window is a KKT point
    of this one, whatever the weight :math:`w` of the proximal term.

    Attributes
    ----------
    before, behind
        Variables of the whole program in stage ``first - 1`` that the window contains as given, and those
        of stage ``last - 1`` that carry a price.
    variables, rows, cones
        Positions in the whole program of the window's variables, rows and cone values, in its order. The
        window's variables follow those that are given.
    """

    def __init__(self, staged: Staged, span: Span) -> None:
        self.staged = staged
        self.span = span
        self.before = staged.touched(span.first - 1) if span.first else np.zeros(0, dtype=POSITION)
        self.behind = staged.touched(span.last - 1)
        program, first, last = staged.program, span.first, span.last
        self.variables = _positions(program.variables, staged.variables, first, last)
        self.rows = _positions(program.rows, staged.rows, first, last)
        self.cones = _positions(program.cones, staged.cones, first, last)

    @property
    def inside(self) -> Index:
        """Positions of all its variables in the whole program, the given ones first."""
        return np.concatenate([self.before, self.variables])

    def position(self, variables: Index) -> Index:
        """Return the positions in the window of some of its own variables."""
        return self.before.size + np.searchsorted(self.variables, variables)

    @cached_property
    def own(self) -> tuple[Index, Index, Index]:
        """Variables, rows and cone values of the whole program that it takes from this window."""
        program, staged, span = self.staged.program, self.staged, self.span
        return (
            _positions(program.variables, staged.variables, span.begin, span.end),
            _positions(program.rows, staged.rows, span.begin, span.end),
            _positions(program.cones, staged.cones, span.begin, span.end),
        )

    # Structure ---------------------------------------------------------------------------

    def placements(self, kind: str) -> list[Placement]:
        """Return the places of the window's rows, costs or cones, with positions in the whole program."""
        ordered: list[Ordered] = getattr(self.staged, kind)
        return [o.between(self.span.first, self.span.last) for o in ordered]

    @cached_property
    def structure(self) -> bytes:
        """Digest of everything but numbers; windows of the same structure share a compiled program."""
        digest = blake2b(digest_size=16)
        for placements in self._local.values():
            for placement in placements:
                for index in (placement.variables, placement.into):
                    digest.update(index.tobytes())
                digest.update(str(placement.count).encode())
        for blocks, columns in self._blocks():
            sizes = [(name, int(c[self.span.last] - c[self.span.first])) for name, c in columns.items()]
            digest.update(repr((len(blocks), sizes)).encode())
        digest.update(repr((self.before.size, self._seam.tolist())).encode())
        del self.__dict__["_local"]  # made again where it is needed
        return digest.digest()

    @cached_property
    def _local(self) -> dict[str, list[Placement]]:
        """The placements with positions among the window's variables, rows and cone values."""
        program = self.staged.program
        place = np.full(program.n_variables, -1, dtype=POSITION)
        place[self.before] = np.arange(self.before.size)
        place[self.variables] = self.before.size + np.arange(self.variables.size)
        targets = {
            "constraints": _places(self.rows, program.n_rows),
            "cone_values": _places(self.cones, program.n_cone_values),
        }
        made = {}
        for kind in ("constraints", "costs", "cone_values"):
            into = targets.get(kind)
            made[kind] = [
                replace(
                    p,
                    variables=place[p.variables],
                    into=p.into if into is None else np.where(p.into >= 0, into[p.into], -1),
                )
                for p in self.placements(kind)
            ]
        return made

    @cached_property
    def _seam(self) -> Index:
        """Positions of the variables that carry a price among those of the window."""
        return self.position(self.behind)

    def _blocks(self) -> list[tuple[Mapping[str, Block] | Mapping[str, Cone], dict[str, Index]]]:
        staged = self.staged
        program = staged.program
        return [
            (program.variables, staged.variables),
            (program.rows, staged.rows),
            (program.cones, staged.cones),
        ]

    def program(self, alike: Sequence[Window]) -> Program:
        """Return the program of this window and all that have its structure.

        Each placement has parameters of its own, which hold the values of its places. Those that are program
        data and equal in all windows remain program data.

        Parameters
        ----------
        alike
            The windows that share the program, this one among them.
        """
        whole, span = self.staged.program, self.span
        variables = {_GIVEN: _block(_GIVEN, self.before.size, 1, 0)} if self.before.size else {}
        offset = self.before.size
        for name, block in whole.variables.items():
            columns = _width(self.staged.variables[name], span)
            if columns and block.items:
                variables[name] = _block(name, block.items, columns, offset)
                offset += variables[name].size
        rows: dict[str, Block] = {}
        for name, block in whole.rows.items():
            columns = _width(self.staged.rows[name], span)
            if columns and block.items:
                rows[name] = _block(name, block.items, columns, sum(b.size for b in rows.values()))
        cones: dict[str, Cone] = {}
        for name, cone in whole.cones.items():
            columns = _width(self.staged.cones[name], span)
            if columns:
                used = sum(c.size for c in cones.values())
                cones[name] = Cone(name, cone.dimension, cone.items, columns, used)
        parameters: dict[str, Block] = {}
        made: dict[str, list[Placement]] = {}
        offset = 0
        for kind, placements in self._local.items():
            made[kind] = []
            for number, placement in enumerate(placements):
                items, count = placement.parameters.shape
                name = f"{kind} {number + 1}: {placement.block}"
                if not count:
                    continue
                values, fixed = self._data(alike, kind, number)
                block = _block(name, items, count, offset, values, fixed)
                if items:
                    parameters[name] = block
                    offset += block.size
                made[kind].append(replace(placement, parameters=block.index))
        del self.__dict__["_local"]
        if self.behind.size:
            block = _block(_SEAM, 3, self.behind.size, offset)
            parameters[_SEAM] = block
            into = np.zeros((1, self.behind.size), dtype=POSITION)
            made["costs"].append(Placement(_seam_cost(), self._seam[None, :], block.index, into, _SEAM))
        return Program(
            name=f"{whole.name}, {span.last - span.first} stages",
            variables=variables,
            parameters=parameters,
            rows=rows,
            cones=cones,
            constraints=tuple(made["constraints"]),
            costs=tuple(made["costs"]),
            cone_values=tuple(made["cone_values"]),
        )

    @staticmethod
    def _data(alike: Sequence[Window], kind: str, number: int) -> tuple[Array, npt.NDArray[np.bool_]]:
        """Return the values of the parameters at the places, and which are the same data in all windows."""
        whole = alike[0].staged.program
        values, fixed = None, None
        for window in alike:
            ordered: Ordered = getattr(window.staged, kind)[number]
            at = ordered.between(window.span.first, window.span.last).parameters
            own = whole.values[at]
            if values is None or fixed is None:
                values, fixed = own, whole.fixed_parameters[at]
            else:
                fixed = fixed & whole.fixed_parameters[at] & (own == values)
        assert values is not None and fixed is not None
        return values, fixed

    # Numbers -----------------------------------------------------------------------------

    def instance(self, instance: Instance) -> Instance:
        """Return the data of the window from those of the whole program; nothing before it is known."""
        parameters = [
            instance.parameters[p.parameters].ravel(order="F")
            for kind in ("constraints", "costs", "cone_values")
            for p in self.placements(kind)
        ]
        inside = self.inside
        return Instance(
            parameters=np.concatenate([*parameters, np.zeros(3 * self.behind.size)]),
            lower=instance.lower[inside],
            upper=instance.upper[inside],
            row_lower=instance.row_lower[self.rows],
            row_upper=instance.row_upper[self.rows],
            start=instance.start[inside],
        )

    def start(self, start: Start) -> Start:
        """Return the window's part of a starting point of the whole program."""
        inside = self.inside
        return Start(
            start.x[inside],
            None if start.lam_x is None else start.lam_x[inside],
            None if start.lam_g is None else start.lam_g[self.rows],
            None if start.z is None else start.z[self.cones],
            start.moved,
        )

    @cached_property
    def reaching(self) -> npt.NDArray[np.bool_]:
        """Rows of the window that contain a variable of the stage before it."""
        reaching = np.zeros(self.staged.program.n_rows, dtype=bool)
        for ordered in self.staged.constraints:
            own = ordered.between(self.span.first, self.span.first + 1)
            there = np.isin(own.variables, self.before).any(axis=0)
            into = own.into[:, there]
            reaching[into[into >= 0]] = True
        return reaching[self.rows]


_GIVEN = "stage before"
_SEAM = "price of the end"


def _seam_cost() -> Template:
    x, price, weight, centre = (ca.SX.sym(name) for name in ("x", "price", "weight", "centre"))
    cost = price * x + weight / 2 * (x - centre) ** 2
    return Template(_SEAM, x, ca.vertcat(price, weight, centre), cost)


def _block(
    name: str,
    items: int,
    stages: int,
    offset: int,
    value: Array | None = None,
    fixed: npt.NDArray[np.bool_] | bool = False,
) -> Block:
    """Return a block whose bounds every instance states."""
    shape = (items, stages)
    bound = np.broadcast_to(np.inf, shape)
    value = np.broadcast_to(0.0, shape) if value is None else value
    return Block(name, items, stages, offset, -bound, bound, value, fixed)


def _width(columns: Index, span: Span) -> int:
    return int(columns[span.last] - columns[span.first])


def _positions(
    blocks: Mapping[str, Block] | Mapping[str, Cone], columns: Mapping[str, Index], first: int, last: int
) -> Index:
    found = [np.zeros(0, dtype=POSITION)]
    for name, block in blocks.items():
        items = block.size // max(block.stages, 1)
        at = columns[name]
        found.append(np.arange(block.offset + items * at[first], block.offset + items * at[last]))
    return np.concatenate(found).astype(POSITION)


def _places(positions: Index, size: int) -> Index:
    place = np.full(size, -1, dtype=POSITION)
    place[positions] = np.arange(positions.size)
    return place
