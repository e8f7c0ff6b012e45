"""Horizons: the nodes in time of a problem, as a chain, an uneven grid or a tree, with contingencies."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
import numpy.typing as npt

from opfmodel.errors import HorizonError, shown
from opfmodel.network.bounds import STEP_HOURS, integer, is_number, number_within

__all__ = ["Horizon", "check_splits"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

_SAME = 1e-9  # relative; hours and probabilities are sums of rounded numbers
_OF_NODES = ("parent", "hours", "probability", "step", "series", "scenario")


@dataclass(frozen=True, eq=False)
class Horizon:
    r"""Nodes in time, each with a length and a predecessor.

    A plan decides one stage per node. What couples stages acts from a node's parent to the node, and the
    cost is :math:`\sum_n \pi_n h_n \ell(x_n, u_n)`, with the probability :math:`\pi_n` and the length
    :math:`h_n` of node n. Parents come before their children. Made by :meth:`chain`, :meth:`grid`,
    :meth:`tree` and :meth:`branching`.

    A contingency is the state of the grid a few minutes after an outage at the end of a node: a child of
    that node with its data, without probability and without children. Contingencies come last.

    Attributes
    ----------
    parent
        Node that each node follows; -1 for a root, which follows the measured state.
    hours
        Length of each node, a multiple of ``base``.
    probability
        Weight of each node in the objective; the nodes of one depth sum to 1.
    step
        First base step that each node covers, counted from the beginning of the plan.
    series
        Future from which the data of each node come; 0 in a chain, and the first of those that share a node.
    scenario
        Name of the future of each node, or of the group of futures that share it; empty for nodes that all
        futures share.
    base
        Length of a base step, h: that of the time series and of the closed loop.
    out
        Components out of service in each node; empty if there are no contingencies.
    varying
        Whether each solve may state other probabilities; see :meth:`with_probabilities`.
    """

    parent: Index
    hours: Array
    probability: Array
    step: Index
    series: Index
    scenario: tuple[str, ...]
    base: float
    varying: bool = False
    out: tuple[tuple[str, ...], ...] = ()

    # Making ------------------------------------------------------------------------------

    @classmethod
    def chain(cls, stages: int, step: float = 1.0) -> Self:
        """Return ``stages`` equal stages, one after the other.

        Examples
        --------
        >>> Horizon.chain(3).parent.tolist()
        [-1, 0, 1]
        """
        stages = integer("horizon", stages, at_least=1)
        base = number_within("step", step, at_least=STEP_HOURS[0], at_most=STEP_HOURS[1])
        return cls.tree([base] * stages, {"": 1.0}, step=base)

    @classmethod
    def grid(cls, hours: Sequence[float], step: float | None = None) -> Self:
        """Return stages of different lengths, one after the other.

        Parameters
        ----------
        hours
            Length of each stage.
        step
            Length of a base step, of which each length must be a multiple; the first length by default.

        Raises
        ------
        HorizonError
            A length is not a positive multiple of the step.

        Examples
        --------
        >>> Horizon.grid([0.25, 0.25, 0.5, 1, 2]).step.tolist()
        [0, 1, 2, 4, 8]
        """
        return cls.tree(hours, {"": 1.0}, step=step)

    @classmethod
    def tree(
        cls,
        hours: Sequence[float],
        scenarios: Mapping[str, float],
        common: int = 0,
        step: float | None = None,
        varying: bool = False,
    ) -> Self:
        """Return a tree whose scenarios share their first nodes and are chains after that.

        Parameters
        ----------
        hours
            Length of the nodes from the measured state to the end, the same in every scenario.
        scenarios
            Probability of each scenario, by name.
        common
            Number of nodes at the beginning that all scenarios share; 0: each begins at the measured state.
        step
            As for :meth:`grid`.
        varying
            Whether each solve may state other probabilities.

        Raises
        ------
        HorizonError
            A probability is not positive or they do not sum to 1; the common part is longer than the
            horizon; a length is not a positive multiple of the step.

        Examples
        --------
        >>> tree = Horizon.tree([1, 1, 1], {"low": 0.4, "high": 0.6}, common=1)
        >>> tree.parent.tolist(), tree.scenario
        ([-1, 0, 0, 1, 2], ('', 'low', 'high', 'low', 'high'))
        """
        lengths, base = _lengths(hours, step)
        names, shares = _probabilities(scenarios)
        common = integer("common", common, at_least=0, error=HorizonError)
        depth = len(lengths)
        many = len(names)
        if common > depth or (common == depth and many > 1):
            raise HorizonError(f"common = {common}: must be below the number of stages, {depth}", "common")
        widths = [1] * common + [many] * (depth - common)
        return cls._of_widths(widths, {1: ("",), many: names}, shares, lengths, base, varying)

    @classmethod
    def branching(
        cls,
        hours: Sequence[float],
        splits: Mapping[int, int],
        step: float | None = None,
        varying: bool = False,
    ) -> Self:
        """Return a tree that splits more than once, with equally probable futures.

        The first split makes ``path 1``, ``path 2``, ..., and the next one ``path 1.1``, ``path 1.2``, ... of
        them: the names of the futures that share a node begin with its name.

        Parameters
        ----------
        hours, step, varying
            As for :meth:`tree`.
        splits
            Number of children of every node at the end of a number of stages, by that number. A single split
            after n stages makes the same nodes as :meth:`tree` with n common ones.

        Raises
        ------
        HorizonError
            A split is not within the horizon or has fewer than two children; a length is not a positive
            multiple of the step.

        Examples
        --------
        >>> tree = Horizon.branching([1, 1, 1], {1: 2, 2: 2})
        >>> tree.parent.tolist(), tree.scenario[1:4]
        ([-1, 0, 0, 1, 1, 2, 2], ('path 1', 'path 2', 'path 1.1'))
        """
        lengths, base = _lengths(hours, step)
        widths = [1] * len(lengths)
        names: dict[int, tuple[str, ...]] = {1: ("",)}
        for depth, children in check_splits(splits).items():
            if depth >= len(lengths):
                raise HorizonError(
                    f"splits: {depth}: must be below the number of stages, {len(lengths)}",
                    "draw", "splits", str(depth),
                )  # fmt: skip
            heads = [f"{name}." if name else "path " for name in names[widths[-1]]]
            widths[depth:] = [widths[-1] * children] * len(widths[depth:])
            names[widths[-1]] = tuple(f"{head}{n}" for head in heads for n in range(1, children + 1))
        shares = np.full(widths[-1], 1.0 / widths[-1])
        return cls._of_widths(widths, names, shares, lengths, base, varying)

    @classmethod
    def _of_widths(
        cls,
        widths: Sequence[int],
        names: Mapping[int, Sequence[str]],
        shares: Array,
        lengths: Index,
        base: float,
        varying: bool,
    ) -> Self:
        """Return a tree from the number of nodes at each depth, each a multiple of the one before.

        Parameters
        ----------
        names
            Names of the nodes of a depth, by their number.
        shares
            Probability of each leaf.
        """
        width = np.array(widths, dtype=np.intp)
        level = np.repeat(np.arange(width.size), width)
        first = np.cumsum(width) - width  # first node of each depth
        rank = np.arange(level.size) - first[level]  # of a node among those of its depth
        above = np.maximum(level - 1, 0)
        leaves = width[-1] // width[level]  # of each node
        series = rank * leaves
        starts = np.cumsum(lengths) - lengths
        return cls(
            parent=np.where(level > 0, first[above] + rank * width[above] // width[level], -1),
            hours=np.asarray(lengths * base)[level],
            probability=np.array([shares[s : s + n].sum() for s, n in zip(series, leaves, strict=True)]),
            step=starts[level],
            series=series,
            scenario=tuple(name for count in widths for name in names[count]),
            base=base,
            varying=varying,
        )

    def with_contingencies(self, outages: Iterable[tuple[int, tuple[str, ...]]], minutes: float) -> Horizon:
        """Return these nodes with contingencies.

        Parameters
        ----------
        outages
            The node after which each outage happens, and the names of the components that it takes out.
        minutes
            Time for the response.

        Examples
        --------
        >>> secured = Horizon.chain(2).with_contingencies([(0, ("tie",)), (1, ("tie",))], minutes=15)
        >>> secured.parent.tolist(), secured.hours.tolist(), secured.leaves.tolist()
        ([-1, 0, 0, 1], [1.0, 1.0, 0.25, 0.25], [1])
        """
        given = list(outages)
        if not given:
            return self.regular
        nodes = self.regular
        after = np.array([node for node, _ in given], dtype=np.intp)
        return replace(
            nodes,
            parent=np.concatenate([nodes.parent, after]),
            hours=np.concatenate([nodes.hours, np.full(after.size, minutes / 60)]),
            probability=np.concatenate([nodes.probability, np.zeros(after.size)]),
            step=np.concatenate([nodes.step, nodes.step[after]]),
            series=np.concatenate([nodes.series, nodes.series[after]]),
            scenario=(*nodes.scenario, *(nodes.scenario[node] for node in after)),
            out=(*((),) * len(nodes), *(names for _, names in given)),
        )

    def with_probabilities(self, scenarios: Sequence[float]) -> Self:
        """Return the same nodes with other probabilities of the scenarios, in the order of the leaves."""
        names = [str(number) for number in range(len(scenarios))]
        if len(names) != len(self.leaves):
            raise HorizonError(
                f"{len(names)} probabilities: must be {len(self.leaves)}, one for each scenario"
            )
        _, shares = _probabilities(dict(zip(names, scenarios, strict=True)))
        probability = np.zeros(len(self))
        for path, share in zip(self.paths, shares, strict=True):
            probability[path] += share
        return replace(self, probability=probability)

    def same_nodes(self, other: Horizon) -> bool:
        """Return whether another horizon differs in probabilities alone."""
        mine, theirs = (self.parent, self.hours, self.series), (other.parent, other.hours, other.series)
        return (self.base, self.out) == (other.base, other.out) and all(map(np.array_equal, mine, theirs))

    # Structure ---------------------------------------------------------------------------

    def __len__(self) -> int:
        return len(self.parent)

    def __repr__(self) -> str:
        return f"Horizon({self})"

    def __str__(self) -> str:
        if self.contingencies.size:
            return f"{self.regular} with {self.contingencies.size} contingencies"
        noun = "stage" if len(self) == 1 else "stages"
        if not self.is_chain:
            steps = f"{self.steps} steps of {self.base:g} h"
            return f"{len(self)} nodes, {len(self.leaves)} scenarios over {steps}"
        if self.is_even:
            return f"{len(self)} {noun} of {self.base:g} h"
        return f"{len(self)} {noun} over {self.steps} steps of {self.base:g} h"

    @cached_property
    def contingencies(self) -> Index:
        """Nodes that are contingencies; they come last."""
        return np.flatnonzero([bool(names) for names in self.out])

    @cached_property
    def regular(self) -> Horizon:
        """The same horizon without contingencies."""
        count = len(self) - self.contingencies.size
        if count == len(self):
            return self
        parts = {name: getattr(self, name)[:count] for name in _OF_NODES}
        return replace(self, **parts, out=())

    @cached_property
    def owner(self) -> Index:
        """The regular node to which each node belongs: itself, or that after which a contingency happens."""
        owner = np.arange(len(self))
        owner[self.contingencies] = self.parent[self.contingencies]
        return owner

    @cached_property
    def is_chain(self) -> bool:
        """Whether every node follows the one before it."""
        return bool(np.array_equal(self.parent, np.arange(len(self)) - 1))

    @cached_property
    def is_even(self) -> bool:
        """Whether every node is one base step long."""
        return bool((self.lengths == 1).all())

    @cached_property
    def lengths(self) -> Index:
        """Base steps that each node covers."""
        return np.asarray(np.rint(self.hours / self.base).astype(np.intp)[self.owner])

    @cached_property
    def steps(self) -> int:
        """Base steps from the measured state to the end."""
        return int((self.step + self.lengths).max())

    @cached_property
    def begins(self) -> Array:
        """Hours from the beginning of the plan to that of each node."""
        return np.asarray(self.step * self.base, dtype=float)

    @cached_property
    def weights(self) -> Array:
        """Probability times length of each node, h."""
        return self.probability * self.hours

    @cached_property
    def influence(self) -> Array:
        """Weight of each node in prices and penalties, h: of a contingency, that of its owner."""
        return self.weights[self.owner]

    @cached_property
    def roots(self) -> Index:
        """Nodes that follow the measured state."""
        return np.flatnonzero(self.parent < 0)

    @cached_property
    def inner(self) -> Index:
        """Nodes that follow another node."""
        return np.flatnonzero(self.parent >= 0)

    @cached_property
    def leaves(self) -> Index:
        """Nodes that no regular node follows, one per scenario."""
        nodes = self.regular
        return np.setdiff1d(np.arange(len(nodes)), nodes.parent)

    @cached_property
    def siblings(self) -> tuple[Index, Index]:
        """Regular nodes with the same parent: each but the first of them, and that first one."""
        _, first, group = np.unique(self.regular.parent, return_index=True, return_inverse=True)
        eldest = first[group]
        later = np.flatnonzero(eldest != np.arange(len(self.regular)))
        return later, eldest[later]

    @cached_property
    def depth(self) -> Index:
        """Number of nodes before each node on its path; of a contingency, before its owner."""
        depth = np.zeros(len(self), dtype=np.intp)
        for node in self.regular.inner:  # parents come first
            depth[node] = depth[self.parent[node]] + 1
        return depth[self.owner]

    @cached_property
    def trunk(self) -> Horizon:
        """The chain of the moments that all futures share: a plan for the expected future has it."""
        return Horizon.grid(self.hours[self.paths[0]].tolist(), self.base)

    @cached_property
    def scenarios(self) -> tuple[str, ...]:
        """Names of the scenarios, in the order of the leaves."""
        return tuple(self.scenario[leaf] for leaf in self.leaves)

    def path(self, leaf: int) -> Index:
        """Return the nodes from the root to a node, in order of time."""
        nodes = [leaf]
        while self.parent[nodes[-1]] >= 0:
            nodes.append(int(self.parent[nodes[-1]]))
        return np.array(nodes[::-1], dtype=np.intp)

    @cached_property
    def paths(self) -> tuple[Index, ...]:
        """Path to each leaf."""
        return tuple(map(self.path, self.leaves.tolist()))

    def columns(self, count: int) -> Index | None:
        """Return the node of each column of an array with ``count`` columns; None if it has no such columns.

        There is one column per node, per node with a parent, per regular node, per leaf, per root, or one per
        node after one for the value before the first, which is node -1.
        """
        nodes = np.arange(len(self))
        kinds = (
            nodes,
            np.arange(-1, len(self)),
            self.inner,
            nodes[: len(self.regular)],
            self.leaves,
            self.roots,
        )
        return next((nodes for nodes in kinds if nodes.size == count), None)

    def moved(self, steps: int) -> Index:
        """Return the node of the same horizon, begun ``steps`` base steps earlier, that each node resembles.

        Its start for a warm start: the node of the same future at that time. A leaf stays a leaf and the
        node before it is repeated to fill the gap, because every horizon ends alike. A contingency resembles
        the same one of the node that its owner resembles, or that node if it has none.
        """
        nodes = np.arange(len(self), dtype=np.intp)
        likely = np.argsort(-self.probability[self.leaves], kind="stable")
        for path in (self.paths[leaf] for leaf in likely[::-1]):  # shared nodes continue in the most likely
            ends = (self.step + self.lengths)[path]
            at = np.searchsorted(ends, self.step[path[:-1]] + steps, side="right")
            nodes[path[:-1]] = path[np.minimum(at, max(len(path) - 2, 0))]
        known = {(int(self.owner[node]), self.out[node]): node for node in self.contingencies}
        for node in self.contingencies:
            owner = int(nodes[self.owner[node]])
            nodes[node] = known.get((owner, self.out[node]), owner)
        return nodes


def check_splits(splits: Mapping[int, int]) -> dict[int, int]:
    """Return the number of children by the depth of a split, in order of time.

    Raises
    ------
    HorizonError
        A depth is not a positive integer, or a split has fewer than two children.
    """
    at = ("draw", "splits")
    if not isinstance(splits, Mapping) or not splits:
        raise HorizonError(f"splits = {shown(splits)}: must be a mapping such as {{2: 3, 6: 2}}", *at)
    for depth, children in splits.items():
        try:
            integer("splits: stages", depth, at_least=1, error=HorizonError)
            integer(f"splits: {depth}: children", children, at_least=2, error=HorizonError)
        except HorizonError as error:
            raise HorizonError(str(error), *at, str(depth)) from None
    return {int(depth): int(splits[depth]) for depth in sorted(splits)}


def _lengths(hours: Sequence[float], step: float | None) -> tuple[Index, float]:
    """Check the lengths of stages; return them in base steps, and the base step."""
    given = list(hours) if not isinstance(hours, str) else []
    if not given or not all(is_number(value) and value > 0 for value in given):
        raise HorizonError(f"hours = {hours!r}: must be a list of positive numbers", "hours")
    base = number_within(
        "step", given[0] if step is None else step, at_least=STEP_HOURS[0], at_most=STEP_HOURS[1]
    )
    ratio = np.array(given, dtype=float) / base
    lengths = np.rint(ratio).astype(np.intp)
    wrong = np.flatnonzero((lengths < 1) | (np.abs(ratio - lengths) > _SAME * ratio))
    if wrong.size:
        raise HorizonError(
            f"hours: {given[wrong[0]]:g}: must be a multiple of the step of {base:g} h",
            "hours",
            int(wrong[0]),
        )
    return lengths, base


def _probabilities(scenarios: Mapping[str, float]) -> tuple[tuple[str, ...], Array]:
    """Check the probabilities of scenarios."""
    if not scenarios:
        raise HorizonError("scenarios: needs at least one", "cases")
    for name, share in scenarios.items():
        if not (is_number(share) and 0 < share <= 1):
            raise HorizonError(
                f"{name}: probability = {share!r}: must be a number above 0 and at most 1",
                "cases",
                "cases",
                name,
                "probability",
            )
    shares = np.array(list(scenarios.values()), dtype=float)
    if abs(shares.sum() - 1.0) > _SAME * len(shares):
        raise HorizonError(f"the probabilities sum to {shares.sum():.9g}; must sum to 1", "cases")
    return tuple(map(str, scenarios)), shares / shares.sum()
