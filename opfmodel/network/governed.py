"""Quantities that others govern in each stage, as a status does limits; see :attr:`Component.governs`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from opfmodel.data.series import Profiles
from opfmodel.network.arrays import Index, PerUnitNetwork
from opfmodel.network.series import fields_with_series, over_all_steps

__all__ = ["at_start", "governed", "governed_fields", "governing", "widest"]

Array = npt.NDArray[np.float64]
Fields = dict[tuple[str, str], Array]


def governing(profiles: Profiles, network: PerUnitNetwork) -> dict[str, tuple[str, ...]]:
    """Fields that govern others, by kind, unless they have their default in all components at all times."""
    changing, made = fields_with_series(profiles, network), {}
    for kind, table in network.tables.items():
        default = {field: table.kind.fields()[field].default for field in table.kind.governs}
        if any((kind, f) in changing or (table.arrays[f] != value).any() for f, value in default.items()):
            made[kind] = tuple(default)
    return made


def governed_fields(profiles: Profiles, network: PerUnitNetwork) -> set[tuple[str, str]]:
    """``(kind, field)`` pairs that depend on others in each stage, so that they are like time series."""
    return {
        (kind, quantity)
        for kind, fields in governing(profiles, network).items()
        for field in fields
        for quantity in network.tables[kind].kind.governs[field]
        if network.tables[kind].arrays[quantity].size
    }


def governed(
    series: Fields,
    profiles: Profiles,
    network: PerUnitNetwork,
    parent: Index,
    lengths: Array,
    before: Fields,
) -> Fields:
    """Series with the quantities that depend on others in each stage, ``(items, nodes)``.

    Parameters
    ----------
    series
        Fields at the nodes of a horizon.
    parent, lengths
        Node before each, -1 for none, and hours of each.
    before
        The same fields in the step before the first nodes; what is missing or NaN was as in these.
    """
    made = dict(series)
    for kind, fields in governing(profiles, network).items():
        table = network.tables[kind]
        arrays = {**table.arrays, **{field: values for (of, field), values in series.items() if of == kind}}
        known = {}
        for field in fields:
            arrays[field] = now = np.broadcast_to(arrays[field], (len(table), parent.size))
            first = before.get((kind, field), now)
            known[field] = np.where(parent >= 0, now[:, parent], np.where(np.isnan(first), now, first))
        hours = np.where(parent >= 0, 0.5 * (lengths + lengths[parent]), lengths)
        of_kind = table.kind.in_stages(arrays, known, hours)
        made |= {(kind, field): values for field, values in of_kind.items() if values.size}
    return made


def at_start(network: PerUnitNetwork) -> Fields:
    """Fields that govern others before step 0, ``(items, 1)``; NaN where they are not known."""
    return {
        (kind, field): values
        for kind, table in network.tables.items()
        for field, values in table.kind.at_start(table.arrays).items()
    }


def widest(profiles: Profiles, network: PerUnitNetwork) -> Fields:
    """Loosest limits over all steps, per unit ``(items, 1)`` by ``(kind, field)``.

    Programs are built with these limits, so that they contain a row for everything that is limited in
    any step, and no bound that is too tight in another step: the loosest of the series, and of what follows
    from any value of the fields that govern a limit.
    """
    limits = over_all_steps(profiles, network)
    out = dict(limits)
    for kind, fields in governing(profiles, network).items():
        table = network.tables[kind]
        own = {**table.arrays, **{field: values for (of, field), values in limits.items() if of == kind}}
        for field in fields:
            rules = table.kind.fields()[field].metadata
            for value in (rules["at_least"], rules["at_most"]):
                at = np.full((len(table), 1), value)
                for key, values in table.kind.in_stages({**own, field: at}, {field: at}, np.ones(1)).items():
                    if key.endswith(("_min", "_max")):
                        loosest = np.minimum if key.endswith("_min") else np.maximum
                        out[kind, key] = loosest(out.get((kind, key), own[key]), values)
    return out
