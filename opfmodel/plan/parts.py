"""The formulation and the devices of a problem, and the quantities that they publish."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from opfmodel import plugins
from opfmodel.errors import ModelError, PluginError, shown
from opfmodel.formulations.base import Formulation
from opfmodel.horizon import Horizon
from opfmodel.model import Device, Model
from opfmodel.network.arrays import PerUnitNetwork

__all__ = ["absent_devices", "make_devices", "make_formulation", "publishing"]

_WIRED = ("bus", "branch", "shunt")  # kinds that formulations declare


def make_formulation(formulation: str | Formulation) -> Formulation:
    """Return a formulation, given by name or as an instance."""
    if isinstance(formulation, Formulation):
        return formulation
    if not isinstance(formulation, str):
        raise ModelError(f"formulation = {formulation!r}: must be a name such as 'ac', or a formulation")
    made = plugins.load("formulation", formulation)()
    assert isinstance(made, Formulation)
    return made


def make_devices(network: PerUnitNetwork, given: Iterable[Device] = ()) -> list[Device]:
    """Return the devices of a network: one per kind that has components and is not declared by formulations.

    Those without a bus come last, for they refer to the quantities of others.
    """
    by_kind = {}
    for device in given:
        if not isinstance(device, Device):
            raise ModelError(f"devices: {shown(device)}: must be a Device")
        by_kind[device.component.kind] = device
    present = [kind for kind, table in network.tables.items() if kind not in _WIRED and len(table)]
    present.sort(key=lambda kind: not network.tables[kind].kind.bus_fields())
    return [by_kind[kind] if kind in by_kind else plugins.load("device", kind)() for kind in present]


def absent_devices(network: PerUnitNetwork) -> list[Device]:
    """Return the devices of the known kinds without components in service; their quantities are empty."""
    return [
        plugins.load("device", kind)()
        for kind, table in network.tables.items()
        if kind not in _WIRED and not len(table) and kind in plugins.plugins("device")
    ]


def publishing(quantities: Sequence[str], network: PerUnitNetwork, devices: Sequence[Device]) -> list[str]:
    """Return the formulations that, with the devices of a network, publish the given quantities."""
    of_devices = {reactive: _of_devices(network, devices, reactive) for reactive in (False, True)}
    able = []
    for name, plugin in plugins.plugins("formulation").items():
        try:
            known = plugin.load()
        except PluginError:
            continue  # "opfmodel list" reports it
        published = {*getattr(known, "publishes", ()), *of_devices[bool(getattr(known, "reactive", True))]}
        if published.issuperset(quantities):
            able.append(name)
    return able


def _of_devices(network: PerUnitNetwork, devices: Sequence[Device], reactive: bool) -> set[str]:
    """Return the quantities that devices publish with or without reactive power."""
    model = Model(network, Horizon.chain(1), reactive=reactive, zones=np.arange(len(network.bus)))
    for device in devices:
        model.connect(device)
    return set(model.published)
