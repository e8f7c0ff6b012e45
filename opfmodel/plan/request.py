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
    """The stages, initial state and data of one solve; see :meth:`opfmodel.MultiStage.solve`."""

    time: int
    initial: Initial | None
    end: End
    expected: Mapping[tuple[str, str], npt.NDArray[np.float64]] | None
    horizon: Horizon
    out: tuple[str, ...] = ()
