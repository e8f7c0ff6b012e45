"""Reading of network files with powerio: MATPOWER, PSS/E and all formats without a reader of their own."""

from opfmodel.network.cases.powerio.read import read_powerio

__all__ = ["read_powerio"]
