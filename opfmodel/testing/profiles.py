"""The contract of a profile rule."""

from __future__ import annotations

from pathlib import Path

import numpy as np

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
    """Raise :class:`ContractError` unless a profile rule keeps its contract.

    Its options are documented and plain data; it writes series of numbers, one per step for any
    number of steps, of fields that the network has; it gives the same again, and changes neither the
    network nor series that it was given; on a network that lacks what it names it raises an error of
    opfmodel that names it, and writes nothing for components that do not exist.

    Parameters
    ----------
    network
        A grid that the options fit; by default a feeder with all built-in devices.
    folder
        Where relative file names of the rule start from.
    """
    rules = Contract(f"profile {type(rule).__name__}")
    rules.require(isinstance(rule, ProfileRule), "is a ProfileRule")
    check_options(rules, type(rule))
    network = feeder() if network is None else network
    folder = Path() if folder is None else folder
    for steps in (1, 3, 24):
        book, again = (Workbook(network, steps, 1.0, folder) for _ in range(2))
        before = dict(network._components)
        with rules.rule("applies to a network that has what it names"):
            rule.apply(book)
            rule.apply(again)
        rules.require(network._components == before, "leaves the network as it is")
        _check_series(rules, book)
        same = book.series.keys() == again.series.keys() and all(
            np.array_equal(values, again.series[key]) for key, values in book.series.items()
        )
        rules.require(same, "gives the same series again")
        _check_kept(rules, rule, book)
    _check_missing(rules, rule, network, folder)


def _check_series(rules: Contract, book: Workbook) -> None:
    """Series of the right length, of numbers, of fields that there are."""
    for key, values in book.series.items():
        right = np.shape(values) == (book.steps,)
        rules.require(right, "writes one value per step", f"{key} has shape {np.shape(values)}")
        rules.require(np.isfinite(values).all(), "writes finite numbers", str(key))
    with rules.rule("writes series of fields that the network has"):
        check_series(Profiles(book.series), book.network)


def _check_kept(rules: Contract, rule: ProfileRule, book: Workbook) -> None:
    """Arrays that are in the workbook are replaced, not written into."""
    given = dict(book.series)
    copies = {key: values.copy() for key, values in given.items()}
    with rules.rule("applies to series that other rules have made"):
        rule.apply(book)
    kept = all(np.array_equal(given[key], copies[key]) for key in given)
    rules.require(kept, "replaces the arrays of other rules instead of writing into them")


def _check_missing(rules: Contract, rule: ProfileRule, network: Network, folder: Path) -> None:
    """On a network with other names it is an error or nothing."""
    other = Network("other", network.base_mva)
    for name in network:
        component = network[name]
        fields = {key: getattr(component, key) for key in component.fields()}
        fields |= {key: f"other-{fields[key]}" for key in component.bus_fields()}
        other.add(f"other-{name}", type(component)(**fields))
    book = Workbook(other, 3, 1.0, folder)
    with rules.rule("says by an error of opfmodel what a network lacks"):
        try:
            rule.apply(book)
        except OpfmodelError as error:
            rules.require("'" in str(error), "names what a network lacks", str(error))
            return
        except Exception as error:
            found = f"{type(error).__name__}: {error}"
            rules.require(False, "says by an error of opfmodel what a network lacks", found)
    strange = [key for key in book.series if key.component not in other]
    found = ", ".join(str(key) for key in strange)
    rules.require(not strange, "writes no series of components that do not exist", found)
