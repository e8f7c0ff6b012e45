"""Trajectories as labelled arrays, in memory and on disk."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from opfmodel.data.files import check_file
from opfmodel.errors import ResultError
from opfmodel.network import PerUnitNetwork
from opfmodel.units import scale

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["dataset", "finite", "load", "replace", "save"]

Array = npt.NDArray[np.float64]


def dataset(
    network: PerUnitNetwork, quantities: Mapping[str, tuple[str, str, str, Array]], times: Array
) -> xr.Dataset:
    """A dataset in physical units from per-unit arrays.

    Parameters
    ----------
    network
        Arrays of the network, with the time series of the window.
    quantities
        ``(kind, unit, description, values)`` by name; values of shape ``(items, stages)``. The
        kind "" stands for the whole system; one that the network does not have is numbered.
    times
        Hours at which the stages begin.

    Returns
    -------
    xarray.Dataset
        Dimensions ``time`` and one per kind of component; also the demand ``pd``, ``qd`` of each bus.
    """
    import xarray as xr

    made = xr.Dataset(coords={"time": ("time", times, {"units": "h", "long_name": "start of the stage"})})
    made = made.assign_coords({"bus": list(network.bus.names)})
    for kind, _, _, values in quantities.values():
        if kind and kind not in made.coords:
            table = network.tables.get(kind)
            made = made.assign_coords({kind: np.arange(len(values)) if table is None else list(table.names)})
            if table is not None and "bus" in table.arrays:
                at = [network.bus.names[b] for b in table.bus]
                made = made.assign_coords({f"{kind}_bus": (kind, at, {"long_name": f"bus of the {kind}"})})
    demand = {
        name: ("bus", unit, f"{sort} demand", _demand(network, field, len(times)))
        for name, field, unit, sort in (("pd", "p", "MW", "active"), ("qd", "q", "MVAr", "reactive"))
    }
    for name, (kind, unit, description, values) in {**quantities, **demand}.items():
        physical = values * scale(unit, network.base_mva)
        attributes = {"units": unit, "long_name": description}
        made[name] = (("time", kind), physical.T, attributes) if kind else ("time", physical[0], attributes)
    return made


def _demand(network: PerUnitNetwork, field: str, stages: int) -> Array:
    values = network.load.arrays[field]
    return network.at_buses("load", np.broadcast_to(values, (len(values), stages)))


def save(data: xr.Dataset, summary: Mapping[str, object], folder: Path) -> None:
    """Write ``trajectories.nc`` (NetCDF 4) and ``summary.json`` into a folder, which is made if need be.

    Each file is written under a temporary name and renamed, so that none is ever half there.

    Raises
    ------
    ResultError
        The folder cannot be made or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        replace(folder / "trajectories.nc", lambda path: data.to_netcdf(path, engine="h5netcdf"))
        text = json.dumps(finite(summary), indent=2, allow_nan=False) + "\n"
        replace(folder / "summary.json", lambda path: path.write_text(text, encoding="utf-8"))
    except OSError as error:
        raise ResultError(f"{folder}: results cannot be written: {error.strerror or error}") from error


def finite(value: Any) -> Any:
    """Plain data as JSON can have it, which knows no infinity and no nan: these become None."""
    if isinstance(value, Mapping):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def load(folder: str | Path) -> xr.Dataset:
    """Read the trajectories of a saved run.

    Raises
    ------
    ResultError
        The folder holds no readable ``trajectories.nc``.
    """
    import xarray as xr

    path = Path(folder)
    path = path / "trajectories.nc" if os.path.isdir(path) else path  # noqa: PTH112 - of any text
    if not os.path.exists(path):  # noqa: PTH110 - of any text
        raise ResultError(f"{path}: there is no such file; 'opfmodel run' writes it")
    check_file(path, ResultError)
    try:
        return xr.load_dataset(path, engine="h5netcdf")
    except (OSError, ValueError, KeyError) as error:
        raise ResultError(f"{path}: not a result of opfmodel: {error}") from error


def replace(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file under a temporary name, see that it is on the disk, and rename it.

    Parameters
    ----------
    write
        Writes to the path that it is given.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        write(temporary)
        _sync(temporary)
        temporary.replace(path)
        _sync(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


def _sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    if path.is_dir() and os.name == "nt":
        return  # a folder cannot be opened there, and a renamed file is safe
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
