"""Network files: read and written through powerio, MATPOWER's checked word by word before."""

from opfmodel.network.cases.read import read_network
from opfmodel.network.cases.write import write_network

__all__ = ["read_network", "write_network"]
