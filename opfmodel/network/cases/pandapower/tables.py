"""What the reader does with the tables and columns of pandapower.

``tests/test_pandapower.py`` compares these lists with the tables of the installed pandapower, so that
a table or column of a later version does not go unnoticed.
"""

from __future__ import annotations

from collections.abc import Mapping

__all__ = [
    "CONVERTED",
    "CURVES",
    "ELEMENTS",
    "IGNORED",
    "KNOWN",
    "READ",
    "REPORTED",
    "TABLES_IGNORED",
    "UNMODELLED",
]


def _columns(text: str) -> frozenset[str]:
    return frozenset(text.split())


UNMODELLED: Mapping[str, str] = {
    "svc": "a static var compensator",
    "ssc": "a static synchronous compensator",
    "tcsc": "a thyristor-controlled series compensator",
    "vsc": "a voltage source converter",
    "vsc_stacked": "a stacked voltage source converter",
    "vsc_bipolar": "a bipolar voltage source converter",
    "bus_dc": "a dc bus",
    "line_dc": "a dc line between dc buses",
    "source_dc": "a dc source",
    "load_dc": "a dc load",
}
"""Equipment that has no counterpart: a loss if it is in service."""

_LIMITS = "min_p_mw max_p_mw min_q_mvar max_q_mvar"
_CURVE = "reactive_capability_curve id_q_capability_characteristic curve_style"
_BRANCH = "name in_service max_loading_percent"

READ: Mapping[str, frozenset[str]] = {
    "bus": _columns("name vn_kv in_service min_vm_pu max_vm_pu geo"),
    "load": _columns(f"name bus p_mw q_mvar scaling in_service controllable {_LIMITS}"),
    "sgen": _columns(f"name bus p_mw q_mvar scaling in_service controllable {_LIMITS} {_CURVE}"),
    "gen": _columns(
        f"name bus p_mw vm_pu scaling in_service controllable slack min_vm_pu max_vm_pu {_LIMITS} {_CURVE}"
    ),
    "ext_grid": _columns(f"name bus vm_pu va_degree in_service controllable {_LIMITS}"),
    "storage": _columns(
        f"name bus p_mw q_mvar scaling in_service controllable soc_percent min_e_mwh max_e_mwh {_LIMITS}"
    ),
    "dcline": _columns(
        "name from_bus to_bus p_mw loss_percent loss_mw vm_from_pu vm_to_pu max_p_mw min_q_from_mvar "
        "max_q_from_mvar min_q_to_mvar max_q_to_mvar in_service"
    ),
    "motor": _columns("name bus pn_mech_mw loading_percent cos_phi efficiency_percent scaling in_service"),
    "asymmetric_load": _columns(
        "name bus p_a_mw p_b_mw p_c_mw q_a_mvar q_b_mvar q_c_mvar scaling in_service"
    ),
    "asymmetric_sgen": _columns(
        "name bus p_a_mw p_b_mw p_c_mw q_a_mvar q_b_mvar q_c_mvar scaling in_service"
    ),
    "shunt": _columns(
        "name bus p_mw q_mvar vn_kv step step_dependency_table id_characteristic_table in_service"
    ),
    "ward": _columns("name bus ps_mw qs_mvar pz_mw qz_mvar in_service"),
    "xward": _columns("name bus ps_mw qs_mvar pz_mw qz_mvar vm_pu in_service"),
    "line": _columns(_BRANCH),
    "trafo": _columns(_BRANCH),
    "trafo3w": _columns(_BRANCH),
    "impedance": _columns("name in_service"),
    "switch": _columns("name"),
    "poly_cost": _columns("element et cp0_eur cp1_eur_per_mw cp2_eur_per_mw2"),
    "pwl_cost": _columns("element et power_type points"),
}
"""Columns that this reader uses itself."""

