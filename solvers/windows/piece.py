"""What the solution of a window needs, apart from the whole program."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from solvers.program import POSITION, Array, Index, Instance
from solvers.windows.seam import Seam
from solvers.windows.window import Window

__all__ = ["End", "Piece"]


@dataclass(frozen=True, eq=False)
class End:
    """Price, weight and centre of the proximal term of the variables at the end of a window."""

    price: Array
    weight: Array
    centre: Array

    @classmethod
    def free(cls, size: int) -> End:
        """Return an end without value."""
        return cls(np.zeros(size), np.zeros(size), np.zeros(size))


@dataclass(frozen=True, eq=False)
class Piece:
    """What a chain needs to know of a window; positions are those in the vectors of its program.

    Attributes
    ----------
    structure
        Key of its program.
    data
        Its data, while nothing before it is known.
    given
        Number of its variables that are given, which are the first.
    reaching
        Rows that contain these.
    behind
        Number of its variables that carry a price.
    link
        Positions of what is given in the window before it; None if that one belongs to another chain.
    seam
        The seam at the end of its own stages; None at the end of the horizon.
    own
        Positions of its own variables, rows and cone values: those that the solution takes from it.
    joint
        Positions of the variables in which its own stages touch those before, if the window has these too.
    """

    structure: bytes
    data: Instance
    given: int
    reaching: npt.NDArray[np.bool_]
    behind: int
    link: Index | None
    seam: Seam | None
    own: tuple[Index, Index, Index]
    joint: Index

    @classmethod
    def of(cls, window: Window, instance: Instance, before: Window | None = None) -> Piece:
        """Return the piece of a window.

        Parameters
        ----------
        before
            The window before it in its chain.
        """
        staged, span, seam = window.staged, window.span, None
        if span.end < staged.stages:
            seam = Seam.after(staged, span.end - 1, instance).inside(window)
        joint = np.zeros(0, dtype=POSITION)
        if span.begin > span.first:
            joint = window.position(staged.touched(span.begin - 1))
        variables, rows, cones = window.own
        return cls(
            structure=window.structure,
            data=window.instance(instance),
            given=window.before.size,
            reaching=window.reaching,
            behind=window.behind.size,
            link=None if before is None else before.position(window.before),
            seam=seam,
            own=(
                window.position(variables),
                np.searchsorted(window.rows, rows),
                np.searchsorted(window.cones, cones),
            ),
            joint=joint,
        )

    def posed(self, given: Array | None, end: End) -> Instance:
        """Return the data of one solve.

        Parameters
        ----------
        given
            Values before the window; None if they are not known: then no row that contains them is in
            force.
        """
        data, n = self.data, self.given
        lower, upper, start = data.lower.copy(), data.upper.copy(), data.start.copy()
        row_lower, row_upper = data.row_lower, data.row_upper
        if given is not None:
            lower[:n] = upper[:n] = start[:n] = given
        elif n:
            row_lower = np.where(self.reaching, -np.inf, row_lower)
            row_upper = np.where(self.reaching, np.inf, row_upper)
        parameters = data.parameters.copy()
        if end.price.size:
            parameters[-3 * end.price.size :] = np.stack([end.price, end.weight, end.centre]).ravel(order="F")
        return Instance(parameters, lower, upper, row_lower, row_upper, start)
