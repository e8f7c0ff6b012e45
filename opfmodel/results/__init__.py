"""Results: labelled arrays, files and figures."""

from opfmodel.results.dataset import dataset
from opfmodel.results.store import finite, load, remove_temporaries, replace, save

__all__ = ["dataset", "finite", "load", "remove_temporaries", "replace", "save"]
