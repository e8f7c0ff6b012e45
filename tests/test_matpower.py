"""MATPOWER files: read exactly as MATLAB does, or refused with one clear error."""

from __future__ import annotations

import math
import random
import re
import warnings
from pathlib import Path

import pytest
from conftest import DATA, SCENARIOS

import opfmodel as om
from opfmodel.errors import CaseError, CaseWarning
from opfmodel.network.cases.matpower import COLUMNS, MORE_COLUMNS

CASE5 = (DATA / "matpower" / "case5.m").read_text()
COST = "2	0	0	2	14	0;"  # of gen1, on line 57
GENERATOR = "1	40	0	30	-30	1	100	1	40	0"  # gen1, on line 34
BUS = "1	2	0	0	0	0	1	1	0	230	1	1.1	0.9;"  # on line 24
BRANCH = (
    "1	2	0.00281	0.0281	0.00712	400	400	400	0	0	1	-360	360;"  # on line 44
)
OTHER_COSTS = "mpc.gencost = [" + "2 0 0 2 99 0;" * 5 + "];"
NO_CONSTANT = re.sub(r"(?<=\t2)\t([0-9]+)\t0;", r"\t\1;", CASE5)  # costs without their last column
STORAGE = "mpc.storage = [\n1 0 0 20 100 50 40 0.9 0.95 0 -10 10 0 0 0 0 1;\n];\n"


def replaced(old: str, new: str, text: str = CASE5) -> str:
    assert old in text
    return text.replace(old, new, 1)


def contents(network: om.Network) -> dict:
    return {name: network[name] for name in network}


def written(folder: Path, text: str) -> Path:
    path = folder / "case.m"
    path.write_text(text, newline="")
    return path


# Input that MATLAB refuses or that a lenient parser would coerce -----------------------------------


