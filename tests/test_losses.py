"""What files of other formats contain and opfmodel does not represent: refused, or lost with a warning."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from conftest import DATA

import opfmodel as om
from opfmodel.errors import CaseError, CaseWarning
from opfmodel.network import per_unit
from opfmodel.network.physics import branch_admittance

RAW = (DATA / "psse" / "four-buses.raw").read_text()
COST = om.Polynomial(0, 30, 0)


def section(name: str, *rows: str) -> str:
    """The PSS/E case with records in one of its empty sections."""
    begin = f"BEGIN {name} DATA\n"
    assert begin in RAW
    return RAW.replace(begin, begin + "".join(f"{row}\n" for row in rows))


def changed(old: str, new: str) -> str:
    assert RAW.count(old) == 1
    return RAW.replace(old, new)


def read(folder: Path, text: str, **options: object) -> om.Network:
    path = folder / "case.raw"
    path.write_text(text)
    return om.read_network(path, default_cost=COST, **options)


THREE_WINDINGS = """1,2,4,'1 ',1,1,1, 0.0,0.0,2,'T3',1, 1,1.0, 0,1.0, 0,1.0, 0,1.0,' '
0.001,0.1,100.0,0.002,0.2,100.0,0.003,0.3,100.0,1.0,0.0
1.0,0.0,0.0,50.0,60.0,70.0,0,0,1.1,0.9,1.1,0.9,33,0,0.0,0.0,0.0
1.0,0.0,0.0,50.0,60.0,70.0,0,0,1.1,0.9,1.1,0.9,33,0,0.0,0.0,0.0
1.0,0.0,0.0,50.0,60.0,70.0,0,0,1.1,0.9,1.1,0.9,33,0,0.0,0.0,0.0"""
CONVERTER = "90.0,5.0,0.0,10.0,230.0,0.4,1.0,1.5,0.5,0.00625,0,0,0,'1',0.0"
VSC = "1,1,{},1.0,0.1,0.1,0.0,100.0,1000.0,1.0,50.0,-50.0,0,100.0"
TABLE = "1, 0.9, 1.1, 1.0, 1.0, 1.1, 0.9" + ", 0" * 16
LOSSES = {
    "two-terminal dc": (
        section("TWO-TERMINAL DC", "'D',1,5,100,500,0,0,0,'I',0,20,1", f"1,2,{CONVERTER}", f"4,2,{CONVERTER}"),
        "1 HVDC lines in service",
    ),
    "vsc dc": (
        section("VSC DC LINE", "'V',1,0.5,1,1,0,1,0,1,0,1", "1," + VSC.format(100), "4," + VSC.format(-99)),
        "VSC DC LINE section",
    ),
    "multi-section line": (section("MULTI-SECTION LINE", "1,4,'&1',1,2"), "MULTI-SECTION LINE section"),
    "interchange": (section("INTER-AREA TRANSFER", "1,2,'1',50.0"), "INTER-AREA TRANSFER section"),
    "area": (section("AREA", "1,1,100.0,10.0,'A'"), "areas: net_interchange"),
    "facts": (
        section("FACTS DEVICE", "'F',3,0,1,0,10,1,100,0,0.9,1.1,1,0,0.05,100,1,0,0,0,0,' '"),
        "FACTS DEVICE section",
    ),
    "induction machine": (
        section("INDUCTION MACHINE", "3,'1',1,1,1,1,1,1,1,10,20,1,5,1,0.5,0,0,0,0.01,0.1,3,0.02,0.1,0,0,1,0,1.2,0,0,0,0"),
        "INDUCTION MACHINE section",
    ),
    "switched shunt": (
        section("SWITCHED SHUNT", "3,1,0,1,1.05,0.95,0,100.0,' ',25.0,2,10.0,1,5.0"),
        "switched, held where they are: bus-3",
    ),
    "three windings": (
        changed("0 / END OF TRANSFORMER", THREE_WINDINGS + "\n0 / END OF TRANSFORMER"),
        "1 three-winding transformers in service",
    ),
    "load components": (
        changed("94.2, 19.0, 0.0, 0.0, 0.0, 0.0", "94.2, 19.0, 5.0, 2.0, 4.0, -3.0"),
        "constant current or impedance, taken as constant power: bus-3",
    ),
    "tap control": (changed("170.0, 0, 0, 1.1", "170.0, 1, 3, 1.1"), "taps that control voltage"),
    "impedance correction": (
        section("IMPEDANCE CORRECTION", TABLE).replace("0.9, 33, 0,", "0.9, 33, 1,"),
        "impedance correction table 1, not applied: T1",
    ),
    "missing table": (changed("0.9, 33, 0,", "0.9, 33, 2,"), "impedance correction table(s) 2"),
    "remote voltage": (changed("1.04500,0, 60.0", "1.04500,3, 60.0"), "hold the voltage of another bus"),
}  # fmt: skip


@pytest.mark.parametrize("kind", LOSSES)
def test_what_a_psse_case_would_lose_is_refused_or_accepted(kind: str, tmp_path: Path) -> None:
    text, what = LOSSES[kind]
    with pytest.raises(CaseError) as refused:
        read(tmp_path, text)
    assert str(refused.value).startswith(
        f"{tmp_path / 'case.raw'}: contains what opfmodel does not represent: "
    )
    assert what in str(refused.value)
    with pytest.warns(CaseWarning) as caught:
        network = read(tmp_path, text, lossy=True)
    lost = [str(w.message) for w in caught if ": lost: " in str(w.message)]
    assert sum(what in message for message in lost) == 1, lost
    assert len(network.of(om.Bus)) == 4


def test_without_pandapower_the_loading_of_its_lines_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """powerio reads the current of a line and not the share of it that may be used."""
    pp = pytest.importorskip("pandapower")
    net = pp.create_empty_network()
    ends = [pp.create_bus(net, 110, min_vm_pu=0.9, max_vm_pu=1.1) for _ in range(2)]
    pp.create_ext_grid(net, ends[0], controllable=True)
    pp.create_load(net, ends[1], 10, 2)
    pp.create_line_from_parameters(net, *ends, 10, 0.1, 0.3, 9, 0.5, max_loading_percent=60)
    pp.create_poly_cost(net, 0, "ext_grid", cp1_eur_per_mw=30)
    pp.to_json(net, str(tmp_path / "grid.json"))
    monkeypatch.setitem(sys.modules, "pandapower", None)
    with pytest.raises(CaseError, match=r"max_loading_percent"):
        om.read_network(tmp_path / "grid.json")


def test_all_losses_are_in_one_error(tmp_path: Path) -> None:
    text = section("AREA", "1,1,100.0,10.0,'A'").replace("0.9, 33, 0,", "0.9, 33, 2,")
    with pytest.raises(CaseError, match=r"impedance correction table.*areas: net_interchange"):
        read(tmp_path, text)


@pytest.mark.parametrize(
    "text",
    [
        RAW,
        section("ZONE", "1,'north'"),
        section("AREA", "1,1,0.0,10.0,'A'"),
        section("SWITCHED SHUNT", "3,0,0,1,1.05,0.95,0,100.0,' ',25.0,2,10.0,1,5.0"),
        changed("2,'1 ',1, 1, 1, 21.7", "2,'1 ',1, 1, 1, 21.7"),
        changed("0.004,1,1, 0.0, 1,1.0", "0.004,1,2, 15.0, 1,1.0"),
    ],
)
def test_a_psse_case_without_losses_is_read(text: str, tmp_path: Path) -> None:
    network = read(tmp_path, text)
    assert network.gen2.vm_set == 1.045
    assert (network["1-2"].g_from, network["1-2"].g_to) == (0.001, 0.003)


def test_equipment_out_of_service_loses_nothing(tmp_path: Path) -> None:
    loads = "3,'2 ',0, 1, 1, 5, 1, 3, 2, 1, 1, 1,1,0\n0 / END OF LOAD"
    network = read(tmp_path, changed("0 / END OF LOAD", loads))
    assert [(load.p, load.in_service) for load in network.of(om.Load).values()] == [
        (21.7, True), (94.2, True), (9.0, False),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new", "magnetising", "tap"),
    [
        ("'1 ',1,1,1, 0.01,-0.02", "'1 ',1,1,1, 0.01,-0.02", 0.01 - 0.02j, 0.978),
        # no-load losses in W and current in p.u. of the winding's base of 100 MVA
        ("'1 ',1,1,1, 0.01,-0.02", "'1 ',1,1,2, 20000.0,0.01", 2e-4 - 1j * np.sqrt(0.01**2 - 2e-4**2), 0.978),
        ("1.0, 0.0\n0 / END OF TRANS", "1.02, 0.0\n0 / END OF TRANS", 0.01 - 0.02j, 0.978 / 1.02),
    ],
)
def test_the_magnetising_branch_of_a_transformer_is_at_its_first_winding(
    old: str, new: str, magnetising: complex, tap: float, tmp_path: Path
) -> None:
    """PSS/E connects MAG1 + j MAG2 to the bus of winding 1, outside the ideal transformer."""
    network = read(tmp_path, changed(old, new))
    branch = network["2-3"]
    assert branch.tap == pytest.approx(tap, rel=1e-12)
    y = branch_admittance(
        branch.r, branch.x, branch.g_from, branch.b_from + branch.b / 2, branch.g_to,
        branch.b_to + branch.b / 2, branch.tap, 0.0,
    )  # fmt: skip
    series = 1 / (branch.r + 1j * branch.x)
    assert y.g_ff + 1j * y.b_ff - series / tap**2 == pytest.approx(magnetising, rel=1e-9)
    assert y.g_tt + 1j * y.b_tt == pytest.approx(series, rel=1e-12)


def test_lines_without_impedance_join_their_buses(tmp_path: Path) -> None:
    text = changed("2,4,'1 ', 0.0, 0.00005", "2,4,'1 ', 0.0, 0.0").replace(
        "-12.725,1.1,0.9,1.15,0.85\n0 /", "-12.725,1.05,0.95,1.15,0.85\n0 /"
    )
    with pytest.warns(CaseWarning, match="lines without impedance were merged"):
        network = read(tmp_path, text)
    assert list(network.of(om.Bus)) == ["1", "2", "3"]
    assert dict(network.aliases) == {"1": "1", "2": "2", "3": "3", "4": "2"}
    assert network["2"].vm == (0.95, 1.05)
    with pytest.raises(CaseError, match=r"ratings of .*lines without impedance: 2-4"):
        read(tmp_path, text.replace("2,4,'1 ', 0.0, 0.0, 0.0, 0.0", "2,4,'1 ', 0.0, 0.0, 0.0, 80.0"))


EVERYWHERE = (
    (om.Bus, ("vm_min", "vm_max")),
    (om.Branch, ("r", "x", "b", "tap", "rating")),
    (om.Load, ("p", "q")),
    (om.Shunt, ("b",)),
    (om.Generator, ("p_max", "q_min", "q_max")),
)


def test_powerio_writes_and_reads_every_format_without_a_silent_loss(tmp_path: Path) -> None:
    """The admittances of the 14-bus case survive every format that powerio writes, or are refused."""
    import powerio

    case = DATA / "pglib" / "pglib_opf_case14_ieee.m"
    original = om.read_network(case)
    formats = (
        "psse",
        "powermodels-json",
        "egret-json",
        "powerworld",
        "pslf",
        "surge-json",
        "xiidm",
        "cgmes",
        "ucte",
    )
    outcomes = {}
    for name in formats:
        target = tmp_path / name
        powerio.emit(powerio.parse(str(case)), name, str(target))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", CaseWarning)
                found = om.read_network(target, format=name, default_cost=COST)
        except CaseError as error:
            outcomes[name] = str(error)
            continue
        outcomes[name] = "read"
        for kind, fields in EVERYWHERE:
            for field in fields:
                values, expected = (
                    sorted(c.constant(field) for c in n.of(kind).values()) for n in (found, original)
                )
                assert values == pytest.approx(expected, rel=1e-9), (name, field)
        assert per_unit(found).n_islands == 1
    assert "voltage limits of voltage levels" in outcomes["cgmes"]  # powerio reads 0.9 and 1.1 p.u.
    assert "reactance" in outcomes["ucte"]
    assert [name for name, outcome in outcomes.items() if outcome == "read"] == list(formats[:-2])
