"""Results: labelled arrays, files and figures."""

from opfmodel.results.dataset import dataset, labelled
from opfmodel.results.limits import binding
from opfmodel.results.store import finite, load, save

__all__ = ["binding", "dataset", "finite", "labelled", "load", "save"]
