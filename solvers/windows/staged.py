"""The stages of a program whose rows couple neighbouring stages only."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from solvers.errors import UnsupportedProgramError
from solvers.program import POSITION, Block, Cone, Index, Instance, Placement, Program

__all__ = ["Ordered", "Staged"]

_UNKNOWN = -1


@dataclass(frozen=True, eq=False)
class Ordered:
    """A placement whose places are in the order of their stages.

    Attributes
    ----------
    starts
        First place of each stage, and the number of places: ``stages + 1`` positions.
    """

    placement: Placement
    starts: Index

    def between(self, first: int, last: int) -> Placement:
        """Return the places of the stages ``first`` to ``last - 1``."""
        at = slice(int(self.starts[first]), int(self.starts[last]))
        own = self.placement
        return replace(
            own, variables=own.variables[:, at], parameters=own.parameters[:, at], into=own.into[:, at]
        )


class Staged:
    r"""A program in stages: variables, rows and costs belong to a stage, and reach back by one at most.

    .. math::
        \min \sum_k f_k(x_{k-1}, x_k) \quad \text{s.t.} \quad g_k(x_{k-1}, x_k) \in [b_k^l, b_k^u]

    The columns of blocks of variables with as many columns as there are stages belong to these; blocks
    with one more column hold the points between stages, which belong to the stage that they end, the first
    one to the first stage. Rows belong to the last stage whose variables they contain.

    Parameters
    ----------
    instance
        Its rows without limits are left out, whatever they couple.

    Raises
    ------
    UnsupportedProgramError
        A row, cone or cost couples stages that are no neighbours; the message names it.
    """

    def __init__(self, program: Program, instance: Instance) -> None:
        self.program = program
        self.stages = _stages(program)
        free = np.isneginf(instance.row_lower) & np.isposinf(instance.row_upper)
        self._stage = self._of_variables()
        self._row_stage, self._cone_stage = (
            self._of_targets(program.constraints, program.rows, program.n_rows, free),
            self._of_targets(program.cone_values, program.cones, program.n_cone_values, None),
        )
        self.variables = _columns(program.variables, self._stage, self.stages)
        self.rows = _columns(program.rows, self._row_stage, self.stages)
        self.cones = _columns(program.cones, self._cone_stage, self.stages)
        self.constraints = [self._ordered(p, self._row_stage, free) for p in program.constraints]
        self.cone_values = [self._ordered(p, self._cone_stage, None) for p in program.cone_values]
        self.costs = [self._ordered(p, None, None) for p in program.costs]

    def touched(self, stage: int) -> Index:
        """Return the variables of a stage that rows and costs of the next one contain, in their order."""
        if stage + 1 >= self.stages:
            return np.zeros(0, dtype=POSITION)
        found = [np.zeros(0, dtype=POSITION)]
        for ordered in (*self.constraints, *self.costs):
            used = np.unique(ordered.between(stage + 1, stage + 2).variables)
            found.append(used[self._stage[used] == stage])
        return np.unique(np.concatenate(found))

    # -------------------------------------------------------------------------------------

    def _of_variables(self) -> npt.NDArray[np.int32]:
        """Return the stage of each variable; of blocks over other columns that of what they occur with."""
        program = self.program
        stage = np.full(program.n_variables, _UNKNOWN, dtype=np.int32)
        for block in program.variables.values():
            if block.stages in (self.stages, self.stages + 1):
                late = block.stages - self.stages
                columns = np.maximum(np.arange(block.stages) - late, 0)
                stage[block.slice] = np.repeat(columns, block.items)
        found = np.full(program.n_variables, _UNKNOWN, dtype=np.int32)
        for placement in (*program.constraints, *program.cone_values, *program.costs):
            if placement.variables.size and (stage[placement.variables] == _UNKNOWN).any():
                latest = np.broadcast_to(stage[placement.variables].max(axis=0), placement.variables.shape)
                np.maximum.at(found, placement.variables.ravel(), latest.ravel())
        if ((stage == _UNKNOWN) & (found == _UNKNOWN)).any():  # such as slacks, which are terms of their own
            latest = np.full(program.n_rows, _UNKNOWN, dtype=np.int32)
            terms = [placement for placement in program.constraints if placement.variables.size]
            for placement in terms:
                own = stage[placement.variables].max(axis=0)
                for into in placement.into:
                    np.maximum.at(latest, into[into >= 0], own[into >= 0])
            for placement in terms:
                of = np.where(placement.into >= 0, latest[placement.into], _UNKNOWN).max(axis=0)
                of = np.broadcast_to(of, placement.variables.shape)
                np.maximum.at(found, placement.variables.ravel(), of.ravel())
        return np.where(stage == _UNKNOWN, np.maximum(found, 0), stage)

    def _of_targets(
        self,
        placements: Sequence[Placement],
        blocks: Mapping[str, Block] | Mapping[str, Cone],
        size: int,
        free: npt.NDArray[np.bool_] | None,
    ) -> npt.NDArray[np.int32]:
        """Return the stage of each row or cone value: the last one of its variables."""
        latest = np.full(size, _UNKNOWN, dtype=np.int32)
        earliest = np.full(size, self.stages, dtype=np.int32)
        for placement in placements:
            if not placement.variables.size:
                continue
            own = self._stage[placement.variables]
            for into in placement.into:
                kept = into >= 0
                np.maximum.at(latest, into[kept], own.max(axis=0)[kept])
                np.minimum.at(earliest, into[kept], own.min(axis=0)[kept])
        for block in (block for block in blocks.values() if block.size):
            own = latest[block.slice].reshape(-1, block.stages, order="F")
            columns = own.max(axis=0)
            usual = np.arange(block.stages) if block.stages == self.stages else np.zeros(block.stages)
            columns = np.where(columns == _UNKNOWN, usual, columns)
            first = earliest[block.slice].reshape(-1, block.stages, order="F")
            far = first < columns - (0 if isinstance(block, Cone) else 1)
            if free is not None:
                far &= ~free[block.slice].reshape(-1, block.stages, order="F")
            if far.any():
                column = int(np.argwhere(far.any(axis=0))[0][0])
                raise _far(self.program, block.name, int(first[:, column].min()), int(columns[column]))
            latest[block.slice] = np.broadcast_to(columns, own.shape).ravel(order="F")
        return latest

    def _ordered(
        self,
        placement: Placement,
        target: npt.NDArray[np.int32] | None,
        free: npt.NDArray[np.bool_] | None,
    ) -> Ordered:
        """Return a placement in the order of its stages, without places in rows that are free and far."""
        stage = np.zeros(placement.count, dtype=np.int32)
        into = placement.into
        if target is None:
            if placement.variables.size:
                own = self._stage[placement.variables]
                stage = own.max(axis=0)
                if (own.min(axis=0) < stage - 1).any():
                    place = int(np.argmax(own.min(axis=0) < stage - 1))
                    raise _far(self.program, placement.block, int(own[:, place].min()), int(stage[place]))
        else:
            of = np.where(into >= 0, target[into], _UNKNOWN)
            stage = of.max(axis=0)
            if free is not None and placement.variables.size:
                reach = self._stage[placement.variables].min(axis=0)
                into = np.where((into >= 0) & free[into] & (reach < of - 1), -1, into)
            if ((into >= 0) & (of != stage)).any():
                raise _far(self.program, placement.block, int(of[into >= 0].min()), int(stage.max()))
            stage = np.where((into >= 0).any(axis=0), stage, _UNKNOWN)
        order = np.argsort(stage, kind="stable")
        order = order[stage[order] != _UNKNOWN]
        starts = np.searchsorted(stage[order], np.arange(self.stages + 1))
        if order.size == placement.count and (order[1:] > order[:-1]).all():
            return Ordered(replace(placement, into=into), starts)
        made = replace(
            placement,
            variables=placement.variables[:, order],
            parameters=placement.parameters[:, order],
            into=into[:, order],
        )
        return Ordered(made, starts)


def _stages(program: Program) -> int:
    """Return the number of stages: most blocks of variables have as many columns, or one more."""
    count = Counter(block.stages for block in program.variables.values() if block.size)
    return max(count, key=lambda n: (count[n] + count[n + 1], count[n]), default=1)


def _columns(
    blocks: Mapping[str, Block] | Mapping[str, Cone], stage: npt.NDArray[np.int32], stages: int
) -> dict[str, Index]:
    """Return the first column of each stage, by block: ``stages + 1`` positions."""
    made = {}
    for block in blocks.values():
        items = block.size // max(block.stages, 1)
        own = stage[block.slice][:: max(items, 1)] if items else np.zeros(0, dtype=np.int32)
        if (np.diff(own) < 0).any():
            raise UnsupportedProgramError(
                f"'windows': the columns of {block.name!r} are not in the order of time"
            )
        made[block.name] = np.searchsorted(own, np.arange(stages + 1))
    return made


def _far(program: Program, block: str, first: int, last: int) -> UnsupportedProgramError:
    return UnsupportedProgramError(
        f"'windows' solves programs whose rows couple neighbouring stages, but {block!r} of "
        f"{program.name!r} couples stage {first} with stage {last}"
    )
