"""Time series of a network: which fields accept one, checks of its values, and per-unit windows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from opfmodel.data.series import Profiles, SeriesKey
from opfmodel.errors import ProfileError, nearest, raise_all
from opfmodel.network.arrays import PerUnitNetwork, Table
from opfmodel.network.bounds import LARGEST
from opfmodel.network.component import Component
from opfmodel.network.network import Network
from opfmodel.network.units import scale

__all__ = [
    "check_finite",
    "check_series",
    "faults_of_keys",
    "fields_with_series",
    "over_all_steps",
    "window",
]

Array = npt.NDArray[np.float64]
Fields = dict[tuple[str, str], Array]


def check_series(profiles: Profiles, network: Network) -> None:
    """Raise :class:`ProfileError` for a series of a field that cannot vary, or with an invalid value.

    Values must be finite and satisfy the rules of the field; for example, bounds must not cross and a
    rating must be at least 0.
    """
    check_finite(profiles, network)
    raise_all(
        ProfileError(f"profile '{key}': {fault}", key) for key, fault in faults_of_keys(profiles, network)
    )
    for key in profiles:
        _check_rules(profiles, network[key.component], key)


def faults_of_keys(keys: Iterable[SeriesKey], network: Network) -> Iterator[tuple[SeriesKey, str]]:
    """Yield the keys that no time series can have, with the reason."""
    for key in keys:
        if key.component not in network:
            yield key, f"the network has no component {key.component!r}; {nearest(key.component, network)}"
        elif fault := _fault_of_field(network[key.component], key):
            yield key, fault


def _fault_of_field(component: Component, key: SeriesKey) -> str:
    """Return why a field cannot have a time series; empty if it can."""
    known, fixed = component.table_fields(), [*component.bus_fields(), "in_service"]
    if key.field in fixed or (key.field in known and not known[key.field].series):
        return f"the {key.field} of a {component.kind} is constant; it cannot have a time series"
    if key.field in component.numbers:
        return ""
    if key.field in known and component.of_cost:
        numbers = ", ".join(component.of_cost)
        return f"the cost of {key.component!r} is piecewise linear; its numbers are {numbers}"
    try:
        component.constant(key.field)
    except ProfileError as error:
        return str(error)
    return ""


def check_finite(profiles: Profiles, network: Network) -> None:
    """Raise :class:`ProfileError` for a value that is not a finite number.

    Infinity is accepted where it means "no limit": ``rating``, ``ramp``, and the reactive limits of
    generators.
    """
    for key, values in profiles.items():
        wrong = ~(np.abs(values) <= LARGEST)  # true for NaN as well
        if not wrong.any():
            continue
        unlimited = network[key.component].unlimited(key.field) if key.component in network else None
        if unlimited is not None:
            wrong &= values != unlimited
        if wrong.any():
            step = int(np.argmax(wrong))
            also = "" if unlimited is None else f", or {unlimited:g} for no limit"
            raise ProfileError(
                f"profile '{key}': step {step}: {values[step]:g}: must be a finite number "
                f"of at most {LARGEST:g}{also}",
                key,
                step,
            )


def _check_rules(profiles: Profiles, component: Component, key: SeriesKey) -> None:
    """Raise :class:`ProfileError` if a series breaks a rule of its field."""
    values = profiles[key]

    def refuse(broken: npt.NDArray[np.bool_], rule: str, other: Array | None = None) -> None:
        if broken.any():
            step = int(np.argmax(broken))
            more = "" if other is None else f" {other[step]:g}"
            raise ProfileError(
                f"profile '{key}': step {step}: {values[step]:g}: must be {rule}{more}", key, step
            )

    item = component.fields().get(key.field)
    if item is not None and item.metadata["form"] == "number":
        rules = item.metadata
        refuse(values < rules["at_least"], f"at least {rules['at_least']:g}")
        refuse(values <= rules["above"], f"greater than {rules['above']:g}")
        refuse(values > rules["at_most"], f"at most {rules['at_most']:g}")
    if key.field == "c2":
        refuse(values < 0, "at least 0 because costs must be convex")
    for other, below in _other_ends(component, key.field):
        bound = profiles.get(SeriesKey(key.component, other))
        steps = len(values) if bound is None else min(len(values), len(bound))
        ends = np.full(steps, component.constant(other)) if bound is None else bound[:steps]
        crossed = values[:steps] > ends if below else values[:steps] < ends
        refuse(crossed, f"at {'most' if below else 'least'} {other} =", ends)


def _other_ends(component: Component, field: str) -> Iterator[tuple[str, bool]]:
    """Fields that bound a field from the other side, and whether they must be above it."""
    known = component.fields()
    stem, _, end = field.rpartition("_")
    if end in ("min", "max") and stem in known and known[stem].metadata["form"] == "span":
        yield (f"{stem}_max", True) if end == "min" else (f"{stem}_min", False)
    # slopes of a convex cost do not decrease
    slopes = [key for key in component.of_cost if key not in component.table_fields()]
    for low, high in (*component.ordered(), *pairwise(slopes)):
        if field == low:
            yield high, True
        elif field == high:
            yield low, False


# Arrays -------------------------------------------------------------------------------------------


def fields_with_series(profiles: Profiles, network: PerUnitNetwork) -> set[tuple[str, str]]:
    """``(kind, field)`` pairs for which a component in service has a series."""
    return {(placed.kind, placed.field) for placed in _placed(profiles, network)}


def over_all_steps(profiles: Profiles, network: PerUnitNetwork) -> Fields:
    """Loosest values of the series of limits, per unit ``(items, 1)`` by ``(kind, field)``.

    Steps in which a limit is infinite are disregarded if other steps have a finite limit.
    """
    out: Fields = {}
    for _, kind, field, position, values in _placed(profiles, network):
        table = network.tables[kind]
        item = table.kind.fields().get(field)
        if not field.endswith(("_min", "_max")) and not (item and item.metadata.get("optional")):
            continue
        limits = out.setdefault((kind, field), table.arrays[field].copy())
        own = np.append(values / scale(table.units[field], network.base_mva), limits[position])
        own = own[np.isfinite(own)]
        if own.size:
            limits[position] = own.min() if field.endswith("_min") else own.max()
    return out


def window(
    profiles: Profiles, network: PerUnitNetwork, start: int, stages: int, repeats: bool = False
) -> Fields:
    """Per-unit arrays ``(items, stages)`` by ``(kind, field)`` for the ``stages`` steps from ``start``.

    Components without a time series keep their constant value.

    Parameters
    ----------
    repeats
        Whether series begin again after their end.

    Raises
    ------
    ProfileError
        A series ends before the window.
    """
    out: Fields = {}
    steps = np.arange(start, start + stages)
    for key, kind, field, position, values in _placed(profiles, network):
        if len(values) < start + stages and not repeats:
            raise ProfileError(
                f"profile '{key}': has {len(values)} values; "
                f"steps {start} to {start + stages - 1} need {start + stages}",
                key,
            )
        table = network.tables[kind]
        if (kind, field) not in out:
            out[kind, field] = np.repeat(table.arrays[field], stages, axis=1)
        factor = scale(table.units[field], network.base_mva)
        out[kind, field][position] = values[steps % len(values)] / factor
    return out


class _Placed(NamedTuple):
    """A series, and the row of the arrays that it replaces."""

    key: SeriesKey
    kind: str
    field: str
    position: int
    values: Array


def _placed(profiles: Profiles, network: PerUnitNetwork) -> Iterator[_Placed]:
    """Series of components in service, with the rows of the arrays that follow from them."""
    bent: dict[str, Table] = {}
    for key, values in profiles.items():
        for kind, table in network.tables.items():
            if key.component in table.position:
                if key.field in table.arrays:
                    yield _Placed(key, kind, key.field, table.position[key.component], values)
                else:
                    bent[key.component] = table
                break
    for name, table in bent.items():
        yield from _segments(profiles, table, name)


def _segments(profiles: Profiles, table: Table, name: str) -> Iterator[_Placed]:
    r"""Lines of a piecewise-linear cost with series of slopes; see :class:`PiecewiseLinear`.

    The cost at the first point stays, and it is continuous where segment i begins, at :math:`p_i`:

    .. math::
        b_1(t) = b_1 + (a_1 - a_1(t))\, p_1, \quad b_{i+1}(t) = b_i(t) + (a_i(t) - a_{i+1}(t))\, p_{i+1}
    """
    rows = np.flatnonzero(table.segment_owner == table.position[name])
    keys = [SeriesKey(name, f"slope_{number}") for number in range(1, rows.size + 1)]
    shortest = min((key for key in keys if key in profiles), key=lambda key: len(profiles[key]))
    steps = len(profiles[shortest])
    declared = table.segment_slope[rows] * scale("$/MWh", table.base_mva)
    slopes = np.repeat(declared, steps, axis=1)
    for own, key in zip(slopes, keys, strict=True):
        if key in profiles:
            own[:] = profiles[key][:steps]
    begin = table.segment_begin[rows] * table.base_mva
    moves = np.vstack([declared[:1] - slopes[:1], slopes[:-1] - slopes[1:]]) * begin
    offsets = table.segment_offset[rows[0]] + np.cumsum(moves, axis=0)
    for row, slope, offset in zip(rows.tolist(), slopes, offsets, strict=True):
        yield _Placed(shortest, table.kind.kind, "segment_slope", row, slope)
        yield _Placed(shortest, table.kind.kind, "segment_offset", row, offset)