@pytest.mark.parametrize(
    ("text", "line", "who", "value"),
    [
        *(
            (replaced(COST, f"2	0	0	{word}	14	0;"), 57, "gen1", f"NCOST = {word}:")
            for word in ("NaN", "-1", "0", "1e-9", "2.5", "3", "1e300", "Inf")
        ),
        (replaced(COST, "2	0	0	2	14;"), 57, "gen1", "the row has 5 numbers"),
        (NO_CONSTANT, 57, "gen1", "NCOST = 2:"),
        (replaced(COST, "1	0	0	1	14	0;"), 57, "gen1", "NCOST = 1:"),
        (replaced(COST, "1	0	0	2	14	0;"), 57, "gen1", "NCOST = 2:"),
        (replaced(COST, "3	0	0	2	14	0;"), 57, "gen1", "MODEL = 3:"),
        (replaced(COST, "2	0	0	2	NaN	0;"), 57, "gen1", "c1=nan"),
        (replaced(COST, ""), 56, "mpc.gencost", "4 rows for 5 generators"),
        (replaced(GENERATOR, "1.5" + GENERATOR[1:]), 34, "gen1", "GEN_BUS = 1.5:"),
        (replaced(GENERATOR, "99" + GENERATOR[1:]), 34, "gen1", "GEN_BUS = 99: no such bus"),
        (replaced(GENERATOR, GENERATOR.replace("100	1", "100	0.5")), 34, "gen1", "GEN_STATUS = 0.5:"),
        (replaced(BRANCH, "1.5" + BRANCH[1:]), 44, "mpc.branch", "F_BUS = 1.5:"),
        (replaced(BRANCH, BRANCH.replace("1	2", "1	2.5")), 44, "mpc.branch", "T_BUS = 2.5:"),
        (
            replaced(BRANCH, BRANCH.replace("0	1	-360", "0	2	-360")),
            44,
            "mpc.branch",
            "BR_STATUS = 2:",
        ),
        (replaced(BUS, "1.5" + BUS[1:]), 24, "mpc.bus", "BUS_I = 1.5:"),
        (replaced(BUS, "2" + BUS[1:]), 25, "mpc.bus", "BUS_I = 2: duplicate"),
        (replaced(BUS, BUS.replace("1	2", "1	5")), 24, "mpc.bus", "BUS_TYPE = 5:"),
        (replaced(BUS, BUS.replace("1	2", "1	1.5")), 24, "mpc.bus", "BUS_TYPE = 1.5:"),
        (CASE5 + STORAGE.replace("\n1 0", "\n1.5 0"), 64, "mpc.storage", "STORAGE_BUS = 1.5:"),
        (CASE5 + STORAGE.replace(" 1;", " 7;"), 64, "mpc.storage", "STATUS = 7:"),
        (replaced("230	1	1.1", "230	1	1_1"), 24, "mpc.bus", "'1_1'"),
        (replaced("230	1	1.1", "230	1	1 - 1"), 24, "mpc.bus", "15 numbers"),
        (replaced("230	1	1.1", "230	1	1/1"), 24, "mpc.bus", "'1/1'"),
        (replaced("230	1	1.1", "230	1	iNf"), 24, "mpc.bus", "'iNf'"),
        (replaced("230	1	1.1", "230	1	\x1b[31m"), 24, "mpc.bus", r"'\x1b[31m'"),
        (replaced("230	1	1.1", "230,,1	1.1"), 24, "mpc.bus", "comma"),
        (replaced("mpc.baseMVA = 100", "mpc.baseMVA = NaN"), 19, "mpc.baseMVA", "'NaN'"),
        (replaced("mpc.baseMVA = 100", "mpc.baseMVA = 100/3"), 19, "mpc.baseMVA", "'100/3'"),
        (replaced("'2'", "'3'"), 15, "mpc.version", "'3'"),
        (replaced("function mpc", "function s"), 1, "function s", "function mpc"),
        (CASE5 + "mpc.gencost = [1 2; 3 4] * 2;", 63, "mpc.gencost", "* 2"),
        (CASE5 + "mpc.gencost = 2 * mpc.gencost;", 63, "mpc.gencost", "2 * mpc.gencost"),
        (CASE5 + "mpc.gen(2, :) = [];\n" + OTHER_COSTS.replace("gencost", "gen"), 64, "mpc.gen", "again"),
        (CASE5 + "mpc = scale(mpc);", 63, "mpc = scale(mpc)", "not understood"),
        (CASE5 + "[mpc, x] = scale(mpc);", 63, "[mpc, x]", "not understood"),
        (CASE5 + "eval('mpc.baseMVA = 3');", 63, "eval", "not understood"),
        (CASE5 + "mpc.bus{3} = 4;", 63, "mpc.bus{3}", "not understood"),
        (CASE5 + "if 1\n  mpc.baseMVA = 50;\nend", 64, "mpc.baseMVA", "'if 1'"),
        (CASE5 + "for k = 1:3\nx = k;\n", 63, "for k = 1:3", "no matching"),
        (CASE5 + "%{\n" + OTHER_COSTS, 63, "%{", "%}"),
        (CASE5 + "mpc.storage = [\n1 2", 63, "mpc.storage", "no closing bracket"),
    ],
)
def test_invalid_entries_are_errors_with_their_line(
    text: str, line: int, who: str, value: str, tmp_path: Path
) -> None:
    path = written(tmp_path, text)
    with pytest.raises(CaseError) as caught:
        om.read_network(path)
    message = str(caught.value)
    assert message.startswith(f"{path}:{line}: ")
    assert who in message
    assert value in message
    assert message.isprintable()


def test_the_line_is_right_after_a_continued_row(tmp_path: Path) -> None:
    path = written(tmp_path, replaced(COST, "2 0 0 ... three\n 2 14 0;\n 2 0 0 -2 14 0;"))
    with pytest.raises(CaseError, match=r"case\.m:59: gen2: NCOST = -2"):
        om.read_network(path)


