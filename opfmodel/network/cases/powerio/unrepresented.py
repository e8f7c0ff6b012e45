"""What powerio reads, or reports that it does not read, and opfmodel does not represent.

A field is accepted only if it is listed here: as represented, or as one without electrical meaning in an
optimal power flow. Every other value that is not empty, zero or false is a loss, so that what a later
version of powerio adds is refused before it is lost.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from opfmodel.errors import listed
from opfmodel.network.cases.losses import Losses

__all__ = ["add_losses", "harmless"]

_HARMLESS_CODES = (
    "VALUE_DEFAULTED",
    "VALUE_INFERRED",
    "NAME_REMAPPED",
    "TOPOLOGY_CALCULATED",
    "CALCULATION_VIEW",
    "VERSION_COMPATIBILITY",
    "NOTES_TRUNCATED",
    "GEOMETRY",
)
_NAMES_ONLY = ("PSS/E ZONE section", "PSS/E OWNER section", "`carriers.csv` ignored", "`shapes.csv` ignored")


def harmless(diagnostic: Any) -> bool:
    """Whether a diagnostic of powerio reports no loss of data with electrical meaning."""
    code = str(diagnostic.code)
    if code == "READ.PSSE.RETAINED_SOURCE_ONLY":
        return True  # these are kept as extra fields, which are checked one by one
    return code.endswith(_HARMLESS_CODES) or str(diagnostic.message).startswith(_NAMES_ONLY)


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_ANYWHERE = _words("name uid in_service bus from to location")
_ACCEPTED: Mapping[str, frozenset[str]] = {
    "buses": _words("id kind vm va base_kv vmax vmin evhi evlo area zone"),
    "loads": _words("p q"),
    "shunts": _words("g b section_count"),
    "branches": _words(
        "r x b rate_a rate_b rate_c rating_sets tap shift angmin angmax pf qf pt qt "
        "charging.g_fr charging.b_fr charging.g_to charging.b_to"
    ),
    "switches": _words("closed pf qf pt qt"),
    "generators": _words(
        "energy_source pg qg pmax pmin qmax qmin vg mbase voltage_regulation_on caps.ramp_30 caps.apf "
        "caps.pc1 caps.pc2 caps.qc1min caps.qc1max caps.qc2min caps.qc2max "
        "cost.model cost.startup cost.shutdown cost.ncost cost.coeffs"
    ),
    "storage": _words(
        "ps qs energy energy_rating charge_rating discharge_rating charge_efficiency discharge_efficiency "
        "thermal_rating qmin qmax"
    ),
    "areas": _words("number slack_bus tolerance area_type"),
    "hvdc": frozenset(),
    "static_var_compensators": frozenset(),
    "transformers_3w": frozenset(),
}
"""Fields that are represented, or that no optimal power flow uses: names, results, emergency limits."""
_WHOLE = {
    "hvdc": "HVDC lines",
    "static_var_compensators": "static var compensators",
    "transformers_3w": "three-winding transformers",
}
_ABOUT_THE_CASE = _words(
    "name base_mva base_frequency case_metadata generated_uids solver source_format detailed_connectivity"
)
# Extra fields of the formats: labels, owners, what the other fields already contain, and data of dynamics.
_EXTRAS = _words(
    "psse_len psse_met psse_nmetr psse_ckt psse_id psse_name psse_vecgrp psse_owner psse_o1 psse_o2 psse_o3 "
    "psse_o4 psse_f1 psse_f2 psse_f3 psse_f4 psse_zone psse_area psse_nstat psse_stype psse_rsetnam psse_tab "
    "psse_pl psse_ql psse_ip psse_iq psse_yp psse_yq psse_pdgen psse_qdgen psse_flagstatus psse_intrpt "
    "psse_scal psse_loadtype psse_zr psse_zx psse_rt psse_xt psse_gtap psse_lat psse_long psse_baslod "
    "pslf_circuit pslf_section_id ucte_element_name ucte_geographical_name ucte_order_code "
    "ucte_power_plant_type ucte_short_circuit_power ucte_xr_ratio ieee_cdf_circuit cgmes_class "
    # of pandapower, whose files without pandapower are checked before
    "tap_min tap_max vector_group std_type"
)
_TOPOLOGY = _words(
    "component_metadata subnetworks substations voltage_levels bus_breaker_buses calculated_buses "
    "connectivity_nodes busbar_sections junctions terminals switches internal_connections "
    "operational_limit_groups equipment_reactive_limits tap_changers boundary_lines tie_lines"
)
_Rule = Callable[[Any, Mapping[str, Any]], str]


def add_losses(case: Any, losses: Losses, *, every_field: bool) -> None:
    """Report what a balanced network of powerio contains and opfmodel does not represent.

    Parameters
    ----------
    every_field
        Whether to check all fields and not only the kinds of equipment; a MATPOWER file, which has been
        checked before, needs the latter only. Its DC lines are represented.
    """
    for kind, what in _WHOLE.items():
        if kind == "hvdc" and not every_field:
            continue
        members = getattr(case, kind) if getattr(case, f"n_{kind}") else ()
        count = sum(1 for record in members if record["in_service"])
        if count:
            losses.add(
                f"{count} {what} in service: left out; take them out of service or replace them with "
                "branches, generators and loads"
            )
    if every_field:
        for loss in _unrepresented(case):
            losses.add(loss)


def _unrepresented(case: Any) -> Iterator[str]:
    import powerio

    text = str(powerio.serialize(powerio.PioModule.from_value(case)).text)
    content = json.loads(text)["value"]["data"]
    for table, value in content.items():
        if table in _ABOUT_THE_CASE or table in _WHOLE or not value:
            continue
        if table not in _ACCEPTED:
            yield f"{table}: not represented"
            continue
        yield from _fields(table, value)
    yield from _details(content.get("detailed_connectivity") or {}, content["buses"])


def _fields(table: str, records: list[dict[str, Any]]) -> Iterator[str]:
    """What the records of a table have beyond the accepted fields, by field."""
    found: dict[str, list[str]] = defaultdict(list)
    for record in records:
        if not record.get("in_service", True):
            continue
        label = str(record.get("name") or record.get("uid") or record.get("number"))
        for key, value in _flat(record):
            if key.removeprefix("extras.") in _EXTRAS or key in _ANYWHERE or key in _ACCEPTED[table]:
                continue
            rule = _RULES.get((table, key))
            reason = f"{key} = {value}" if rule is None else rule(value, record)
            if reason:
                found[reason if rule is not None else key].append(
                    f"{label} ({value})" if rule is None else label
                )
    for what, members in found.items():
        yield f"{table}: {what}: {listed(members)}"


def _flat(record: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Values of a record that are not empty, by dotted key; those with a rule are not taken apart."""
    for key, value in record.items():
        if isinstance(value, dict) and key not in _UNDIVIDED:
            yield from _flat(value, f"{prefix}{key}.")
        elif value not in (None, "", 0, False, [], {}):
            yield prefix + key, value


