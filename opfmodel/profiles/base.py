"""Base class of profile rules, and the workbook that they edit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from opfmodel.data.columns import Columns
from opfmodel.data.grid import Grid
from opfmodel.data.series import SeriesKey
from opfmodel.errors import ProfileError, nearest, raise_all, shown
from opfmodel.network.components import Load
from opfmodel.network.network import Network

__all__ = ["ProfileRule", "Workbook"]

Array = npt.NDArray[np.float64]


@dataclass
class Workbook:
    """Time series under construction; rules read and write them in turn.

    Attributes
    ----------
    network
        The declared network.
    grid
        The steps that the series cover.
    folder
        Folder to which file names are relative.
    series
        Series by component and field, in physical units.
    sources
        Columns of the file that a series was read from, for messages.
    """

    network: Network
    grid: Grid
    folder: Path
    series: dict[SeriesKey, Array] = field(default_factory=dict)
    sources: dict[SeriesKey, Columns] = field(default_factory=dict)

    @property
    def steps(self) -> int:
        """Number of values of every series."""
        return self.grid.steps

    @property
    def step(self) -> float:
        """Hours between two values."""
        return self.grid.hours

    def get(self, component: str, key: str) -> Array:
        """Return the current series of a field; constant if no rule has changed it."""
        if component not in self.network:
            raise ProfileError(
                f"no component is named {shown(component)}; {nearest(component, self.network)}"
            )
        name = SeriesKey(component, key)
        if name not in self.series:
            return np.full(self.steps, self.network[component].constant(key))
        return self.series[name][: self.steps]

    def set(self, component: str, key: str, values: Array) -> None:
        """Replace the series of a field."""
        name = SeriesKey(component, key)
        self.series[name] = np.asarray(values, dtype=float)
        self.sources.pop(name, None)

    def source(self, error: ProfileError) -> str:
        """Return the position in a file of the value that an error is about; empty if from no file."""
        if error.series is None or error.step is None or error.series not in self.sources:
            return ""
        key = SeriesKey(*error.series)
        return self.sources[key].place(str(key), error.step)

    def loads(self, names: list[str] | None) -> list[str]:
        """Check and return names of loads; None stands for all."""
        known = self.network.of(Load)

        def errors() -> Iterator[ProfileError]:
            for number, name in enumerate(names or ()):
                if name not in known:
                    error = ProfileError(f"no load is named {shown(name)}; {nearest(name, known)}")
                    error.key = ("loads", number)
                    yield error

        raise_all(errors())
        return list(known) if names is None else names


class ProfileRule:
    """Base class of rules that change the time series of a scenario.

    Register subclasses as entry points in the group ``opfmodel.profiles``. The keyword arguments of
    the constructor are the options in a scenario file.
    """

    def apply(self, book: Workbook) -> None:
        """Change the series of ``book``."""
        raise NotImplementedError
