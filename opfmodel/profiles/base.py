"""What a profile rule is."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from opfmodel.data.columns import Columns
from opfmodel.data.series import SeriesKey
from opfmodel.errors import ProfileError, nearest
from opfmodel.network.components import Load
from opfmodel.network.network import Network

__all__ = ["ProfileRule", "Workbook"]

Array = npt.NDArray[np.float64]


@dataclass
class Workbook:
    """Time series in the making; rules read and write them one after the other.

    Attributes
    ----------
    network
        The declared network.
    steps
        Number of values of every series.
    step
        Hours between two values.
    folder
        Where relative file names start from.
    series
        Series by component and field, in physical units.
    sources
        The columns of a file that a series is from, for messages.
    """

    network: Network
    steps: int
    step: float
    folder: Path
    series: dict[SeriesKey, Array] = field(default_factory=dict)
    sources: dict[SeriesKey, Columns] = field(default_factory=dict)

    def get(self, component: str, key: str) -> Array:
        """The series of a field so far; a constant one if no rule has touched it."""
        if component not in self.network:
            raise ProfileError(f"no component is named {component!r}; {nearest(component, self.network)}")
        name = SeriesKey(component, key)
        if name not in self.series:
            return np.full(self.steps, self.network[component].constant(key))
        return self.series[name]

    def set(self, component: str, key: str, values: Array) -> None:
        """Replace the series of a field."""
        name = SeriesKey(component, key)
        self.series[name] = np.asarray(values, dtype=float)
        self.sources.pop(name, None)

    def source(self, error: ProfileError) -> str:
        """Where in a file the value is that an error is about; empty if it is from none."""
        if error.series is None or error.step is None or error.series not in self.sources:
            return ""
        key = SeriesKey(*error.series)
        return self.sources[key].place(str(key), error.step)

    def loads(self, names: list[str] | None) -> list[str]:
        """Names of loads: the given ones, checked, or all."""
        known = self.network.of(Load)
        for name in names or ():
            if name not in known:
                raise ProfileError(f"no load is named {name!r}; {nearest(name, known)}")
        return list(known) if names is None else names


class ProfileRule:
    """Changes the time series of a scenario; one class in one file.

    Registered by an entry point in the group ``opfmodel.profiles``; the keyword arguments of the
    constructor are the options in a scenario file.
    """

    def apply(self, book: Workbook) -> None:
        """Change the series of ``book``."""
        raise NotImplementedError
