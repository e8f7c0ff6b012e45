"""CSV files: reading of columns, and immediate refusal of invalid files."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from opfmodel.data import rows
from opfmodel.data.columns import read_columns
from opfmodel.errors import ProfileError, ScenarioError
from opfmodel.scenario import load_scenario

TEXT = "# MW\nhour,a.p,b.p,issued\n0,1,2,0\n\n1,3,4,0\n# later\n2,5,6,1\n"


def write(folder: Path, content: str | bytes) -> Path:
    path = folder / "series.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def test_columns_have_values_and_lines(tmp_path: Path) -> None:
    read = read_columns(write(tmp_path, TEXT))
    assert {heading: values.tolist() for heading, values in read.values.items()} == {
        "a.p": [1, 3, 5],
        "b.p": [2, 4, 6],
    }
    assert list(read.lines) == [3, 5, 7]
    assert read.place("b.p", 2).endswith("series.csv: line 7, column 'b.p': ")


def test_a_comment_with_a_quotation_mark_swallows_no_rows(tmp_path: Path) -> None:
    read = read_columns(write(tmp_path, 'town.p\n# note,"a\n1\n2\n"# end, b",3\n# end,"b\n3\n4\n5\n'), 3)
    assert read.values["town.p"].tolist() == [1, 2, 3]
    assert list(read.lines) == [3, 4, 7]


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_quoted_cells_and_any_end_of_line_are_read(tmp_path: Path, end: str) -> None:
    read = read_columns(write(tmp_path, end.join(['"a, b.p",c.p', '"1",2', "3,4"])))
    assert {heading: values.tolist() for heading, values in read.values.items()} == {
        "a, b.p": [1, 3],
        "c.p": [2, 4],
    }
    assert list(read.lines) == [2, 3]


def test_a_byte_order_mark_is_ignored(tmp_path: Path) -> None:
    assert read_columns(write(tmp_path, b"\xef\xbb\xbftown.p\n1\n")).values["town.p"].tolist() == [1]


def test_columns_are_selected(tmp_path: Path) -> None:
    path = write(tmp_path, TEXT)
    assert list(read_columns(path, headings=["hour"]).values) == ["hour"]
    assert list(read_columns(path, headings=["hour"], optional=["none", "issued"]).values) == [
        "hour",
        "issued",
    ]


@pytest.mark.parametrize(
    "rest", [b"3,many\n", b"3,4,5\n", b"3,\xff\n", b"\0" * 100, b"\n" * 10 + b"1" * 200_000]
)
def test_reading_stops_after_the_required_rows(tmp_path: Path, rest: bytes) -> None:
    rows = b"".join(b"%d,%d\n" % (row, row) for row in range(20_000))
    path = write(tmp_path, b"hour,a.p\n" + rows + rest)
    assert read_columns(path, 96).values["a.p"].tolist() == list(range(96))
    with pytest.raises(ProfileError):
        read_columns(path)


@pytest.mark.parametrize("entry", ["inf", "-inf", "Infinity", "1e400", "-1e400"])
def test_infinity_is_refused_unless_it_means_no_limit(tmp_path: Path, entry: str) -> None:
    path = write(tmp_path, f"a.p,a.rating\n1,1\n2,{entry}\n")
    with pytest.raises(ProfileError, match=f"line 3, column 'a.rating': '{entry}' is not a finite number"):
        read_columns(path)
    assert read_columns(path, unlimited=True).values["a.rating"][1] == float(entry)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("a.p\n1\nnan\n", "line 3, column 'a.p': 'nan' is not a number"),
        ("a.p,b.p\n1\n", "line 2, column 'b.p': the value is missing"),
        ("a.p\n1,5\n", "line 2: 2 cells for 1 headings"),
        ("a.p\n1\n", "1 rows; 3 are needed"),
        ("", "the file is empty"),
        ("a.p, a.p\n", "line 1: duplicate column 'a.p'"),
        ("a\n1\n", "no column is named 'component.field'.* columns are: a$"),
        (",".join(f"c{n}" for n in range(50_000)) + "\n", r".* c18, c19 \.\.\.$"),
        (f"a.p\n{200_000 * '1'}\n", "line 2: not CSV: field larger than"),
        (b"a.p\n\xff\n", "not UTF-8 text"),
        ("a.p\n1_0\n", "line 2, column 'a.p': '1_0' is not a number"),
        ("a.p\n\uff11\n", "line 2, column 'a.p': '\uff11' is not a number"),
        ('a.p,b.p\n1,"2\n3,4"\n', "line 2: a quotation mark is not closed"),
    ],
)
def test_errors_are_reported_with_their_line(tmp_path: Path, content: str | bytes, message: str) -> None:
    with pytest.raises(ProfileError, match=f"series.csv: {message}"):
        read_columns(write(tmp_path, content), 3, unlimited=True)


def test_line_length_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rows, "_LONGEST_LINE", 1000)
    with pytest.raises(ProfileError, match=r"line 2: .*1,000 characters"):
        read_columns(write(tmp_path, "a.p\n" + "1," * 1000))


# Invalid files ----------------------------------------------------------------------------------

NETWORK = "network: {buses: {a: {}}, generators: {g: {bus: a, p: [0, 9]}}, loads: {l: {bus: a, p: 1}}}\n"
NAMED = {
    "table": "profiles: [{table: {file: PATH}}]",
    "shape": "profiles: [{shape: {file: PATH, column: l.p}}]",
    "forecast": "forecast: {file: {file: PATH}}\nplant: {mode: redispatch}",
    "constraint": "constraints: {c: {terms: {g.pg: 1}, at_most: {file: PATH, column: l.p}}}",
    "set-points": "controller: {objective: {setpoint-tracking: {setpoints: {file: PATH}}}}",
}
SCRIPT = """
import json, resource, sys
from opfmodel.errors import OpfmodelError
from opfmodel.scenario import load_scenario
from opfmodel.study import read_study
limit = 8_000_000_000
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
for path in sys.argv[1:]:
    for read in (read_study,) if path.endswith("study.yaml") else (load_scenario,):
        try:
            read(path)
            print(json.dumps("accepted"))
        except OpfmodelError as error:
            print(json.dumps(str(error)))
