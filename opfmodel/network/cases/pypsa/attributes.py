"""Attributes of PyPSA's components: which are used, which mean nothing here, and which would be lost.

Every input attribute of PyPSA's own tables is in one of the groups below, which a test compares with the
installed PyPSA. An attribute in none of them, from a newer PyPSA, is a loss as soon as it has another
value than its default.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from opfmodel.errors import listed, shown
from opfmodel.network.cases.losses import Losses

__all__ = ["CLASSES", "TYPES", "Attributes", "add_losses"]


def _of(words: str) -> frozenset[str]:
    return frozenset(words.split())


_NAMED = frozenset({"name", "type", "carrier"})
_PLANNING = _of(
    "capital_cost overnight_cost discount_rate fom_cost build_year lifetime terrain_factor weight"
)
_POWER_PLANNING = frozenset({"p_nom_mod", "p_nom_min", "p_nom_max", "p_nom_set"})
_ENERGY_PLANNING = frozenset({"e_nom_mod", "e_nom_min", "e_nom_max", "e_nom_set"})
_FLOW_PLANNING = frozenset({"s_nom_mod", "s_nom_min", "s_nom_max", "s_nom_set"})
_COMMITMENT = _of(
    "start_up_cost shut_down_cost stand_by_cost min_up_time min_down_time up_time_before down_time_before "
    "ramp_limit_start_up ramp_limit_shut_down"
)
_EXTENDABLE = "its capacity is a decision; fix it with n.optimize.fix_optimal_capacities()"
_COST = "operation of a storage has no cost"
_SIGN = "the sign of its power cannot be changed"


@dataclass(frozen=True)
class Attributes:
    """Input attributes of a class of PyPSA components.

    Attributes
    ----------
    used
        Attributes that are represented, also as time series.
    constant
        Attributes that are represented if they do not vary in time.
    unused
        Attributes without effect on a network of fixed capacities, or on anything in PyPSA.
    lost
        What is lost with an attribute that differs from its default.
    whole
        What is lost with every component of the class; empty if components are represented.
    unknown
        What is lost with an attribute that is in none of these groups.
    """

    used: frozenset[str] = frozenset()
    constant: frozenset[str] = frozenset()
    unused: frozenset[str] = frozenset()
    lost: Mapping[str, str] = field(default_factory=dict)
    whole: str = ""
    unknown: str = "an attribute unknown to opfmodel"


CLASSES: Mapping[str, Attributes] = {
    "buses": Attributes(
        used=_of("name v_nom v_mag_pu_min v_mag_pu_max carrier x y"),
        constant=_of("v_mag_pu_set"),
        unused=_of("type unit location"),
    ),
    "lines": Attributes(
        used=_of("name bus0 bus1 type x r g b s_nom s_max_pu num_parallel length v_ang_min v_ang_max active"),
        unused=_PLANNING | _FLOW_PLANNING | {"carrier"},
        lost={"s_nom_extendable": _EXTENDABLE},
    ),
    "transformers": Attributes(
        used=_of(
            "name bus0 bus1 type model x r g b s_nom s_max_pu num_parallel tap_ratio tap_side tap_position "
            "phase_shift v_ang_min v_ang_max active"
        ),
        unused=_PLANNING | _FLOW_PLANNING,
        lost={"s_nom_extendable": _EXTENDABLE},
    ),
    "generators": Attributes(
        used=_of(
            "name bus control p_nom p_min_pu p_max_pu p_set sign marginal_cost marginal_cost_quadratic "
            "ramp_limit_up ramp_limit_down active"
        ),
        constant=_of("q_set"),
        # p_init and up_time_before act through ramp limits only; see the reader
        unused=_NAMED - {"name"} | _PLANNING | _POWER_PLANNING | _COMMITMENT | {"efficiency", "p_init"},
        lost={
            "p_nom_extendable": _EXTENDABLE,
            "committable": "its commitment is a decision; it is always on",
            "e_sum_min": "energy over the snapshots is not limited",
            "e_sum_max": "energy over the snapshots is not limited",
        },
    ),
    "loads": Attributes(used=_of("name bus p_set q_set sign active"), unused=_NAMED - {"name"}),
    "storage_units": Attributes(
        used=_of(
            "name bus p_nom p_min_pu p_max_pu p_set max_hours state_of_charge_initial state_of_charge_set "
            "cyclic_state_of_charge active"
        ),
        constant=_of("q_set efficiency_store efficiency_dispatch standing_loss"),
        # PyPSA reads control of generators only, spill_cost with inflow only
        unused=_NAMED - {"name"}
        | _PLANNING
        | _POWER_PLANNING
        | _of("control spill_cost state_of_charge_initial_per_period cyclic_state_of_charge_per_period"),
        lost={
            "p_nom_extendable": _EXTENDABLE,
            "inflow": "nothing flows into a storage but from its bus",
            "marginal_cost": _COST,
            "marginal_cost_quadratic": _COST,
            "marginal_cost_storage": _COST,
            "p_dispatch_set": "charging and discharging are not fixed separately",
            "p_store_set": "charging and discharging are not fixed separately",
            "sign": _SIGN,
        },
    ),
    "stores": Attributes(
        used=_of("name bus e_nom e_min_pu e_max_pu e_initial e_cyclic p_set e_set active"),
        constant=_of("q_set standing_loss"),
        unused=_NAMED - {"name"}
        | _PLANNING
        | _ENERGY_PLANNING
        | _of("e_initial_per_period e_cyclic_per_period"),
        lost={
            "e_nom_extendable": _EXTENDABLE,
            "marginal_cost": _COST,
            "marginal_cost_quadratic": _COST,
            "marginal_cost_storage": _COST,
            "sign": _SIGN,
        },
    ),
    "shunt_impedances": Attributes(used=_of("name bus g b active"), lost={"sign": _SIGN}),
    "links": Attributes(
        used=_of("name bus0 bus1 p_nom p_min_pu p_max_pu p_set marginal_cost active"),
        constant=_of("efficiency"),
        unused=_NAMED - {"name"}
        | _PLANNING
        | _POWER_PLANNING
        | _COMMITMENT
        | _of("length p_init cyclic_delay"),
        lost={
            "p_nom_extendable": _EXTENDABLE,
            "committable": "its commitment is a decision; it is always on",
            "marginal_cost_quadratic": "the cost of a DC line is linear",
            "ramp_limit_up": "the power of a DC line has no ramp limit",
            "ramp_limit_down": "the power of a DC line has no ramp limit",
            "delay": "what a DC line sends arrives at once",
        },
        unknown="unknown to opfmodel, whose DC lines have two ends",
    ),
    "processes": Attributes(whole="no component converts power between buses"),
    "global_constraints": Attributes(whole="add it as a Budget, or with MultiStage.constrain"),
    # without effect unless another component refers to them
    "carriers": Attributes(unused=_of("name co2_emissions color nice_name max_growth max_relative_growth")),
    "line_types": Attributes(
        used=_of("name f_nom r_per_length x_per_length c_per_length"),
        unused=_of("i_nom mounting cross_section references"),
    ),
    "transformer_types": Attributes(
        used=_of("name s_nom vsc vscr pfe i0 phase_shift tap_side tap_neutral tap_step"),
        unused=_of("f_nom v_nom_0 v_nom_1 tap_min tap_max references"),
    ),
    "shapes": Attributes(unused=_of("name geometry component idx type")),
    "sub_networks": Attributes(),
}
TYPES = ("carriers", "line_types", "transformer_types", "shapes", "sub_networks")
"""Classes that inject and carry nothing themselves."""


def add_losses(n: Any, kept: Mapping[str, list[str]], losses: Losses) -> None:
    """Report what the attributes of the active components of a network lose.

    Parameters
    ----------
    n
        A ``pypsa.Network``.
    kept
        Names of the active components at buses that are represented, by class.
    """
    for components in n.components:
        known = CLASSES.get(components.list_name, Attributes(whole="a class unknown to opfmodel"))
        names = kept.get(components.list_name, [])
        kind = components.name
        if known.whole and names:
            losses.add(f"{kind} {_quoted(names)}: {known.whole}")
        if known.whole or components.list_name in TYPES or not names:
            continue
        for attribute, loss in _losses(components, known, names):
            losses.add(f"{kind} {attribute}: {loss}")


def _losses(components: Any, known: Attributes, names: list[str]) -> Iterator[tuple[str, str]]:
    """Attributes of a class that are lost, with components, values and what opfmodel does instead."""
    defaults = components.defaults
    for attribute in defaults.index[~defaults.status.str.startswith("Output")]:
        if attribute in known.used | known.unused:
            continue
        series = _series(components, attribute, names)
        if attribute in known.constant:
            varying = [name for name, values in series.items() if _varies(values)]
            if varying:
                yield attribute, f"varies for {_quoted(varying)}; the first snapshot counts"
            continue
        default = defaults.at[attribute, "default"]
        values = {
            name: series[name] if name in series else components.static[attribute].at[name]
            for name in names
            if name in series or attribute in components.static
        }
        differing = [name for name, value in values.items() if _differs(value, default)]
        if differing:
            first = np.ravel(values[differing[0]])
            value = next(v for v in first if _differs(v, default))
            reason = known.lost.get(attribute, known.unknown)
            yield (
                attribute,
                f"{shown(getattr(value, 'item', lambda v=value: v)())} of {_quoted(differing)}: {reason}",
            )


def _series(components: Any, attribute: str, names: list[str]) -> dict[str, Any]:
    """Time series of an attribute by component."""
    if attribute not in components.dynamic:
        return {}
    table = components.dynamic[attribute]
    return {name: table[name].to_numpy() for name in names if name in table.columns}


def _varies(values: Any) -> bool:
    return len(values) > 1 and bool(_differs(values[1:], values[0]))


def _differs(values: Any, default: Any) -> bool:
    """Whether any value differs from a default; NaN equals NaN."""
    array = np.atleast_1d(np.asarray(values))
    if isinstance(default, float | int | np.floating | np.integer) and not isinstance(default, bool):
        numbers = array.astype(float)
        return bool((~((numbers == default) | (np.isnan(numbers) & np.isnan(default)))).any())
    return bool((array != default).any())


def _quoted(names: list[str]) -> str:
    return listed([repr(str(name)) for name in names])
