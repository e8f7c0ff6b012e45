"""Time series: what they are (:class:`Profiles`), and the rules that make them, one file each."""

from opfmodel.profiles.base import ProfileRule
from opfmodel.profiles.series import Profiles

__all__ = ["ProfileRule", "Profiles"]