CONVERTED: Mapping[str, frozenset[str]] = {
    "line": _columns(
        "from_bus to_bus length_km r_ohm_per_km x_ohm_per_km c_nf_per_km g_us_per_km max_i_ka df parallel"
    ),
    "trafo": _columns(
        "hv_bus lv_bus sn_mva vn_hv_kv vn_lv_kv vk_percent vkr_percent pfe_kw i0_percent shift_degree "
        "parallel df tap_side tap_neutral tap_step_percent tap_step_degree tap_pos tap_changer_type "
        "tap_dependency_table id_characteristic_table tap2_side tap2_neutral tap2_step_percent "
        "tap2_step_degree tap2_pos tap2_changer_type leakage_resistance_ratio_hv leakage_reactance_ratio_hv"
    ),
    "trafo3w": _columns(
        "hv_bus mv_bus lv_bus sn_hv_mva sn_mv_mva sn_lv_mva vn_hv_kv vn_mv_kv vn_lv_kv vk_hv_percent "
        "vk_mv_percent vk_lv_percent vkr_hv_percent vkr_mv_percent vkr_lv_percent pfe_kw i0_percent "
        "shift_mv_degree shift_lv_degree tap_side tap_neutral tap_step_percent tap_step_degree tap_pos "
        "tap_at_star_point tap_changer_type tap_dependency_table id_characteristic_table loss_side"
    ),
    "impedance": _columns("from_bus to_bus rft_pu xft_pu rtf_pu xtf_pu gf_pu bf_pu gt_pu bt_pu sn_mva"),
    "switch": _columns("bus element et closed z_ohm"),
    "xward": _columns("r_ohm x_ohm"),
}
"""Columns that pandapower's converter uses."""

REPORTED: Mapping[str, frozenset[str]] = {
    "load": _columns("const_z_p_percent const_i_p_percent const_z_q_percent const_i_q_percent"),
    "poly_cost": _columns(
        "cq0_eur cq1_eur_per_mvar cq2_eur_per_mvar2 redispatch_up_eur_per_mw redispatch_down_eur_per_mw"
    ),
    "controller": _columns("object in_service order level initial_run recycle"),
}
"""Columns that opfmodel cannot represent: reported unless they have no effect."""

_SHORT_CIRCUIT = "rx lrc_pu vn_kv"
_ZERO_SEQUENCE_LINE = "r0_ohm_per_km x0_ohm_per_km c0_nf_per_km g0_us_per_km endtemp_degree"
# Only runpp(tdpf=True) and runpp(consider_line_temperature=True) use these.
_TEMPERATURE = (
    "alpha temperature_degree_celsius tdpf wind_speed_m_per_s wind_angle_degree conductor_outer_diameter_m "
    "air_temperature_degree_celsius reference_temperature_degree_celsius solar_radiation_w_per_sq_m "
    "solar_absorptivity emissivity r_theta_kelvin_per_mw mc_joule_per_m_k"
)

IGNORED: Mapping[str, frozenset[str]] = {
    "bus": _columns("type zone"),
    "load": _columns("sn_mva type zone"),
    "sgen": _columns("sn_mva type current_source k generator_type max_ik_ka kappa rx lrc_pu"),
    "gen": _columns("sn_mva type slack_weight vn_kv xdss_pu rdss_ohm cos_phi power_station_trafo pg_percent"),
    "ext_grid": _columns("slack_weight s_sc_max_mva s_sc_min_mva rx_max rx_min r0x0_max x0x_max"),
    "storage": _columns("sn_mva type"),
    "dcline": _columns("min_p_mw"),  # runopp does not read it
    "motor": _columns(f"cos_phi_n efficiency_n_percent {_SHORT_CIRCUIT}"),
    "asymmetric_load": _columns("sn_a_mva sn_b_mva sn_c_mva sn_mva type"),
    "asymmetric_sgen": _columns("sn_a_mva sn_b_mva sn_c_mva sn_mva type current_source"),
    "shunt": _columns("max_step"),
    "xward": _columns("slack_weight"),
    "line": _columns(f"std_type type geo {_ZERO_SEQUENCE_LINE} {_TEMPERATURE}"),
    "trafo": _columns(
        "std_type tap_min tap_max tap2_min tap2_max oltc power_station_unit vector_group vk0_percent "
        "vkr0_percent mag0_percent mag0_rx si0_hv_partial xn_ohm pt_percent"
    ),
    "trafo3w": _columns("std_type tap_min tap_max vector_group vkr0_x vk0_x"),
    "impedance": _columns("rft0_pu xft0_pu rtf0_pu xtf0_pu gf0_pu bf0_pu gt0_pu bt0_pu"),
    "switch": _columns("type in_ka"),
}
"""Columns without meaning for balanced steady states: geography, short circuits, ranges of taps."""

TABLES_IGNORED = frozenset({"measurement", "group"})
"""Tables without electrical meaning."""

ELEMENTS = (
    "bus", "line", "trafo", "trafo3w", "impedance", "switch", "load", "sgen", "gen", "ext_grid", "storage",
    "motor", "asymmetric_load", "asymmetric_sgen", "shunt", "ward", "xward", "dcline", *UNMODELLED,
)  # fmt: skip
"""Tables whose rows have names."""

CURVES = "q_capability_curve_table"
"""Table of capability curves, which an empty network does not have."""

KNOWN = frozenset({*ELEMENTS, *READ, *REPORTED, *TABLES_IGNORED, CURVES})
"""All tables that this version knows."""
