"""Reports: pages of HTML that need nothing but a browser."""

from opfmodel.results.report.comparison import comparison_page
from opfmodel.results.report.run import report_page

__all__ = ["comparison_page", "report_page"]
