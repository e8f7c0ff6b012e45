"""The moments of a dataset that a page shows: all of them, or every second, third and so on of many."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from opfmodel.data.calendar import shown_in, zone_of

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["MOST_VALUES", "Moments"]

Array = npt.NDArray[np.float64]

MOST_VALUES = 100_000  # of one array; a page of ten such arrays has some 6 MB
_MOST, _LEAST = 1_000, 24


@dataclass(frozen=True)
class Moments:
    """The moments that are shown of a dataset over ``time``.

    Attributes
    ----------
    stride
        Distance between the moments that are shown, in stages.
    """

    data: xr.Dataset
    stride: int

    @classmethod
    def of(cls, data: xr.Dataset) -> Moments:
        """Return so few moments that the values of all buses or branches at them fit into a page."""
        items = max(data.sizes.get("bus", 1), data.sizes.get("branch", 1))
        wanted = min(max(MOST_VALUES // items, _LEAST), _MOST)
        return cls(data, max(1, math.ceil(data.sizes["time"] / wanted)))

    @property
    def note(self) -> str:
        """What is left out, as a sentence; empty if nothing is."""
        if self.stride == 1:
            return ""
        return (
            f"Charts show every {_ordinal(self.stride)} of {self.data.sizes['time']:,} stages; "
            "figures in short and tables are of all."
        )

    def values(self, name: str) -> Array:
        """Return a quantity at the moments, ``(items, moments)`` or ``(moments,)``; constant ones repeat."""
        array = self.data[name]
        if "time" not in array.dims:
            return np.repeat(array.values[:, None].astype(float), len(self.labels), axis=1)
        return np.asarray(array.transpose(..., "time").values[..., :: self.stride], dtype=float)

    def name(self, stage: int) -> str:
        """Name any stage of the data, also one that is not shown, by its beginning."""
        time = self.data["time"].values[stage]
        return shown_in(time, self._zone) if self.dated else f"hour {time:g}"

    @cached_property
    def labels(self) -> list[str]:
        """The beginnings of the stages that are shown, as text."""
        return [self.name(stage) for stage in range(0, self.data.sizes["time"], self.stride)]

    @cached_property
    def axis(self) -> list[Any]:
        """The beginnings of the stages, and the end of the last: hours, or local times."""
        times = self.data["time"].values
        last: Any = float(self.data.attrs.get("step_hours", 1.0))
        if "hours" in self.data.coords:
            last = float(self.data["hours"].values[-1])
        if not self.dated:
            return [*times[:: self.stride].tolist(), float(times[-1]) + last]
        end = times[-1] + np.timedelta64(round(3_600_000_000_000 * last), "ns")
        zone = zone_of(self._zone)
        stamps = np.append(times[:: self.stride], end).astype("datetime64[us]").tolist()
        from datetime import UTC

        local = (stamp.replace(tzinfo=UTC).astimezone(zone) for stamp in stamps)
        return [stamp.strftime("%Y-%m-%d %H:%M:%S") for stamp in local]

    @property
    def title(self) -> str:
        """Title of the axis of time."""
        return f"time [{self._zone}]" if self.dated else "time [h]"

    @property
    def dated(self) -> bool:
        """Whether the stages have time stamps."""
        return bool(np.issubdtype(self.data["time"].dtype, np.datetime64))

    @property
    def _zone(self) -> str:
        return str(self.data["time"].attrs.get("zone", "UTC"))


def _ordinal(number: int) -> str:
    ends = {1: "st", 2: "nd", 3: "rd"}
    teen = number % 100 in (11, 12, 13)
    return f"{number}{'th' if teen else ends.get(number % 10, 'th')}"
