"""Files of PyPSA: netCDF files and folders of CSV files."""

from __future__ import annotations

import csv
import logging
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from opfmodel.data.files import check_file, is_folder, open_text
from opfmodel.errors import CaseError, listed

__all__ = ["is_pypsa", "load"]

_INSTALL = "install PyPSA (pip install 'opfmodel[pypsa]')"
_NETCDF = (".nc",)

# Columns of CSV folders that powerio reads as PyPSA does, besides those without effect.
_READ = {
    "buses": "name v_nom v_mag_pu_min v_mag_pu_max",
    "lines": "name bus0 bus1 x r b s_nom v_ang_min v_ang_max active",
    "transformers": "name bus0 bus1 x r s_nom tap_ratio phase_shift active",
    "generators": "name bus control p_nom p_min_pu p_max_pu marginal_cost marginal_cost_quadratic active",
    "loads": "name bus p_set q_set active",
    "shunt_impedances": "name bus g b active",
}
# Values with which other columns mean nothing.
_NEUTRAL = {
    "g": "0",
    "b": "0",
    "model": "pi",
    "num_parallel": "1",
    "s_max_pu": "1",
    "tap_side": "0",
    "tap_position": "0",
    "v_ang_min": "-inf",
    "v_ang_max": "inf",
    "q_set": "0",
    "v_mag_pu_set": "1",
    "carrier": "AC",
}
_SILENT = ("network.csv", "carriers.csv", "crs.json", "meta.json", "shapes.csv", "snapshots.csv")


def is_pypsa(path: Path, format: str | None) -> bool:
    """Whether a path is a netCDF file, or a folder with the buses of a PyPSA network."""
    if format is not None:
        import powerio

        known = powerio.resolve_format(format)
        return known is not None and known.token == "pypsa-csv"
    if path.suffix.lower() in _NETCDF:
        return True
    return is_folder(path) and _exists(path / "buses.csv")


def load(path: Path) -> Any:
    """Read a file or folder with PyPSA; return None where powerio may read a folder in its place.

    Raises
    ------
    CaseError
        The files cannot be read, or PyPSA is not installed and they hold what powerio drops.
    """
    folder = is_folder(path)
    for file in sorted(path.iterdir()) if folder else [path]:
        if not is_folder(file):
            check_file(file, CaseError)
    if find_spec("pypsa") is not None:
        return _load(path)
    if not folder:
        raise CaseError(f"{path}: is read by PyPSA only; {_INSTALL}")
    _check_folder(path)
    return None


def _load(path: Path) -> Any:
    import pypsa

    # PyPSA looks for a newer version of itself on the internet at every import of a network.
    with pypsa.option_context("general.allow_network_requests", False), _quiet():
        try:
            n = pypsa.Network(path)
        except (OSError, ValueError, LookupError, TypeError, AttributeError, RuntimeError) as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise CaseError(f"{path}: cannot be read as a PyPSA network: {reason}") from error
    if not len(n.c.buses.static):
        raise CaseError(f"{path}: cannot be read as a PyPSA network: it has no buses")
    return n


@contextmanager
def _quiet() -> Iterator[None]:
    """Drop what PyPSA logs: it may cite names that cannot be printed, and its tables are checked anyway."""
    logger = logging.getLogger("pypsa")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)


# Without PyPSA -------------------------------------------------------------------------------------


def _check_folder(path: Path) -> None:
    """Refuse a folder that holds what powerio drops or reads otherwise than PyPSA."""
    dropped = []
    for file in sorted(path.iterdir()):
        if is_folder(file) or file.name in _SILENT:
            continue
        known = _READ.get(file.stem)
        if file.suffix != ".csv" or known is None:
            dropped.append(file.name)
            continue
        dropped += [f"{file.name}: {column}" for column in _dropped(file, known.split())]
    if _exists(path / "snapshots.csv") and len(list(_rows(path / "snapshots.csv"))) > 1:
        dropped.append("snapshots.csv: several snapshots")
    if dropped:
        raise CaseError(f"{path}: {listed(dropped)}: read by PyPSA only; {_INSTALL}")


def _dropped(file: Path, known: Iterable[str | None]) -> list[str]:
    """Columns with an effect that powerio does not read as PyPSA does."""
    from opfmodel.network.cases.pypsa.attributes import CLASSES

    silent = CLASSES[file.stem].unused
    found: dict[str, None] = {}
    for row in _rows(file):
        for column, value in row.items():
            if column in known or (column in silent and column != "carrier"):
                continue
            if not _neutral(column, (value or "").strip()):
                found[column or "a nameless column"] = None
    return list(found)


def _neutral(column: str | None, value: str) -> bool:
    if value in ("", "nan", "NaN"):
        return True
    neutral = _NEUTRAL.get(column or "")
    try:
        return neutral is not None and float(value) == float(neutral)
    except ValueError:
        return value == neutral


def _rows(file: Path) -> Iterator[dict[str | None, str | None]]:
    with open_text(file, CaseError) as stream:
        try:
            yield from csv.DictReader(stream)
        except csv.Error as error:
            raise CaseError(f"{file}: cannot be read: {error}") from error


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):
        return False
