"""Reading the files named on the command line, with the overrides of its options."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from opfmodel.errors import OpfmodelError

if TYPE_CHECKING:
    from opfmodel.network import Network
    from opfmodel.scenario import Scenario
    from opfmodel.scenario.document import Document

__all__ = ["check_on_infeasible", "is_scenario", "read_network_file", "read_scenario"]


def is_scenario(file: Path) -> bool:
    """Whether the suffix of a file is that of a scenario or study; any other file is a network."""
    return file.suffix.lower() in (".yaml", ".yml")


def read_scenario(
    file: Path | Document,
    variant: str | None = None,
    overrides: list[str] | None = None,
    changes: Mapping[str, Any] | None = None,
) -> Scenario:
    """Read a scenario with the overrides of ``--set`` and of other options, by key."""
    from opfmodel.data.yaml import parse
    from opfmodel.scenario import load_scenario

    if isinstance(file, Path) and not is_scenario(file):
        raise OpfmodelError(f"{file}: is not a scenario file; its name must end in .yaml or .yml")
    values: dict[str, Any] = {}
    for item in overrides or []:
        key, equals, text = item.partition("=")
        if not equals or not key:
            raise OpfmodelError(f"--set {item}: must be KEY=VALUE, such as controller.horizon=24")
        values[key], _ = parse(text, f"--set {key}")
    return load_scenario(file, variant, {**values, **(changes or {})})


def read_network_file(file: Path, default_cost: float | None) -> Network:
    """Read a network; generators without cost data take the default cost, $/MWh."""
    from opfmodel.network.cases import read_network
    from opfmodel.network.costs import Polynomial

    return read_network(
        file, default_cost=None if default_cost is None else Polynomial(0.0, default_cost, 0.0)
    )


def check_on_infeasible(value: str | None) -> None:
    """Raise an error for a value that ``--on-infeasible`` does not accept."""
    if value not in (None, "stop", "elastic"):
        raise OpfmodelError(f"--on-infeasible {value}: must be stop or elastic")
