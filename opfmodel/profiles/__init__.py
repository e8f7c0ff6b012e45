"""Profile rules, one file each, which build the :class:`opfmodel.data.series.Profiles` of a scenario."""

from opfmodel.data.series import Profiles
from opfmodel.profiles.base import ProfileRule

__all__ = ["ProfileRule", "Profiles"]
