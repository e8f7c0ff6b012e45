"""What a profile rule is."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from opfmodel.components import Component, Load, Network
from opfmodel.data.columns import Columns
from opfmodel.errors import ProfileError, nearest

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
        Series by ``"component.field"``, in physical units.
    sources
        The columns of a file that a series is from, for messages.
    """

    network: Network
    steps: int
    step: float
    folder: Path
    series: dict[str, Array] = field(default_factory=dict)
    sources: dict[str, Columns] = field(default_factory=dict)

    def get(self, component: str, key: str) -> Array:
        """The series of a field so far; a constant one if no rule has touched it."""
        if component not in self.network:
            raise ProfileError(f"no component is named {component!r}; {nearest(component, self.network)}")
        name = f"{component}.{key}"
        if name not in self.series:
            return np.full(self.steps, constant(self.network[component], key))
        return self.series[name]

    def set(self, component: str, key: str, values: Array) -> None:
        """Replace the series of a field."""
        self.series[f"{component}.{key}"] = np.asarray(values, dtype=float)
        self.sources.pop(f"{component}.{key}", None)

    def source(self, error: ProfileError) -> str:
        """Where in a file the value is that an error is about; empty if it is from none."""
        if error.series not in self.sources or error.step is None:
            return ""
        return self.sources[error.series].place(error.series, error.step)

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


def constant(component: Component, key: str) -> float:
    """Value of a field of a table (``p``, ``p_max``, ``c1``) as the component declares it.

    Raises
    ------
    ProfileError
        The component has no such number; of a range the message names the two ends.
    """
    resolved, known = component.resolved(), component.fields()
    forms = {name: item.metadata["form"] for name, item in known.items()}
    stem, _, end = key.rpartition("_")
    if forms.get(key) == "number":
        value = getattr(resolved, key)
        return math.inf if value is None else float(value)  # None is "no limit"
    if forms.get(stem) == "span" and end in ("min", "max"):
        pair = getattr(resolved, stem)
        return float(pair[end == "max"] if isinstance(pair, tuple) else (pair if end == "max" else -pair))
    if "cost" in forms.values() and key in ("c2", "c1", "c0"):
        costs = [getattr(resolved, name) for name, form in forms.items() if form == "cost"]
        if hasattr(costs[0], key):
            return float(getattr(costs[0], key))
    ends = f"; it has {key}_min and {key}_max" if forms.get(key) == "span" else ""
    raise ProfileError(f"a {component.kind} has no number {key!r}{ends}")
