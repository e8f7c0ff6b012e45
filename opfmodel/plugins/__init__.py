"""Discovery and loading of plugins from this and other packages."""

from opfmodel.plugins.registry import GROUPS, Plugin, hidden, load, make, plugins, rescan

__all__ = ["GROUPS", "Plugin", "hidden", "load", "make", "plugins", "rescan"]
