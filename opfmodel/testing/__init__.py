"""Contract checks for plugins of every kind, from objectives to plants and back ends.

    >>> from opfmodel.objectives.economic import Economic
    >>> check_objective(Economic(reactive_weight=1e-3))

Like scikit-learn's ``check_estimator``, a check returns nothing or raises a :class:`ContractError`
that names the broken rule. ``docs/extending.md`` shows plugins that pass.
"""

from opfmodel.testing.devices import check_device
from opfmodel.testing.forecasts import check_forecast
from opfmodel.testing.formulations import check_formulation
from opfmodel.testing.objectives import check_objective
from opfmodel.testing.plants import check_plant
from opfmodel.testing.profiles import check_profile
from solvers.testing import ContractError, check_back_end

__all__ = [
    "ContractError",
    "check_back_end",
    "check_device",
    "check_forecast",
    "check_formulation",
    "check_objective",
    "check_plant",
    "check_profile",
]
