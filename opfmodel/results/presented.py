"""What runs and plans have in common: figures, reports, tables and files of their trajectories."""

from __future__ import annotations

import io
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from opfmodel.data.notebook import pairs
from opfmodel.errors import ResultError, nearest, shown
from opfmodel.results.store import load, netcdf, read_summary, save, write_file

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

__all__ = ["Presented", "SavedRun", "load_run", "wide"]

Scenarios = Mapping[str, tuple[float, float, "xr.Dataset"]]


class Presented(ABC):
    """Trajectories that can be plotted, reported and saved."""

    @property
    @abstractmethod
    def data(self) -> xr.Dataset:
        """The trajectories."""

    @abstractmethod
    def record(self) -> Mapping[str, Any]:
        """Return the figures of the run or plan, as ``summary.json`` has them."""

    def futures(self) -> Scenarios:
        """Return probability, cost and trajectories of each scenario; empty without several."""
        return {}

    def plot(self, figure: str = "system", buses: Sequence[str] | None = None) -> Figure:
        """Draw a figure with matplotlib.

        Parameters
        ----------
        figure
            ``system``, ``demand``, ``buses``, or ``paper`` for all quantities with the limits that bind.
        buses
            Buses to show; by default all of a small network, or a few with the highest demand or generation.

        Raises
        ------
        ResultError
            There is no such figure or bus.
        """
        from opfmodel.results.figures import FIGURES

        if figure not in FIGURES:
            raise ResultError(f"figure = {shown(figure)}: no such figure; {nearest(figure, FIGURES)}")
        return FIGURES[figure](self.data, buses)

    def report(self, path: str | Path) -> Path:
        """Write a report: one file of HTML that any browser opens, without a network.

        Raises
        ------
        ResultError
            The file cannot be written, or there is nothing to report.
        """
        from opfmodel.results.report import report_page

        futures = self.futures()
        likeliest = max(futures.values(), key=lambda each: each[0])[2] if futures else self.data
        return report_page(likeliest, self.record(), scenarios=futures).write(Path(path))

    def to_frame(self) -> pd.DataFrame:
        """Return the quantities as a pandas table: a row per stage, a column ``component.quantity`` each."""
        return wide(self.data)

    def to_csv(self, path: str | Path) -> Path:
        """Write the table of :meth:`to_frame` as CSV.

        Raises
        ------
        ResultError
            The file cannot be written.
        """
        stream = io.StringIO()
        self.to_frame().to_csv(stream, lineterminator="\n")
        return write_file(Path(path), stream.getvalue().encode())

    def to_netcdf(self, path: str | Path) -> Path:
        """Write the trajectories as NetCDF 4.

        Raises
        ------
        ResultError
            The file cannot be written.
        """
        return write_file(Path(path), netcdf(self.data))

    def _repr_html_(self) -> str:
        """Show the figures in short in a notebook."""
        known = {k: v for k, v in self.record().items() if isinstance(v, str | int | float)}
        return pairs(repr(self), {name.replace("_", " "): _text(value) for name, value in known.items()})


class SavedRun(Presented):
    """A run that was saved.

    Attributes
    ----------
    folder
        Where it was read.
    """

    def __init__(self, folder: Path, data: xr.Dataset, summary: Mapping[str, Any]) -> None:
        self.folder = folder
        self._data, self._summary = data, dict(summary)

    def __repr__(self) -> str:
        steps = self._data.sizes["time"]
        return (
            f"SavedRun({str(self.folder)!r}: {steps} steps, {self._summary.get('status', 'unknown status')})"
        )

    @property
    def data(self) -> xr.Dataset:
        """The trajectories."""
        return self._data

    def summary(self) -> dict[str, Any]:
        """Return the key figures, those of the independent check included."""
        return dict(self._summary)

    def record(self) -> Mapping[str, Any]:
        """Return the key figures."""
        return self._summary

    def save(self, folder: str | Path) -> None:
        """Write the run to a folder; see :meth:`Run.save`.

        Raises
        ------
        ResultError
            The folder cannot be written.
        """
        save(self._data, self._summary, Path(folder))


def load_run(folder: str | Path) -> SavedRun:
    """Read a run that ``opfmodel run`` or :meth:`Run.save` wrote.

    Raises
    ------
    ResultError
        There is none, or it is damaged.
    """
    data = load(folder)
    return SavedRun(Path(folder), data, read_summary(Path(folder)) or {})


def wide(data: xr.Dataset) -> pd.DataFrame:
    """Return the quantities over stages as a table with a column ``component.quantity`` each."""
    import pandas as pd

    along = "node" if "node" in data.dims else "time"
    columns: dict[str, Any] = {}
    for name, array in data.data_vars.items():
        if array.dims == (along,):
            columns[str(name)] = array.values
        elif array.dims[:1] == (along,) and array.ndim == 2:
            kind = array.dims[1]
            members = data[kind].values if kind in data.coords else range(data.sizes[kind])
            for place, member in enumerate(members):
                columns[f"{member}.{name}"] = array.values[:, place]
    index = {str(name): c.values for name, c in data.coords.items() if c.dims == (along,)}
    return pd.DataFrame({**index, **columns}).set_index(list(index))


def _text(value: str | int | float) -> str:
    return f"{value:,.6g}" if isinstance(value, float) else str(value)
