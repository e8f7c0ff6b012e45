"""Time series: what they are (:class:`Profiles`), and the rules that make them, one file each."""

from opfmodel.data.series import Profiles
from opfmodel.profiles.base import ProfileRule

__all__ = ["ProfileRule", "Profiles"]
