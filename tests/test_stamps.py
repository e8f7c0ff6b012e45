"""Time stamps of series: files, pandas, zones, days of 23 and 25 hours, and resampling."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from test_calendar import one_bus

import opfmodel as om
from opfmodel.data.calendar import Calendar
from opfmodel.data.columns import read_columns
from opfmodel.data.grid import Grid
from opfmodel.data.stamps import calendar_of, in_utc
from opfmodel.errors import ProfileError, ScenarioError

ZONES = [
    "UTC",
    "Europe/Berlin",
    "America/New_York",
    "Australia/Lord_Howe",
    "Asia/Kathmandu",
    "Pacific/Chatham",
]
STEPS = {"15min": 0.25, "30min": 0.5, "h": 1.0, "7min": 7 / 60, "6h": 6.0}


def place(row: int) -> str:
    return f"row {row}: "


# Against the arithmetic of pandas --------------------------------------------------------------------


@st.composite
def indices(draw: Any) -> pd.DatetimeIndex:
    zone, freq = draw(st.sampled_from(ZONES)), draw(st.sampled_from(sorted(STEPS)))
    day = draw(st.dates(date(2024, 1, 1), date(2026, 12, 30)))
    if draw(st.booleans()):  # near a change of clocks, of which there are few
        day = draw(st.sampled_from([date(2025, 3, 29), date(2025, 10, 25), date(2025, 3, 9), date(2025, 11, 1),
                                    date(2025, 4, 5), date(2025, 10, 4), date(2025, 2, 23), date(2025, 4, 6)]))  # fmt: skip
    start = pd.Timestamp(day).tz_localize("UTC") + pd.Timedelta(minutes=draw(st.integers(0, 1439)))
    return pd.date_range(start, periods=draw(st.integers(2, 150)), freq=freq).tz_convert(zone)


@settings(max_examples=300)
@given(indices())
def test_stamps_are_those_of_pandas(index: pd.DatetimeIndex) -> None:
    zone, utc = str(index.tz), index.tz_convert("UTC").tz_localize(None).to_numpy()
    aware = [stamp.isoformat() for stamp in index]
    assert (in_utc(aware, "Asia/Tokyo", place) == utc).all()
    calendar = calendar_of(in_utc(aware, zone, place), zone, place)
    assert calendar.start == utc[0]
    assert calendar.has_step(STEPS[index.freqstr])
    assert (calendar.stamps(len(index)) == utc).all()
    shown = [f"{stamp:%Y-%m-%d %H:%M} {stamp.tzname()}" for stamp in index]
    assert [calendar.shown(step) for step in range(len(index))] == shown


@settings(max_examples=300)
@given(indices())
def test_local_stamps_are_told_apart_by_their_order(index: pd.DatetimeIndex) -> None:
    zone = str(index.tz)
    local = index.tz_localize(None)
    clear = ~local[:2].tz_localize(zone, ambiguous="NaT").isna()
    if not clear[0]:
        with pytest.raises(ProfileError, match="exists twice"):
            in_utc([stamp.isoformat() for stamp in local], zone, place)
        return
    assume(clear[1])  # the first two rows tell the step
    utc = index.tz_convert("UTC").tz_localize(None).to_numpy()
    assert (in_utc([str(stamp) for stamp in local], zone, place) == utc).all()
    assert (in_utc(local.to_numpy(), zone, place) == utc).all()
    assert (in_utc(list(local.to_pydatetime()), zone, place) == utc).all()


@settings(max_examples=200)
@given(indices(), st.data())
def test_a_missing_duplicate_or_exchanged_row_is_refused(index: pd.DatetimeIndex, data: Any) -> None:
    assume(len(index) >= 5)
    row = data.draw(st.integers(1, len(index) - 2))
    utc = index.tz_convert("UTC").tz_localize(None).to_numpy()
    exchanged = utc.copy()
    exchanged[[row, row + 1]] = utc[[row + 1, row]]
    for rows, at, words in (
        (np.delete(utc, row), row, "1 row is missing"),
        (np.insert(utc, row, utc[row]), row + 1, "the same time twice"),
        (exchanged, None, "missing|order|other rows have steps"),
    ):
        with pytest.raises(ProfileError, match=rf"row {at or '[0-9]+'}: .*({words})"):
            calendar_of(rows, "UTC", place)


@pytest.mark.parametrize(
    ("day", "hours", "quarters"), [("2025-03-30", 23, 92), ("2025-10-26", 25, 100), ("2025-10-27", 24, 96)]
)
def test_local_days_have_23_24_or_25_hours(tmp_path: Path, day: str, hours: int, quarters: int) -> None:
    index = pd.date_range(day, periods=quarters, freq="15min", tz="Europe/Berlin")
    assert index[-1] + pd.Timedelta("15min") == pd.Timestamp(day, tz="Europe/Berlin") + pd.DateOffset(days=1)
    table = pd.DataFrame({"time": index.tz_localize(None), "town.p": np.arange(quarters)})
    path = tmp_path / "day.csv"
    table.to_csv(path, index=False)
    calendar = read_columns(path).calendar("Europe/Berlin")
    assert calendar is not None
    assert calendar.stamps(quarters)[-1] == index[-1].tz_convert("UTC").tz_localize(None)
    assert quarters / 4 == hours
    if hours != 24:  # not a day in UTC
        with pytest.raises(ProfileError, match=r"line \d+, column 'time': .*unless a zone is stated"):
            read_columns(path).calendar(None)


# Series of pandas ------------------------------------------------------------------------------------


def frame(
    zone: str | None = "Europe/Berlin", rows: int = 12, start: str = "2025-03-30", **columns: Any
) -> pd.DataFrame:
    index = pd.date_range(start, periods=rows, freq="15min", tz=zone)
    return pd.DataFrame({"town.p": np.arange(10.0, 10 + rows), **columns}, index)


def test_a_problem_has_the_calendar_of_a_frame() -> None:
    problem = om.MultiStage(one_bus(), 3, formulation="dc", profiles=frame())
    assert problem.step == 0.25
    assert problem.profiles.calendar == Calendar(np.datetime64("2025-03-29T23:00"), 0.25, "Europe/Berlin")
    data = problem.solve(1).data
    assert data["pd"].values.ravel() == pytest.approx([16, 17, 18])
    assert (data["time"].values == frame().index[1:4].tz_convert("UTC").tz_localize(None)).all()


def test_series_of_pandas_are_cut_to_a_common_start() -> None:
    earlier, later = frame()["town.p"], frame(rows=4, start="2025-03-30T00:30")["town.p"] * 2
    made = om.Profiles({"town.p": earlier, "works.p": later, "town.q": [1, 2, 3]})
    assert made["town.p"].tolist() == earlier.iloc[2:].tolist()
    assert made["works.p"].tolist() == later.tolist()
    assert made["town.q"].tolist() == [1, 2, 3]
    assert made.calendar == Calendar(np.datetime64("2025-03-29T23:30"), 0.25, "Europe/Berlin")


def test_naive_series_are_in_the_zone_of_the_calendar_or_utc() -> None:
    naive = frame(None)
    assert om.Profiles(naive).calendar == Calendar(np.datetime64("2025-03-30T00:00"), 0.25, "UTC")
    berlin = Calendar(np.datetime64("2025-03-29T23:15"), 0.25, "Europe/Berlin")
    with pytest.raises(ProfileError, match=r"row 8: .*02:00:00: does not exist in Europe/Berlin"):
        om.Profiles(naive, berlin)
    assert om.Profiles(naive.iloc[:8], berlin)["town.p"].tolist() == naive["town.p"].iloc[1:8].tolist()


@pytest.mark.parametrize("zone", [None, "UTC", "Europe/Berlin"])
def test_numbered_series_of_pandas_have_no_stamps(zone: str | None) -> None:
    del zone
    made = om.Profiles(pd.DataFrame({"town.p": [1.0, 2.0]}))
    assert made.calendar is None
    assert made["town.p"].tolist() == [1, 2]


def other(change: str) -> Any:
    index = frame().index
    return {
        "gap": frame().drop(index[3]),
        "duplicate": frame().iloc[[0, 1, 2, 2, 3, 4, 5]],
        "order": frame().iloc[[0, 1, 3, 2, 4, 5, 6, 7]],
        "missing value": frame().where(frame() != 12),
        "missing stamp": frame().set_axis(index.where(index != index[4])),
        "step": {"town.p": frame()["town.p"], "works.p": frame()["town.p"].resample("1h").mean()},
        "phase": {"town.p": frame()["town.p"], "works.p": frame(start="2025-03-30T00:05")["town.p"]},
        "overlap": {"town.p": frame()["town.p"], "works.p": frame(start="2025-04-30")["town.p"]},
        "single": frame(rows=1),
        "index": frame().set_axis([str(stamp) for stamp in index]),
        "period": frame(None).to_period("15min"),
    }[change]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            "gap",
            r"'town\.p': row 3: 2025-03-30 01:00 CET follows 2025-03-30 00:30 CET: 1 row is missing .*15 min",
        ),
        ("duplicate", r"row 3: .*the same time twice"),
        ("order", r"row 2: .*1 row is missing|row 3: .*order"),
        ("missing value", r"'town\.p': row 2: 2025-03-30 00:30 CET: the value is missing"),
        ("missing stamp", r"row 4: the time is missing"),
        ("step", r"'works\.p': .*steps of 1 h, not of 15 min|'town\.p': .*steps of 15 min, not of 1 h"),
        ("phase", r"between the stamps"),
        (
            "overlap",
            r"'town\.p': ends at 2025-03-30 04:00 CEST, before the first step at 2025-04-30 00:00 CEST",
        ),
        ("single", r"a single time does not tell the length"),
        ("index", r"the index is a Index of object; must be a DatetimeIndex"),
        ("period", r"the index is a PeriodIndex"),
    ],
)
def test_series_of_pandas_are_checked(change: str, words: str) -> None:
    with pytest.raises(ProfileError, match=words):
        om.Profiles(other(change))


def test_a_series_that_begins_after_the_calendar_is_refused() -> None:
    with pytest.raises(ProfileError, match=r"'town\.p': .*later than the first step"):
        om.Profiles(frame(), Calendar(np.datetime64("2025-03-29T22:45"), 0.25))


def test_pandas_is_not_imported_for_plain_series() -> None:
    code = "import opfmodel as om, sys; om.Profiles({'town.p': [1]}); assert 'pandas' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


# Files -----------------------------------------------------------------------------------------------

NETWORK = """
network:
  buses: {b: {reference: true}}
  generators: {g: {bus: b, p: [0, 200], cost: {c1: 10}}}
  loads: {town: {bus: b, p: 5}, works: {bus: b, p: 1}}