# Input that MATLAB accepts -------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        replaced("mpc.version = '2';", "").replace("mpc.baseMVA = 100;", "mpc.version='2'; mpc.baseMVA=100;"),
        replaced("mpc.baseMVA = 100;", "mpc.baseMVA = 1e2"),
        replaced("mpc.baseMVA = 100;", "mpc.baseMVA = 100 % MVA"),
        replaced("mpc.baseMVA = 100;", "mpc.baseMVA = 100, x = 3"),
        replaced(COST, "2,0,0,2,14,0"),
        replaced(COST, "2, 0, 0, 2, 14, 0, ;"),
        replaced(COST, "2 0 0 2 ... of two numbers ]\n 14 0"),
        replaced(COST, "2 0 0 2 +14. 0.e0; % [ and ] in a comment"),
        CASE5.replace(";\n", "\n"),
        CASE5.replace("\n", "\r\n"),
        CASE5.replace("\n", "\r"),
        "\ufeff" + CASE5,
        replaced("function mpc = case5", "function [mpc] = case5()"),
        replaced("%% bus data", "%{\n" + OTHER_COSTS + "\n%}"),
        CASE5 + "mpc.bus_name = {'a]'; 'b''%'; 'c;'; \"d'\"; 'e'};\nx = [1 2\n3 4]'; [A, B] = idx_bus;",
        CASE5 + "end\n\nfunction mpc = other\n" + OTHER_COSTS + "\ndisp('never')",
        CASE5 + "return\n" + OTHER_COSTS,
    ],
)
def test_equivalent_spellings_of_a_case(text: str, tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        network = om.read_network(written(tmp_path, text))
    assert contents(network) == contents(om.read_network(DATA / "matpower" / "case5.m"))
    assert network.base_mva == 100


def test_the_last_of_two_assignments_counts_as_in_matlab(tmp_path: Path) -> None:
    path = written(
        tmp_path, replaced("mpc.baseMVA = 100;", "mpc.baseMVA = 50;\nmpc.baseMVA = 100;") + OTHER_COSTS
    )
    with pytest.warns(CaseWarning) as caught:
        network = om.read_network(path)
    assert {g.cost for g in network.of(om.Generator).values()} == {om.Polynomial(0, 99, 0)}
    assert network.base_mva == 100
    remarks = [str(w.message) for w in caught]
    assert [r.partition(": ")[0] for r in remarks] == [f"{path}:20", f"{path}:64"]
    assert "mpc.baseMVA" in remarks[0] and "line 19" in remarks[0]
    assert "mpc.gencost" in remarks[1] and "line 57" in remarks[1]


@pytest.mark.parametrize(
    ("statements", "what"),
    [
        ("mpc.convdc = [1 2];", "mpc.convdc is not represented"),
        ("mpc.reserves.zones = [1 2];", "mpc.reserves is not represented"),
        ("mpc.bus(:, 3) = 2;", "'mpc.bus(:, 3) = 2' is not evaluated"),
        ("if 1\n  mpc.bus(:, 3) = 2; x = 4;\nend", "'if 1' is not evaluated"),
        ("mpc.gencost = [" + "2 0 0 2 14 0;" * 5 + "2 0 0 2 3 0;" * 5 + "];", "costs of reactive power"),
    ],
)
def test_what_a_case_would_lose_is_refused(statements: str, what: str, tmp_path: Path) -> None:
    path = written(tmp_path, CASE5.split("%%-----  OPF Data")[0] + STORAGE + OTHER_COSTS + "\n" + statements)
    line = path.read_text().count("\n", 0, path.read_text().index(statements)) + 1
    with pytest.raises(CaseError) as refused:
        om.read_network(path)
    assert f"line {line}: " in str(refused.value) and what in str(refused.value)
    with pytest.warns(CaseWarning) as caught:
        network = om.read_network(path, lossy=True)
    (lost,) = (str(w.message) for w in caught if str(w.message).startswith(f"{path}: lost: "))
    assert f"line {line}: " in lost and what in lost
    assert network.gen1.pg_set == 40


def test_text_and_empty_tables_mean_nothing_electrical(tmp_path: Path) -> None:
    extra = (
        "mpc.source = 'by hand';\nmpc.notes = {'a', \"b\"; 'c''s'};\nmpc.dcpole = [];\nmpc.areas = [1 1];\n"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        om.read_network(written(tmp_path, CASE5 + extra))


@pytest.mark.parametrize(
    ("column", "value", "lost"),
    [
        ("QC2MAX", "-3", False),  # PC1 = PC2: no curve
        ("RAMP_AGC", "2", True),
        ("RAMP_10", "7", True),
        ("RAMP_10", "Inf", False),
        ("RAMP_30", "7", False),
        ("APF", "0.5", False),
    ],
)
@pytest.mark.parametrize("in_service", [True, False])
def test_columns_of_generators_are_represented_or_refused(
    column: str, value: str, lost: bool, in_service: bool, tmp_path: Path
) -> None:
    more = ["0"] * len(MORE_COLUMNS)
    more[MORE_COLUMNS.index(column)] = value
    head, rows = CASE5.split("mpc.gen = [\n")
    units, rest = rows.split("\n];", 1)
    lines = [row.rstrip(";").rstrip() for row in units.split("\n")]
    assert len(lines[0].split()) == len(COLUMNS["gen"]) + len(MORE_COLUMNS)
    first = lines[1].split()[: len(COLUMNS["gen"])] + more
    first[COLUMNS["gen"].index("GEN_STATUS")] = str(int(in_service))
    lines[1] = " ".join(first)
    path = written(tmp_path, head + "mpc.gen = [\n" + ";\n".join(lines) + "\n];" + rest)
    if lost and in_service:
        with pytest.raises(CaseError, match=rf"line 35: gen2: {column} = {value}"):
            om.read_network(path)
    else:
        unit = om.read_network(path).gen2
        assert unit.ramp == (14 if column == "RAMP_30" else None)


def test_evaluated_statements_are_not_reported() -> None:
    """The distribution systems of MATPOWER convert their units at the end of the file."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        network = om.read_network(SCENARIOS / "data" / "case33bw.m")
    assert network.load2.p == pytest.approx(0.1)


# Out of service ----------------------------------------------------------------------------------


def idle_unit(text: str, unit: str, cost: str) -> str:
    """The case with an additional first generator that is out of service."""
    text = replaced("mpc.gen = [\n", f"mpc.gen = [\n{unit}\n", text)
    return replaced("mpc.gencost = [\n", f"mpc.gencost = [\n{cost}\n", text)


def test_a_unit_out_of_service_with_invalid_data_is_kept_and_noted(tmp_path: Path) -> None:
    """As in most of PGLib's active-power-increase cases; the optimum is the published one."""
    text = (DATA / "pglib" / "pglib_opf_case14_ieee__api.m").read_text()
    text = idle_unit(text, "1 5.4 0 9 -9 1 100 0 2 5.4;", "2 0 0 3 -1 0 0;")
    network = om.read_network(written(tmp_path, text))
    assert (network.gen1.p, network.gen1.cost.c2, network.gen1.in_service) == ((5.4, 2.0), -1.0, False)
    problem = om.MultiStage(network)
    assert any("gen1: p = (5.4, 2.0)" in note for note in problem.notes)
    assert problem.solve().objective == pytest.approx(5.9994e3, rel=1e-4)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = om.read_network(om.write_network(network, tmp_path / "again.m"))
    assert contents(again) == contents(network)


def test_data_of_every_kind_out_of_service_are_kept_in_files(tmp_path: Path) -> None:
    network = om.read_network(DATA / "matpower" / "case5.m")
    idle = {"in_service": False}
    cost = om.PiecewiseLinear([(0.0, 0.0), (0.0, 5.0)])
    points = {"pg_set": 7.0, "qg_set": 0.0, "vm_set": 1.0}
    network.add("gen6", om.Generator("1", p=(math.inf, -1.0), q=(3.0, -3.0), cost=cost, **points, **idle))
    network.add("1-3", om.Branch("1", "3", r=0, x=0, tap=-1, rating=-5, angle=(3, -3), **idle))
    network.add("6", om.Bus(vm=(1.1, 0.9), **idle))
    network.add("storage1", om.Storage("1", energy=5, power=(3, 10), q=(1, -1), initial=99, **idle))
    network.add("load1", om.Load("1", p=math.inf, **idle))
    with pytest.warns(CaseWarning, match="load1: MATPOWER has no status for loads"):
        path = om.write_network(network, tmp_path / "idle.m")
    network.remove("load1")
    assert contents(om.read_network(path)) == contents(network)


@pytest.mark.parametrize("cost", ["2 0 0 4 1 0 0 0", "2 0 0 5 0 1 0 0 0"])
def test_a_unit_out_of_service_with_an_unsupported_cost_is_left_out(cost: str, tmp_path: Path) -> None:
    width = len(cost.split())
    fill = " 0" * (width - 6)
    text = re.sub(r"(2\t0\t0\t2\t[0-9]+\t0);", rf"\1{fill};", CASE5)
    text = idle_unit(text, GENERATOR.replace("100	1", "100	0") + "\t0" * 11 + ";", cost)
    path = written(tmp_path, text)
    with pytest.warns(CaseWarning, match=r"case\.m:58: gen1: cost: a polynomial of degree 3.* left out"):
        network = om.read_network(path)
    assert list(network.of(om.Generator)) == ["gen2", "gen3", "gen4", "gen5", "gen6"]


# Mutations ---------------------------------------------------------------------------------------

NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?|[-+]?(Inf|NaN)")
Rows = list[list[float]]


def matlab(text: str) -> dict[str, Rows | float | str]:
    """A case of plain numbers as MATLAB reads it, by a minimal parser that raises where MATLAB stops."""
    words = re.findall(r"[\[\];,=\n]|'[^'\n]*'|[^\s\[\];,='\n]+|'", re.sub("%.*", "", text) + "\n")
    assigned: dict[str, Rows | float | str] = {}
    at = 0
    while at < len(words):
        if words[at] in ("\n", ";", ","):
            at += 1
        elif words[at] == "function":
            if at > 0 and any(w not in "\n;," for w in words[:at]):
                break
            if words[at + 1 : at + 3] != ["mpc", "="] or not re.fullmatch(r"\w+", words[at + 3]):
                raise ValueError(words[at : at + 4])
            at += 4
        else:
            name, equals = words[at], words[at + 1]
            if equals != "=" or not re.fullmatch(r"[A-Za-z]\w*(\.\w+)?", name):
                raise ValueError((name, equals))
            assigned[name], at = value(words, at + 2)
            if words[at] not in ("\n", ";", ","):
                raise ValueError(words[at])
    return assigned


def value(words: list[str], at: int) -> tuple[Rows | float | str, int]:
    """A table, number or string, and the position of the next word."""
    if words[at] != "[":
        if words[at].startswith("'") and len(words[at]) > 1:
            return words[at], at + 1
        return plain(words[at]), at + 1
    rows: Rows = [[]]
    at += 1
    while words[at] != "]":
        if words[at] in (";", "\n"):
            rows.append([])
        elif words[at] == ",":
            if not rows[-1]:
                raise ValueError(",")
        else:
            rows[-1].append(plain(words[at]))
        at += 1  # beyond the end of the file: IndexError
    rows = [row for row in rows if row]
    if len({len(row) for row in rows}) > 1:
        raise ValueError("rows of different length")
    return rows, at + 1


def plain(word: str) -> float:
    if not NUMBER.fullmatch(word):
        raise ValueError(word)
    return float(word)


def expected(case: dict) -> dict:
    """Components of a case according to MATPOWER's manual."""
    found: dict[str, object] = {}

    def add(name: str, component: object) -> None:
        number = 1 + sum(1 for n in found if n.partition("#")[0] == name)
        found[name if number == 1 else f"{name}#{number}"] = component

    for b in case["mpc.bus"]:
        number = f"{b[0]:.15g}"
        add(
            number,
            om.Bus(vm=(b[12], b[11]), base_kv=b[9] or None, reference=b[1] == 3,
                   va_set=b[8] if b[1] == 3 else 0.0, in_service=b[1] != 4),
        )  # fmt: skip
        if b[2] or b[3]:
            add(f"load{number}", om.Load(number, p=b[2], q=b[3], in_service=b[1] != 4))
        if b[4] or b[5]:
            add(f"shunt{number}", om.Shunt(number, g=b[4], b=b[5], in_service=b[1] != 4))
    stated = [next((v for v in (r[7], r[6]) if v and v != float("inf")), None) for r in case["mpc.branch"]]
    repeated = all(value in (None, r[5]) for value, r in zip(stated, case["mpc.branch"], strict=True))
    for r, emergency in zip(case["mpc.branch"], stated, strict=True):
        ends = [f"{n:.15g}" for n in r[:2]]
        angle = (-360.0, 360.0) if r[11] == r[12] == 0 else (r[11], r[12])
        add(
            "-".join(ends),
            om.Branch(*ends, r=r[2], x=r[3], b=r[4], rating=r[5] or None, emergency_rating=None if repeated else emergency, tap=r[8] or 1.0, shift=r[9], angle=angle,
                      in_service=r[10] != 0),
        )  # fmt: skip
    load_buses = {b[0] for b in case["mpc.bus"] if b[1] == 1}
    for i, (g, c) in enumerate(zip(case["mpc.gen"], case["mpc.gencost"], strict=False), start=1):
        count = int(c[3])
        assert count == c[3] >= 1, "accepted without a valid number of cost coefficients"
        numbers = c[4 : 4 + count * (2 if c[0] == 1 else 1)]
        ramp = 2 * g[18] if len(g) > 18 and g[18] else None
        if c[0] == 1:
            cost = om.PiecewiseLinear(list(zip(numbers[0::2], numbers[1::2], strict=True)))
        else:
            assert c[0] == 2 and len(numbers) == count and not any(numbers[:-3])
            cost = om.Polynomial(*([0.0] * (3 - count) + numbers[-3:]))
        add(
            f"gen{i}",
            om.Generator(f"{g[0]:.15g}", p=(g[9], g[8]), q=(g[4], g[3]), ramp=ramp, cost=cost, pg_set=g[1], qg_set=g[2],
                         vm_set=g[5] or None, regulates=g[0] not in load_buses, in_service=g[7] > 0),
        )  # fmt: skip
    for s in case.get("mpc.storage", []):
        number = f"{s[0]:.15g}"
        add(
            f"storage{number}",
            om.Storage(number, energy=s[4], power=(-s[6], s[5]), q=(s[10], s[11]), initial=s[3],
                       charge_efficiency=s[7], discharge_efficiency=s[8], rating=s[9] if s[9] > 0 else None,
                       ps_set=s[1] or None, qs_set=s[2] or None, in_service=s[16] != 0),
        )  # fmt: skip
    return found


def mutated(text: str, rng: random.Random) -> str:
    """Change one word of the text, swap two lines, or truncate it."""
    words = list(re.finditer(r"[^\s;]+|;", text))
    word = rng.choice(words[len(words) // 20 :])  # less often in the comments at the top
    kind = rng.choice(["delete", "double", "replace", "replace", "replace", "swap", "cut"])
    if kind == "cut":
        return text[: rng.randrange(len(text))]
    if kind == "swap":
        lines = text.split("\n")
        one, other = rng.randrange(len(lines)), rng.randrange(len(lines))
        lines[one], lines[other] = lines[other], lines[one]
        return "\n".join(lines)
    new = {"delete": "", "double": f"{word[0]} {word[0]}"}.get(kind)
    if new is None:
        new = rng.choice(
            ["NaN", "-1", "0", "2", "1e-9", "1.5", "Inf", "-Inf", "text", "1,2", "]", "[", "%", "'"]
        )
    return text[: word.start()] + new + text[word.end() :]


@pytest.mark.parametrize("case", ["case5", "case30pwl"])
def test_mutated_files_are_read_as_matlab_does_or_refused(case: str, tmp_path: Path) -> None:
    original = (DATA / "matpower" / f"{case}.m").read_text() + "\n" + STORAGE
    rng = random.Random(9)
    outcomes = {"read": 0, "refused": 0}
    for number in range(300):
        text = mutated(original, rng)
        path = written(tmp_path, text)
        try:
            meant = matlab(text)
        except (ValueError, IndexError):
            meant = None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", CaseWarning)
                network = om.read_network(path)
        except CaseError as error:
            assert str(error).startswith(str(path)), text
            assert str(error).isprintable(), str(error)
            outcomes["refused"] += 1
            continue
        assert meant is not None, (number, "read although MATLAB refuses it", text)
        assert repr(sorted(contents(network).items())) == repr(sorted(expected(meant).items())), number
        assert network.base_mva == meant["mpc.baseMVA"]
        outcomes["read"] += 1
    assert min(outcomes.values()) >= 50, outcomes
