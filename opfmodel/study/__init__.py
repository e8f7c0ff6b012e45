"""Studies: a scenario over a grid of variations, run in parallel processes and resumable.

``docs/studies.md`` describes the study file and the results folder.
"""

from opfmodel.study.document import Axis, Study, read_study
from opfmodel.study.execution import Record, execute
from opfmodel.study.runner import Outcome, run_study
from opfmodel.study.specification import Specification
from opfmodel.study.store import read_run, read_table
from opfmodel.study.table import Group, Statistics, aggregate, shown_columns

__all__ = [
    "Axis",
    "Group",
    "Outcome",
    "Record",
    "Specification",
    "Statistics",
    "Study",
    "aggregate",
    "execute",
    "read_run",
    "read_study",
    "read_table",
    "run_study",
    "shown_columns",
]