"""


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes and devices")
def test_pipes_devices_and_folders_are_refused_at_once(tmp_path: Path) -> None:
    """Opening them naively would block or read forever."""
    pipe, folder = tmp_path / "pipe", tmp_path / "folder"
    os.mkfifo(pipe)
    folder.mkdir()
    kinds = {pipe: "a pipe", folder: "a folder", "/dev/stdin": "a pipe", "/dev/zero": "a device", "/dev/urandom": "a device"}  # fmt: skip
    files, expected = [], []
    for number, (path, kind) in enumerate(kinds.items()):
        for use, text in NAMED.items():
            files.append(tmp_path / f"{number}-{use}.yaml")
            files[-1].write_text(NETWORK + text.replace("PATH", str(path)) + "\n")
            expected.append(f"{path}: is {kind}; must be a regular file")
        for name in ("scenario.yaml", "study.yaml"):
            files.append(tmp_path / f"{number}-{name}")
            files[-1].symlink_to(path)
            expected.append(f"{files[-1]}: is {kind}; must be a regular file")
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, *map(str, files)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        process.wait(120)  # standard input stays open
        answers = [json.loads(line) for line in process.stdout]
    finally:
        process.kill()
        process.stdin.close()
        process.stdout.close()
    for file, message, answer in zip(files, expected, answers, strict=True):
        assert answer.endswith(message), file.name
        assert answer.isprintable()


@pytest.mark.parametrize("use", NAMED)
@pytest.mark.parametrize("name", ["x" * 5000, "a\\0b", "none.csv"])
def test_impossible_file_names(tmp_path: Path, use: str, name: str) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(NETWORK + NAMED[use].replace("PATH", f'"{name}"') + "\n")
    with pytest.raises(ScenarioError, match=r"cannot be read|no such file") as caught:
        load_scenario(path)
    assert str(caught.value).isprintable()
