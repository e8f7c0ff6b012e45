"""Tables and networks of pandapower, which are copied instead of made anew.

pandapower makes some hundred empty tables for every network, and three times as many when it reads one from a
file, which takes longer than all else that most tests do with it. Equal declarations give equal tables.
"""

import copy
import functools
from collections.abc import Callable
from typing import Any

import pandapower.networks
from pandapower.auxiliary import pandapowerNet

_made: dict[tuple[tuple[str, str], ...], Any] = {}
_make = pandapowerNet.create_dataframes


def _create_dataframes(data: dict[str, Any]) -> dict[str, Any]:
    for name, columns in data.items():
        if isinstance(columns, dict):
            declared = tuple((column, repr(dtype)) for column, dtype in columns.items())
            if declared not in _made:
                _made[declared] = _make({name: columns})[name]
            data[name] = _made[declared].copy()
    return data


pandapowerNet.create_dataframes = staticmethod(_create_dataframes)


@functools.cache
def _network(make: Callable[..., Any], options: tuple[tuple[str, Any], ...]) -> Any:
    return make(**dict(options))


def copied(make: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that makes each network once; a copy takes a fiftieth of the time."""

    @functools.wraps(make)
    def again(**options: Any) -> Any:
        return copy.deepcopy(_network(make, tuple(options.items())))

    return again


def example(name: str, **options: Any) -> Any:
    """Return a network that comes with pandapower."""
    made = copied(getattr(pandapower.networks, name))(**options)
    return made[0] if isinstance(made, tuple) else made
