"""Time series of component fields: demand, availability, prices, ratings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.components import Component, Network, PiecewiseLinear
from opfmodel.errors import ProfileError, nearest
from opfmodel.network import PerUnitNetwork
from opfmodel.profiles.base import constant
from opfmodel.units import LARGEST, scale

__all__ = ["Profiles"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Profiles:
    """Values of some fields of some components over time, in physical units.

    Attributes
    ----------
    series
        By component name and field of its table (``p`` of a load, ``p_max`` or ``c1`` of a
        generator, ``rating`` of a branch), one value per time step.

    Examples
    --------
    >>> Profiles.of({"town.p": [90, 95, 120], "wind.p_max": [30, 0, 10]}).length
    3
    """

    series: Mapping[tuple[str, str], Array] = field(default_factory=dict)

    @classmethod
    def of(cls, series: Mapping[str, npt.ArrayLike] | Profiles | None) -> Profiles:
        """Profiles from ``{"component.field": values}``.

        Raises
        ------
        ProfileError
            A key without a field, or values that are not a vector of numbers.
        """
        if isinstance(series, Profiles):
            return series
        if series is not None and not isinstance(series, Mapping):
            raise ProfileError(f"profiles = {series!r}: must be a mapping {{'component.field': values}}")
        made: dict[tuple[str, str], Array] = {}
        for key, values in (series or {}).items():
            component, dot, name = str(key).rpartition(".")
            if not dot or not component:
                raise ProfileError(f"profile {key!r}: write 'component.field', for instance 'town.p'")
            made[component, name] = _vector(key, values)
        return cls(made)

    @property
    def named(self) -> dict[str, Array]:
        """The series by ``"component.field"``, as :meth:`of` and :func:`opfmodel.check.check` take them."""
        return {f"{name}.{key}": values for (name, key), values in self.series.items()}

    @property
    def length(self) -> int | None:
        """Number of time steps that every series covers; None if there are no series."""
        return min((len(v) for v in self.series.values()), default=None)

    def without(self, components: Iterable[str]) -> Profiles:
        """These profiles without those of some components."""
        left_out = set(components)
        return Profiles({key: v for key, v in self.series.items() if key[0] not in left_out})

    def fields(self, network: PerUnitNetwork) -> set[tuple[str, str]]:
        """The ``(kind, field)`` pairs of which some component has a series."""
        return {
            (self._find(network, name)[0], key)
            for name, key in self.series
            if self._in_service(network, name)
        }

    def check(self, network: Network, arrays: PerUnitNetwork) -> None:
        """Raise :class:`ProfileError` if a series is of nothing that may change, or breaks a rule.

        The rules are those of the fields: bounds do not cross, a rating is at least 0. Values are finite.
        """
        self.check_finite(network)
        for name, key in self.series:
            if name not in network:
                raise ProfileError(f"profile '{name}.{key}': no such component; {nearest(name, network)}")
            kind = network[name].kind
            numeric = [f for f, unit in arrays.tables[kind].units.items() if not f.startswith("segment_")]
            if key not in numeric:
                raise ProfileError(
                    f"profile '{name}.{key}': a {kind} has no such field; {nearest(key, numeric)}"
                )
            if key in ("c2", "c1", "c0") and isinstance(
                getattr(network[name], "cost", None), PiecewiseLinear
            ):
                raise ProfileError(f"profile '{name}.{key}': the cost of {name!r} is piecewise linear")
            known = arrays.tables[kind].kind.fields()
            item = known.get(key, known.get(key.removesuffix("_min").removesuffix("_max")))
            if item is not None and not item.metadata.get("series", True):
                raise ProfileError(
                    f"profile '{name}.{key}': the {key} of a {kind} is the same in all steps; "
                    "it cannot have a time series"
                )
            self._check_values(network, name, key)

    def check_finite(self, network: Network) -> None:
        """Raise :class:`ProfileError` for a value that is not a finite number.

        Infinity is accepted where a field says by it that there is no limit: ``rating``, ``ramp``, and
        the reactive limits of generators.
        """
        for (name, key), values in self.series.items():
            wrong = ~(np.abs(values) <= LARGEST)  # not a number is wrong, too
            if not wrong.any():
                continue
            unlimited = network[name].unlimited(key) if name in network else None
            if unlimited is not None:
                wrong &= values != unlimited
            if wrong.any():
                step = int(np.argmax(wrong))
                also = "" if unlimited is None else f", or {unlimited:g} for no limit"
                raise ProfileError(
                    f"profile '{name}.{key}': step {step}: {values[step]:g}: must be a finite number "
                    f"of at most {LARGEST:g}{also}",
                    f"{name}.{key}",
                    step,
                )

    def _check_values(self, network: Network, name: str, key: str) -> None:
        """Hold one series to the rules of its field."""
        component, values = network[name], self.series[name, key]

        def refuse(broken: npt.NDArray[np.bool_], rule: str, other: Array | None = None) -> None:
            if broken.any():
                step = int(np.argmax(broken))
                more = "" if other is None else f" {other[step]:g}"
                raise ProfileError(
                    f"profile '{name}.{key}': step {step}: {values[step]:g}: must be {rule}{more}",
                    f"{name}.{key}",
                    step,
                )

        item = component.fields().get(key)
        if item is not None and item.metadata["form"] == "number":
            rules = item.metadata
            refuse(values < rules["at_least"], f"at least {rules['at_least']:g}")
            refuse(values <= rules["above"], f"greater than {rules['above']:g}")
            refuse(values > rules["at_most"], f"at most {rules['at_most']:g}")
        if key == "c2":
            refuse(values < 0, "at least 0, for costs are convex")
        for other, below in _other_ends(component, key):
            steps = min(len(values), len(self.series.get((name, other), values)))
            constants = np.full(steps, constant(component, other))
            ends = self.series.get((name, other), constants)[:steps]
            crossed = values[:steps] > ends if below else values[:steps] < ends
            refuse(crossed, f"at {'most' if below else 'least'} {other} =", ends)

    def widest(self, network: PerUnitNetwork) -> dict[tuple[str, str], Array]:
        """Limits that contain those of every step, per unit ``(items, 1)`` by ``(kind, field)``.

        A program is stated with them, so that it has a row for whatever is limited at some step
        and no bound that cuts off another. A limit that is absent from some steps only counts by
        those that have it.
        """
        out: dict[tuple[str, str], Array] = {}
        for (name, key), values in self.series.items():
            if not self._in_service(network, name):
                continue
            kind, position = self._find(network, name)
            table = network.tables[kind]
            item = table.kind.fields().get(key)
            if not key.endswith(("_min", "_max")) and not (item and item.metadata.get("optional")):
                continue
            constant = out.setdefault((kind, key), np.array(table.arrays[key], dtype=float))
            own = np.append(values / scale(table.units[key], network.base_mva), constant[position])
            own = own[np.isfinite(own)]
            if own.size:
                constant[position] = own.min() if key.endswith("_min") else own.max()
        return out

    def window(self, network: PerUnitNetwork, start: int, stages: int) -> dict[tuple[str, str], Array]:
        """Per-unit arrays ``(items, stages)`` by ``(kind, field)`` for the steps from ``start``.

        Components without a series of their own keep their constant value.

        Raises
        ------
        ProfileError
            A series ends before the window does.
        """
        out: dict[tuple[str, str], Array] = {}
        for (name, key), values in self.series.items():
            if not self._in_service(network, name):
                continue
            if len(values) < start + stages:
                raise ProfileError(
                    f"profile '{name}.{key}' has {len(values)} values; "
                    f"steps {start} to {start + stages - 1} need {start + stages}"
                )
            kind, position = self._find(network, name)
            table = network.tables[kind]
            if (kind, key) not in out:
                out[kind, key] = np.repeat(table.arrays[key], stages, axis=1)
            factor = scale(table.units[key], network.base_mva)
            out[kind, key][position] = values[start : start + stages] / factor
        return out

    @staticmethod
    def _in_service(network: PerUnitNetwork, name: str) -> bool:
        return any(name in table.position for table in network.tables.values())

    @staticmethod
    def _find(network: PerUnitNetwork, name: str) -> tuple[str, int]:
        for kind, table in network.tables.items():
            if name in table.position:
                return kind, table.position[name]
        raise ProfileError(f"no component {name!r} in service")


def _other_ends(component: Component, key: str) -> Iterator[tuple[str, bool]]:
    """The fields that bound a field from the other side, and whether they are to be above it."""
    known = component.fields()
    stem, _, end = key.rpartition("_")
    if end in ("min", "max") and stem in known and known[stem].metadata["form"] == "span":
        yield (f"{stem}_max", True) if end == "min" else (f"{stem}_min", False)
    elif end == "min" and stem in known:
        yield stem, True
    elif f"{key}_min" in known:
        yield f"{key}_min", False


def _vector(key: str, values: Any) -> Array:
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise ProfileError(f"profile {key!r}: the values must be numbers") from None
    if array.ndim != 1:
        raise ProfileError(f"profile {key!r}: one value per time step is expected, not shape {array.shape}")
    if np.isnan(array).any():
        step = int(np.argmax(np.isnan(array)))
        raise ProfileError(f"profile {key!r}: step {step} is not a number", key, step)
    return array
