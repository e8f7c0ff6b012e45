"""Reading the files named on the command line, with the overrides of its options."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from opfmodel.errors import OpfmodelError, ScenarioError

if TYPE_CHECKING:
    from opfmodel.network import Network
    from opfmodel.scenario import Scenario
    from opfmodel.scenario.document import Document

__all__ = ["check_on_infeasible", "is_scenario", "read_network_file", "read_scenario", "refuse_lossy"]


def is_scenario(file: Path) -> bool:
    """Whether the suffix of a file is that of a scenario or study; any other file is a network."""
    return file.suffix.lower() in (".yaml", ".yml")


def read_scenario(
    file: Path | Document,
    variant: str | None = None,
    overrides: list[str] | None = None,
    changes: Mapping[str, tuple[str, Any]] | None = None,
) -> Scenario:
    """Read a scenario with the overrides of ``--set`` and of other options.

    Parameters
    ----------
    overrides
        Arguments of ``--set``, such as ``controller.horizon=24``.
    changes
        Name and value of other options, by the key of the scenario that they override.

    Raises
    ------
    ScenarioError
        As for :func:`opfmodel.scenario.load_scenario`; an error that an option causes cites the option.
    """
    from opfmodel.data.yaml import parse
    from opfmodel.scenario import load_scenario
    from opfmodel.scenario.document import read_document

    if isinstance(file, Path) and not is_scenario(file):
        raise OpfmodelError(f"{file}: is not a scenario file; its name must end in .yaml or .yml")
    options: dict[str, tuple[str, Any]] = {}
    for item in overrides or []:
        key, equals, text = item.partition("=")
        if not equals or not key:
            raise OpfmodelError(f"--set {item}: must be KEY=VALUE, such as controller.horizon=24")
        options[key] = "--set", parse(text, f"--set {key}")[0]
    options |= changes or {}
    document = read_document(file) if isinstance(file, Path) else file
    values = {key: value for key, (_, value) in options.items()}
    try:
        return load_scenario(document, variant, values)
    except ScenarioError as error:
        option = _culprit(document, variant, values, str(error))
        if option is None:
            raise
        load_scenario(replace(document, origin=options[option][0]), variant, values)
        raise


def _culprit(document: Document, variant: str | None, values: Mapping[str, Any], message: str) -> str | None:
    """Return the key of the override without which a scenario does not raise an error of this message."""
    from opfmodel.scenario import load_scenario
    from solvers import SolverError

    for key in values:
        others = {other: value for other, value in values.items() if other != key}
        try:
            with warnings.catch_warnings(action="ignore"):  # they have been shown
                load_scenario(document, variant, others)
        except (OpfmodelError, SolverError) as error:
            if str(error) == message:
                continue
        return key
    return None


def read_network_file(file: Path, default_cost: float | None, lossy: bool = False) -> Network:
    """Read a network; generators without cost data take the default cost, $/MWh.

    Parameters
    ----------
    lossy
        Whether what opfmodel does not represent is lost with a warning instead of refused.
    """
    from opfmodel.network.cases import read_network
    from opfmodel.network.costs import Polynomial

    cost = None if default_cost is None else Polynomial(0.0, default_cost, 0.0)
    return read_network(file, default_cost=cost, lossy=lossy)


def refuse_lossy(file: Path, lossy: bool) -> None:
    """Raise :class:`OpfmodelError` for the option ``--lossy`` with a scenario, which has a key for it."""
    if lossy:
        raise OpfmodelError(
            f"{file}: --lossy applies to network files only; use --set network.lossy=true for a scenario"
        )


def check_on_infeasible(value: str | None) -> None:
    """Raise an error for a value that ``--on-infeasible`` does not accept."""
    if value not in (None, "stop", "elastic"):
        raise OpfmodelError(f"--on-infeasible {value}: must be stop or elastic")