controller: {formulation: dc}
"""


def write(folder: Path, table: pd.DataFrame, suffix: str, naive: bool = True) -> Path:
    """Write a table whose index becomes the column of times."""
    path = folder / f"series{suffix}"
    made = table.tz_localize(None) if naive else table
    if suffix == ".csv":
        made.to_csv(path, index_label="Zeitpunkt")
    elif suffix == ".xlsx":
        made.to_excel(path, index_label="Zeitpunkt")
    else:
        made.rename_axis("Zeitpunkt").reset_index().to_parquet(path)
    return path


def load(folder: Path, time: str, rule: str = "table: {file: series.csv}", more: str = "") -> om.Scenario:
    path = folder / "s.yaml"
    path.write_text(f"{NETWORK}time: {time}\nprofiles:\n  - {rule}\n{more}")
    return om.load_scenario(path)


@pytest.mark.parametrize("suffix", [".csv", ".xlsx", ".parquet"])
def test_rows_of_files_are_found_by_their_times(tmp_path: Path, suffix: str) -> None:
    table = frame(rows=20)
    write(tmp_path, table, suffix)
    rule = f"table: {{file: series{suffix}}}"
    read = load(tmp_path, "{zone: Europe/Berlin, steps: 20}", rule)
    assert read.profiles["town.p"].tolist() == table["town.p"].tolist()
    assert read.profiles.calendar == Calendar(np.datetime64("2025-03-29T23:00"), 0.25, "Europe/Berlin")
    assert read.problem.step == 0.25
    later = load(tmp_path, "{start: 2025-03-30T01:45, zone: Europe/Berlin, step: 15 min, steps: 4}", rule)
    assert later.profiles["town.p"].tolist() == [17, 18, 19, 20]
    assert later.profiles.calendar == Calendar(np.datetime64("2025-03-30T00:45"), 0.25, "Europe/Berlin")


def test_times_with_offsets_need_no_zone(tmp_path: Path) -> None:
    write(tmp_path, frame(), ".parquet", naive=False)
    frame().to_csv(tmp_path / "series.csv", index_label="when")
    for rule in ("table: {file: series.parquet}", "table: {file: series.csv}"):
        read = load(tmp_path, "{steps: 3}", rule)
        assert read.profiles.calendar == Calendar(np.datetime64("2025-03-29T23:00"), 0.25, "UTC")


def test_numbered_rows_stand_beside_rows_with_times(tmp_path: Path) -> None:
    write(tmp_path, frame(), ".csv")
    (tmp_path / "numbered.csv").write_text("time,works.p\n0,7\n1,8\n2,9\n")
    rule = "table: {file: numbered.csv}\n  - table: {file: series.csv}"
    read = load(tmp_path, "{start: 2025-03-30T00:30, zone: Europe/Berlin, steps: 3}", rule)
    assert read.profiles["works.p"].tolist() == [7, 8, 9]
    assert read.profiles["town.p"].tolist() == [12, 13, 14]


def test_a_byte_order_mark_and_quoted_headings_are_read(tmp_path: Path) -> None:
    text = '\ufeff"time","town.p","a, note"\r\n"2025-03-30 00:00","1",x\r\n"2025-03-30 00:15","2",y\r\n'
    (tmp_path / "series.csv").write_bytes(text.encode())
    assert load(tmp_path, "{steps: 2}").profiles["town.p"].tolist() == [1, 2]


CSV = "time,town.p\n2025-03-30 00:00,1\n2025-03-30 00:15,2\n2025-03-30 00:30,3\n2025-03-30 00:45,4\n"


@pytest.mark.parametrize(
    ("text", "time", "words"),
    [
        (CSV.replace("00:30", "00:15"), "{}", "series.csv: line 4, column 'time': .*the same time twice"),
        (CSV.replace("2025-03-30 00:15,2\n", ""), "{}", "line 3, column 'time': .*1 row is missing at steps of 15 min"),
        (CSV.replace("00:30", "00:10"), "{}", "line 4, column 'time': .*order of time"),
        (CSV.replace("00:30", "00:31"), "{}", "line 4, column 'time': .*the other rows have steps of 15 min"),
        (CSV.replace("2025-03-30 00:30", ""), "{}", "line 4, column 'time': the time is missing"),
        (CSV.replace("2025-03-30 00:30", "noon"), "{}", "line 4, column 'time': 'noon': must be a time in ISO 8601"),
        (CSV.replace("2025-03-30 ", "30.03.2025 "), "{}", "line 2, column 'time': '30.03.2025 00:00': must be .*ISO"),
        (CSV.replace("2025-03-30 ", "30.03.2025 ").replace("time", "Zeit"), "{}", "line 2, column 'Zeit': .*ISO"),
        (CSV.replace("00:30", "00:30+02:00"), "{}", "line 4, .*has an offset from UTC, unlike the rows before"),
        (CSV.replace(",3", ","), "{}", "line 4, column 'town.p': '' is not a number"),
        (CSV.replace(",3", ",nan"), "{}", "line 4, column 'town.p': 'nan' is not a number"),
        (CSV, "{step: 1.0}", "series.csv: time series have steps of 15 min, not of 1 h; .*resample"),
        (CSV, "{start: 2025-03-29T23:00}", "begin at 2025-03-30 00:00 UTC, later than the first step"),
        (CSV, "{start: 2025-03-30T00:05, step: 0.25}", "between the stamps"),
        (CSV, "{steps: 5}", "the data end at 2025-03-30 01:00 UTC; 5 from 2025-03-30 00:00 UTC on are needed"),
        (CSV.replace(" 00", " 02"), "{zone: Europe/Berlin}", "line 2, .*02:00:00: does not exist in Europe/Berlin"),
        (CSV.replace("03-30 00", "10-26 02"), "{zone: Europe/Berlin}", "line 2, .*02:00:00: exists twice .*write"),
        (CSV.replace("2025", "0001"), "{}", "line 2, .*ISO 8601"),
        ("time,town.p\n2025-03-30,1\n", "{}", "a single time does not tell the length of the steps"),
        ("step,town.p\n0,1\n", "{zone: Europe/Berlin}", r"time\.zone: there are no times"),
    ],
)  # fmt: skip
def test_times_of_files_are_checked(tmp_path: Path, text: str, time: str, words: str) -> None:
    (tmp_path / "series.csv").write_text(text)
    with pytest.raises(ScenarioError, match=words):
        load(tmp_path, time)


@pytest.mark.parametrize(
    ("rule", "words"),
    [
        (
            "table: {file: series.csv, time_column: when}",
            "no column 'when' of times; columns are: time, town.p",
        ),
        ("table: {file: series.csv, time_column: town.p}", "line 2, column 'town.p': '1': must be a time"),
        ("table: {file: series.csv, resample: median}", "'mean', 'interpolate'|'mean' or 'interpolate'"),
        ("table: {file: numbered.csv, resample: mean}", "numbered.csv: resample needs a column of times"),
    ],
)
def test_options_of_times_are_checked(tmp_path: Path, rule: str, words: str) -> None:
    (tmp_path / "series.csv").write_text(CSV)
    (tmp_path / "numbered.csv").write_text("town.p\n1\n")
    with pytest.raises(ScenarioError, match=words):
        load(tmp_path, "{}", rule)


def test_a_column_of_times_may_be_named(tmp_path: Path) -> None:
    (tmp_path / "series.csv").write_text(CSV.replace("time,town.p", "made,town.p,valid").replace("\n2025", "\n1999")
                                         .replace(",4\n", ",4,2025-03-30 03:00\n").replace(",3\n", ",3,2025-03-30 02:00\n")
                                         .replace(",2\n", ",2,2025-03-30 01:00\n").replace(",1\n", ",1,2025-03-30 00:00\n"))  # fmt: skip
    read = load(tmp_path, "{steps: 4}", "table: {file: series.csv, time_column: valid}")
    assert read.profiles.calendar == Calendar(np.datetime64("2025-03-30"), 1.0, "UTC")


@pytest.mark.parametrize(
    ("suffix", "content", "words"),
    [
        (".xlsx", b"time,town.p\n", "not an Excel workbook, or damaged"),
        (".parquet", b"time,town.p\n", "not a Parquet file, or damaged"),
        (".parquet", b"PAR1" + bytes(40) + b"PAR1", "not a Parquet file, or damaged"),
    ],
)
def test_damaged_files_are_refused(tmp_path: Path, suffix: str, content: bytes, words: str) -> None:
    (tmp_path / f"series{suffix}").write_bytes(content)
    with pytest.raises(ScenarioError, match=rf"series{suffix}: {words}"):
        load(tmp_path, "{}", f"table: {{file: series{suffix}}}")


def test_a_workbook_that_unpacks_to_gigabytes_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "series.xlsx", "w", zipfile.ZIP_DEFLATED) as archive:
        for sheet in range(11):
            archive.writestr(f"xl/worksheets/sheet{sheet}.xml", bytes(100_000_000))
    with pytest.raises(ScenarioError, match="1,100 MB unpacked; at most 1,000 MB"):
        load(tmp_path, "{}", "table: {file: series.xlsx}")


def test_excel_files_without_openpyxl_tell_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path, frame(), ".xlsx")
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(ScenarioError, match=r"need the package openpyxl; .*opfmodel\[excel\]"):
        load(tmp_path, "{}", "table: {file: series.xlsx}")


@pytest.mark.parametrize("suffix", [".xlsx", ".parquet"])
def test_cells_of_tables_are_located(tmp_path: Path, suffix: str) -> None:
    write(tmp_path, frame(rows=6).where(frame(rows=6)["town.p"] != 13), suffix)
    row = 5 if suffix == ".xlsx" else 4
    with pytest.raises(
        ScenarioError, match=rf"series{suffix}: row {row}, column 'town.p': (the value is missing|nan)"
    ):
        load(tmp_path, "{zone: Europe/Berlin}", f"table: {{file: series{suffix}}}")


def test_a_shape_follows_times(tmp_path: Path) -> None:
    (tmp_path / "series.csv").write_text(CSV.replace("town.p", "load"))
    read = load(
        tmp_path,
        "{start: 2025-03-30T00:15, steps: 2}",
        "shape: {file: series.csv, column: load, loads: [town]}",
    )
    assert read.profiles["town.p"] == pytest.approx([5 * 2 / 2.5, 5 * 3 / 2.5])


def test_limits_and_set_points_follow_times(tmp_path: Path) -> None:
    (tmp_path / "series.csv").write_text(CSV)
    (tmp_path / "limit.csv").write_text(CSV.replace("town.p", "least"))
    (tmp_path / "aim.csv").write_text(CSV.replace("town.p", "g.pg"))
    more = (
        "constraints: {own: {terms: {g.pg: 1}, at_least: {file: limit.csv, column: least}}}\n"
        "cost: {setpoint-tracking: {setpoints: {g.pg: 1}, weights: {pg: 1}}}\n"
    )
    read = load(tmp_path, "{start: 2025-03-30T00:15, steps: 2}", more=more.splitlines()[0] + "\n")
    assert read.problem.constraints["own"].at_least.tolist() == [2, 3]


@pytest.mark.parametrize("at_end", ["error", "repeat"])
def test_forecasts_of_files_follow_times(tmp_path: Path, at_end: str) -> None:
    (tmp_path / "series.csv").write_text(CSV)
    (tmp_path / "forecast.csv").write_text(CSV.replace(",", ",1").replace("1town", "town"))
    steps = 3 if at_end == "error" else 7
    read = load(
        tmp_path, f"{{start: 2025-03-30T00:15, steps: {steps}, at_end: {at_end}}}",
        more="forecast: {file: {file: forecast.csv}}\nplant: power-flow\n",
    )  # fmt: skip
    expected = read.forecast.expected(read.profiles, 1, 2)
    assert expected["town.p"].tolist() == [13, 14]
    if at_end == "repeat":
        assert read.profiles["town.p"].tolist() == [2, 3, 4, 1, 2, 3, 4]
        assert read.forecast.expected(read.profiles, 5, 2)["town.p"].tolist() == [13, 14]
    else:
        with pytest.raises(ProfileError, match="the forecast issued at step 0 has 3 rows"):
            read.forecast.expected(read.profiles, 2, 2)


def test_issued_forecasts_begin_when_they_were_issued(tmp_path: Path) -> None:
    (tmp_path / "series.csv").write_text(CSV)
    rows = ["issued,time,town.p", "0,2025-03-30 00:00,7", "0,2025-03-30 00:15,8", "1,2025-03-30 00:15,9"]
    (tmp_path / "forecast.csv").write_text("\n".join([*rows, "1,2025-03-30 00:30,9", ""]))
    more = "forecast: {file: {file: forecast.csv}}\nplant: power-flow\n"
    read = load(tmp_path, "{steps: 2}", more=more)
    assert read.forecast.expected(read.profiles, 1, 2)["town.p"].tolist() == [9, 9]
    shifted = "\n".join(rows).replace("1,2025-03-30 00:15,9", "1,2025-03-30 00:00,9\n1,2025-03-30 00:15,9")
    (tmp_path / "forecast.csv").write_text(shifted + "\n")
    with pytest.raises(ScenarioError, match=r"line 4, .*issued at step 1 must begin at 2025-03-30 00:15 UTC"):
        load(tmp_path, "{steps: 2}", more=more)


# Resampling ------------------------------------------------------------------------------------------


def fitted(table: pd.Series, grid: Grid, method: str | None, folder: Path) -> np.ndarray:
    path = folder / "series.csv"
    table.to_frame("town.p").to_csv(path, index_label="time")
    return grid.fit(read_columns(path), method).values["town.p"]  # type: ignore[arg-type]


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from([(5, 15), (15, 60), (60, 15), (60, 60), (20, 30), (30, 20), (15, 45)]),
    st.lists(st.floats(-1e3, 1e3, allow_nan=False), min_size=12, max_size=48),
)
def test_means_keep_the_energy(
    tmp_path_factory: pytest.TempPathFactory, minutes: tuple[int, int], values: list[float]
) -> None:
    source, target = minutes
    steps = len(values) * source // target
    index = pd.date_range("2025-03-30", periods=len(values), freq=f"{source}min", tz="UTC")
    made = fitted(pd.Series(values, index), Grid(steps, target / 60), "mean", tmp_path_factory.mktemp("mean"))
    fine = pd.Series(values, index).resample("1min").ffill()  # pandas: hold, then average
    fine = fine.reindex(pd.date_range(index[0], periods=len(values) * source, freq="1min")).ffill()
    expected = fine.resample(f"{target}min").mean().to_numpy()[:steps]
    assert made == pytest.approx(expected, abs=1e-9)


def test_interpolation_joins_the_values_by_lines(tmp_path: Path) -> None:
    index = pd.date_range("2025-03-30", periods=3, freq="1h", tz="UTC")
    made = fitted(pd.Series([0.0, 4.0, 2.0], index), Grid(12, 0.25), "interpolate", tmp_path)
    assert made.tolist() == [0, 1, 2, 3, 4, 3.5, 3, 2.5, 2, 2, 2, 2]
    with pytest.raises(ProfileError, match="the data end at 2025-03-30 03:00 UTC; 13 from"):
        fitted(pd.Series([0.0, 4.0, 2.0], index), Grid(13, 0.25), "interpolate", tmp_path)


def test_resampling_may_begin_within_a_row(tmp_path: Path) -> None:
    index = pd.date_range("2025-03-30", periods=4, freq="1h", tz="UTC")
    grid = Grid(2, 1.0, np.datetime64("2025-03-30T00:30"))
    assert fitted(pd.Series([1.0, 2.0, 4.0, 8.0], index), grid, "mean", tmp_path).tolist() == [1.5, 3.0]


def test_infinite_limits_are_averaged_but_not_interpolated(tmp_path: Path) -> None:
    (tmp_path / "series.csv").write_text("time,a.rating\n2025-03-30T00:00,inf\n2025-03-30T00:30,5\n")
    read = read_columns(tmp_path / "series.csv", unlimited=True)
    assert Grid(4, 0.25).fit(read, "mean").values["a.rating"].tolist() == [np.inf, np.inf, 5, 5]
    with pytest.raises(ProfileError, match=r"series\.csv: .*infinite values"):
        Grid(4, 0.25).fit(read, "interpolate")


def test_a_scenario_resamples_when_asked(tmp_path: Path) -> None:
    (tmp_path / "series.csv").write_text(CSV)
    read = load(tmp_path, "{step: 30 min, steps: 2}", "table: {file: series.csv, resample: mean}")
    assert read.profiles["town.p"].tolist() == [1.5, 3.5]
    with pytest.raises(ScenarioError, match="4 rows of 15 min are too short for a step of 2 h"):
        load(tmp_path, "{step: 2.0}", "table: {file: series.csv, resample: mean}")


# A closed loop over a change of clocks ---------------------------------------------------------------


@pytest.mark.parametrize("days", [("2025-03-29", 2, 188), ("2025-10-25", 2, 196)])
def test_two_days_with_a_change_of_clocks_run_two_days(tmp_path: Path, days: tuple[str, int, int]) -> None:
    first, number, quarters = days
    index = pd.date_range(first, pd.Timestamp(first) + pd.DateOffset(days=number), freq="15min",
                          tz="Europe/Berlin", inclusive="left")  # fmt: skip
    assert len(index) == quarters
    hour = np.arange(quarters) / 4
    table = pd.DataFrame({"town.p": 60 + 25 * np.sin(hour / 4), "works.p": 5.0}, index)
    write(tmp_path, table, ".csv")
    path = tmp_path / "s.yaml"
    path.write_text(
        NETWORK.replace(
            "controller: {formulation: dc}", "  storages: {cell: {bus: b, energy: 20, power: 5, initial: 8}}"
        )
        + f"time: {{start: {first}T00:00, zone: Europe/Berlin, step: 15 min, steps: {quarters}, at_end: shrink}}\n"
        "profiles: [{table: {file: series.csv}}]\n"
        "controller: {formulation: dc, horizon: 8, solver: clarabel}\n"
    )
    scenario = om.load_scenario(path)
    run = scenario.simulate()
    assert run.status == "done", run.termination
    assert run.data.sizes["time"] == quarters
    assert (run.data["time"].values == index.tz_convert("UTC").tz_localize(None).to_numpy()).all()
    assert run.data["time"].attrs["zone"] == "Europe/Berlin"
    assert run.data["pd"].values.ravel() == pytest.approx(table.sum(axis=1).to_numpy())
    with pytest.raises(ScenarioError, match=r"the data end at \d+-\d+-\d+ 00:00 CES?T"):
        path.write_text(path.read_text().replace("at_end: shrink", "at_end: error"))
        om.load_scenario(path)
