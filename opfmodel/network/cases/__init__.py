"""Network files, read and written with powerio; MATPOWER files are checked strictly beforehand."""

from opfmodel.network.cases.pandapower import from_pandapower
from opfmodel.network.cases.pypsa import from_pypsa
from opfmodel.network.cases.read import read_network
from opfmodel.network.cases.write import write_network

__all__ = ["from_pandapower", "from_pypsa", "read_network", "write_network"]
