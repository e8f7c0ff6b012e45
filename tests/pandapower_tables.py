"""Empty tables of pandapower, which are copied instead of made anew.

pandapower makes some hundred empty tables for every network, and three times as many when it reads one from a
file, which takes longer than all else that most tests do with it. Equal declarations give equal tables.
"""

from typing import Any

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