def _zip(model: Mapping[str, Any], _: Mapping[str, Any]) -> str:
    parts = [key for key, value in model.items() if "constant_power" not in key and key != "kind" and value]
    return "" if not parts else "parts of constant current or impedance, taken as constant power"


def _tap(control: Mapping[str, Any], _: Mapping[str, Any]) -> str:
    moving = control.get("enabled") and control.get("mode") != "fixed"
    return f"taps that control {control.get('mode')}, held where they are" if moving else ""


def _correction(table: Mapping[str, Any], _: Mapping[str, Any]) -> str:
    return f"impedance correction table {table.get('table')}, not applied"


def _loading(percent: Any, _: Mapping[str, Any]) -> str:
    return "" if percent == 100 else f"max_loading_percent = {percent}, taken as 100"


def _switched(control: Mapping[str, Any], _: Mapping[str, Any]) -> str:
    moving = control.get("mode") not in ("locked", "fixed")
    return "shunts that are switched, held where they are" if moving else ""


def _regulated(bus: Any, record: Mapping[str, Any]) -> str:
    return "" if bus == record["bus"] else "hold the voltage of another bus, here that of their own"


def _terminal(terminal: Mapping[str, Any], record: Mapping[str, Any]) -> str:
    own = (terminal.get("equipment") or {}).get("local_id") == record.get("uid")
    return "" if own else "hold the voltage of another terminal, here that of their own"


_RULES: Mapping[tuple[str, str], _Rule] = {
    ("loads", "voltage_model"): _zip,
    ("branches", "control"): _tap,
    ("branches", "extras.impedance_correction"): _correction,
    ("branches", "extras.max_loading_percent"): _loading,
    ("shunts", "control"): _switched,
    ("generators", "regulated_bus"): _regulated,
    ("generators", "regulating_terminal"): _terminal,
}
_UNDIVIDED = frozenset(key.removeprefix("extras.") for _, key in _RULES)


def _details(details: Mapping[str, Any], buses: list[dict[str, Any]]) -> Iterator[str]:
    """What the detailed model of CGMES and XIIDM has beyond the topology and the buses made of it."""
    for table, value in details.items():
        if value and table not in _TOPOLOGY and table != "omitted_fields":
            yield f"{table}: not represented"
    curves = [
        item["equipment"]["local_id"]
        for item in details.get("equipment_reactive_limits") or ()
        if item["limits"]["kind"] != "min_max"
    ]
    if curves:
        yield f"generators: reactive capability curves: {listed(curves)}"
    moving = [t["component"]["local_id"] for t in details.get("tap_changers") or () if t.get("regulating")]
    if moving:
        yield f"tap changers that regulate, held where they are: {listed(moving)}"
    limits = {bus["id"]: (bus["vmin"], bus["vmax"]) for bus in buses}
    other = []
    for level in details.get("voltage_levels") or ():
        ends = (level.get("low_voltage_limit_kv"), level.get("high_voltage_limit_kv"))
        for bus in level.get("buses") or ():
            for end, used in zip(ends, limits.get(bus, ()), strict=False):
                if end is not None and abs(end / level["nominal_kv"] - used) > 1e-6:
                    other.append(f"bus {bus} ({end / level['nominal_kv']:g}, read as {used:g} p.u.)")
    if other:
        yield f"voltage limits of voltage levels: {listed(other)}"
