"""The arguments of one solve."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from opfmodel.horizon import Horizon
from opfmodel.plan.end import End

__all__ = ["Initial", "Limits", "Request"]

Initial = Mapping[str, "npt.ArrayLike | None"]
Limits = Mapping[str, tuple["npt.ArrayLike", "npt.ArrayLike"]]


@dataclass(frozen=True)
class Request:
    """The stages, initial state and data of one solve; see :meth:`opfmodel.MultiStage.solve`.

    Attributes
    ----------
    settings
        Values at which settings of the network are held, per unit by block; NaN where one is decided.
    """

    time: int
    initial: Initial | None
    end: End
    expected: Mapping[tuple[str, str], npt.NDArray[np.float64]] | None
    horizon: Horizon
    out: tuple[str, ...] = ()
    settings: Mapping[str, npt.NDArray[np.float64]] | None = None
