"""Plugins: how those of this package and of others are found, and what is installed."""

from opfmodel.plugins.registry import GROUPS, Plugin, hidden, load, make, plugins, rescan

__all__ = ["GROUPS", "Plugin", "hidden", "load", "make", "plugins", "rescan"]
