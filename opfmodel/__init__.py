"""Declarative multi-stage AC optimal power flow with storage over a receding horizon.

>>> import opfmodel as om
>>> grid = om.Network("one-bus")
>>> grid.bus = om.Bus()
>>> grid.unit = om.Generator("bus", p=(0, 100), cost=om.Polynomial(0, 20, 0))
>>> grid.town = om.Load("bus", p=50)
>>> plan = om.MultiStage(grid, horizon=2).solve()
>>> plan.status
'globally_optimal'
"""

from typing import Any

import lazy_loader

# The public names are listed in __init__.pyi only. Each is imported on first use to keep this import fast.
_attribute, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("opfmodel")
    return _attribute(name)
