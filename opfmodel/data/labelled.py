"""Arrays over named dimensions: what results are made of, with xarray or without."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Labelled", "Variable"]


class Variable(NamedTuple):
    """An array with the names of its dimensions and its attributes."""

    dims: tuple[str, ...]
    values: npt.NDArray[Any]
    attrs: Mapping[str, Any]


@dataclass
class Labelled:
    """Named arrays, coordinates of their dimensions, and attributes.

    It has the members of an ``xarray.Dataset`` that one needs to read it, for those who need no more:
    importing xarray takes longer than to solve a small problem.
    """

    coords: dict[str, Variable] = field(default_factory=dict)
    data_vars: dict[str, Variable] = field(default_factory=dict)
    attrs: dict[str, Any] = field(default_factory=dict)

    def __contains__(self, name: object) -> bool:
        return name in self.data_vars or name in self.coords

    def __getitem__(self, name: str) -> Variable:
        return self.data_vars[name] if name in self.data_vars else self.coords[name]

    def take(self, dimension: str, positions: npt.NDArray[np.intp]) -> Labelled:
        """Return the values at some positions along a dimension."""

        def at(variable: Variable) -> Variable:
            if dimension not in variable.dims:
                return variable
            taken = np.take(variable.values, positions, axis=variable.dims.index(dimension))
            return variable._replace(values=taken)

        coords, variables = (
            {name: at(variable) for name, variable in part.items()} for part in (self.coords, self.data_vars)
        )
        return replace(self, coords=coords, data_vars=variables)

    def dataset(self) -> xr.Dataset:
        """Return the same as a dataset."""
        import xarray as xr

        return xr.Dataset(self.data_vars, self.coords, self.attrs)
