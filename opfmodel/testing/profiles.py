"""The contract of a profile rule."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from opfmodel.data.grid import Grid
from opfmodel.data.series import Profiles
from opfmodel.errors import OpfmodelError
from opfmodel.network.network import Network
from opfmodel.network.series import check_series
from opfmodel.profiles.base import ProfileRule, Workbook
from opfmodel.testing.grids import feeder
from opfmodel.testing.options import check_options
from solvers.testing import Contract

__all__ = ["check_profile"]


def check_profile(rule: ProfileRule, network: Network | None = None, folder: Path | None = None) -> None:
    """Raise :class:`ContractError` unless a profile rule satisfies its contract.

    - Its options are documented plain data.
    - It writes series of fields in the network, with one finite value per step, for any number of
      steps.
    - It is reproducible, and modifies neither the network nor arrays of other rules.
    - On a network that lacks a component named in its options, it raises an ``OpfmodelError`` with
      the name; it writes nothing for unknown components.

    Parameters
    ----------
    network
        A grid with the names in the options; by default a feeder with all built-in devices.
    folder
        Folder to which file names in the options are relative.
    """
    rules = Contract(f"profile {type(rule).__name__}")
    rules.require(isinstance(rule, ProfileRule), "is a ProfileRule")
    check_options(rules, type(rule))
    network = feeder() if network is None else network
    folder = Path() if folder is None else folder
    for steps in (1, 3, 24):
        book, again = (Workbook(network, Grid(steps), folder) for _ in range(2))
        before = dict(network._components)
        with rules.rule("applies to a network with the components it names"):
            rule.apply(book)
            rule.apply(again)
        rules.require(network._components == before, "does not modify the network")
        _check_series(rules, book)
        same = book.series.keys() == again.series.keys() and all(
            np.array_equal(values, again.series[key]) for key, values in book.series.items()
        )
        rules.require(same, "writes the same series when applied again")
        _check_kept(rules, rule, book)
    _check_missing(rules, rule, network, folder)


def _check_series(rules: Contract, book: Workbook) -> None:
    """Series have one finite value per step, and belong to fields of the network."""
    for key, values in book.series.items():
        right = np.shape(values) == (book.steps,)
        rules.require(right, "writes one value per step", f"{key} has shape {np.shape(values)}")
        rules.require(np.isfinite(values).all(), "writes finite values", str(key))
    with rules.rule("writes series of fields in the network"):
        check_series(Profiles(book.series), book.network)


def _check_kept(rules: Contract, rule: ProfileRule, book: Workbook) -> None:
    """Arrays in the workbook are replaced, not modified."""
    given = dict(book.series)
    copies = {key: values.copy() for key, values in given.items()}
    with rules.rule("applies to series from other rules"):
        rule.apply(book)
    kept = all(np.array_equal(given[key], copies[key]) for key in given)
    rules.require(kept, "replaces arrays of other rules instead of modifying them")


def _check_missing(rules: Contract, rule: ProfileRule, network: Network, folder: Path) -> None:
    """On a network with other names, the rule raises an error or writes nothing."""
    other = Network("other", network.base_mva)
    for name in network:
        component = network[name]
        fields = {key: getattr(component, key) for key in component.fields()}
        fields |= {key: f"other-{fields[key]}" for key in component.bus_fields()}
        other.add(f"other-{name}", type(component)(**fields))
    book = Workbook(other, Grid(3), folder)
    with rules.rule("raises an OpfmodelError for unknown components"):
        try:
            rule.apply(book)
        except OpfmodelError as error:
            rules.require("'" in str(error), "names the unknown component", str(error))
            return
        except Exception as error:
            found = f"{type(error).__name__}: {error}"
            rules.require(False, "raises an OpfmodelError for unknown components", found)
    strange = [key for key in book.series if key.component not in other]
    found = ", ".join(str(key) for key in strange)
    rules.require(not strange, "writes no series of unknown components", found)
