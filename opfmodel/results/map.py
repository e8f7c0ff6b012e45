"""Map of a network, as a figure in a file."""

from __future__ import annotations

import io
from pathlib import Path

from opfmodel.data.writing import replace
from opfmodel.errors import ResultError
from opfmodel.network.components import Bus
from opfmodel.network.inspection import topology
from opfmodel.network.layout import MOST_BUSES, positions
from opfmodel.network.network import Network

__all__ = ["save_map"]

_FORMATS = (".png", ".pdf", ".svg")


def save_map(network: Network, path: Path) -> None:
    """Save a map of the buses and branches in service, with buses coloured by nominal voltage.

    Raises
    ------
    ResultError
        The format is unknown, the network has no bus or too many, or the file cannot be written.
    """
    graph = topology(network)
    if path.suffix.lower() not in _FORMATS:
        raise ResultError(f"{path}: a map can be saved as {', '.join(_FORMATS)}")
    if not 1 <= len(graph) <= MOST_BUSES:
        raise ResultError(f"{path}: {len(graph):,} buses; a map is drawn of 1 to {MOST_BUSES:,}")
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    placed = positions(graph)
    figure = Figure(figsize=(8, 8), layout="constrained")
    axes = figure.subplots()
    lines = [(placed[one], placed[other]) for one, other in graph.edges()]
    axes.add_collection(LineCollection(lines, colors="0.6", linewidths=0.8, zorder=1))
    kv = {bus: network.of(Bus)[bus].base_kv for bus in graph}
    size = min(60.0, 4000.0 / len(graph))
    for level in sorted(set(kv.values()), key=lambda value: -1.0 if value is None else value, reverse=True):
        spots = [placed[bus] for bus in graph if kv[bus] == level]
        label = "unknown voltage" if level is None else f"{level:g} kV"
        xs, ys = zip(*spots, strict=True)
        axes.scatter(xs, ys, s=size, label=label, zorder=2)
    if len(graph) <= 60:
        for bus, place in placed.items():
            axes.annotate(bus, place, xytext=(4, 4), textcoords="offset points", fontsize=7)
    axes.set_title(network.name)
    axes.set_axis_off()
    axes.legend(loc="best", fontsize=8)
    drawn = io.BytesIO()
    figure.savefig(drawn, format=path.suffix.lower().removeprefix("."), dpi=150)
    try:
        replace({path: drawn.getvalue()})
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise ResultError(
            f"{path}: cannot be written: {getattr(error, 'strerror', None) or error}"
        ) from error
