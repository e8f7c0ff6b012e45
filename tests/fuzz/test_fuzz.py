"""Fuzzing with a fixed budget: mutated inputs are accepted, or refused with an error of opfmodel.

``make fuzz`` runs the same for longer, with another seed each time.
"""

from __future__ import annotations

import io
import json
import os
import random
import sys
import zipfile
from collections import Counter
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from .corpus import KINDS, seeds
from .mutate import FAMILIES, OPERATORS, Mutation, Special, draw, mutated
from .run import FAULTS, Case, Outcome, Pool, Report, Worker, cases, keep, minimised, place

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="watches processes through /proc")

SEED = 20261125
FAST = {"scenario": 40, "network": 40, "table": 30, "study": 25, "record": 40, "result": 12, "override": 40}
SLOW = dict.fromkeys(KINDS, 50) | {"pandapower": 30, "pypsa": 25, "result": 20}
FOUND = sorted((Path(__file__).parent / "found").glob("*/case.json"))


@pytest.fixture(scope="module")
def pool(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Pool]:
    """A worker without the libraries that take long to import; tests run beside each other already."""
    with Pool(tmp_path_factory.mktemp("fuzz"), 1, ["matplotlib.font_manager"]) as made:
        yield made


@pytest.fixture(scope="module")
def large_pool(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Pool]:
    """A worker with all libraries."""
    imports = [
        name
        for name in ("matplotlib.font_manager", "pandapower", "pypsa")
        if find_spec(name.partition(".")[0])
    ]
    with Pool(tmp_path_factory.mktemp("fuzz"), 1, imports) as made:
        yield made


def fuzzed(pool: Pool, kind: str, seed: object, number: int) -> Counter[str]:
    """Outcomes of mutated inputs; a fault fails the test."""
    report, shown = Report(str(seed)), []
    for case, outcome in pool.each(cases(seeds(kind), seed, number)):
        if report.add(case, outcome):
            shown.append(f"{outcome.status}: {outcome.what}: {case}\n{outcome.detail}")
    assert not report.faults, "\n\n".join(shown)
    return report.counts[kind]


@pytest.mark.parametrize("kind", FAST)
def test_seeds_are_accepted(kind: str, pool: Pool) -> None:
    inputs = [Case(seed, (), command) for seed in seeds(kind) for command in seed.commands]
    for case, outcome in pool.each(inputs):
        assert outcome.status == "accepted", f"{case}: {outcome}"


@pytest.mark.parametrize("kind", FAST)
def test_mutated_inputs_are_accepted_or_refused(kind: str, pool: Pool) -> None:
    found = fuzzed(pool, kind, SEED, FAST[kind])
    assert found.total() == FAST[kind]
    assert found["refused"] > 0 < found["accepted"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_more_mutated_inputs_are_accepted_or_refused(
    kind: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    imports = dict.fromkeys(module for seed in seeds(kind) for module in seed.imports)
    with Pool(tmp_path_factory.mktemp("fuzz"), 2, imports) as pool:
        inputs = [Case(seed, (), command) for seed in seeds(kind) for command in seed.commands]
        for case, outcome in pool.each(inputs):
            assert outcome.status == "accepted", f"{case}: {outcome}"
        found = fuzzed(pool, kind, SEED + 1, SLOW[kind])
    assert found["refused"] > 0 < found["accepted"]


@pytest.mark.parametrize("path", FOUND, ids=[path.parent.name for path in FOUND])
def test_faults_found_earlier_stay_mended(path: Path, request: pytest.FixtureRequest) -> None:
    about = json.loads(path.read_text())
    pool = request.getfixturevalue("large_pool" if about.get("requires") else "pool")
    for module in about.get("requires", ()):
        pytest.importorskip(module)
    folder = path.parent / "input"
    files = {f.relative_to(folder).as_posix(): f.read_bytes() for f in folder.rglob("*") if f.is_file()}
    worker = pool.idle[0]
    outcome = worker.run(files, about["command"])
    assert outcome.status == about["status"], outcome
    for word in about.get("message", ()):
        assert word in outcome.detail


# Mutations --------------------------------------------------------------------------------------


@settings(max_examples=200)
@given(
    content=st.one_of(
        st.binary(max_size=200), st.text(max_size=100).map(lambda t: t.encode("utf-8", "replace"))
    ),
    operator=st.sampled_from(sorted(OPERATORS)),
    seed=st.integers(0, 2**32 - 1),
)
def test_every_operator_takes_any_content_and_repeats_itself(
    content: bytes, operator: str, seed: int
) -> None:
    once, again = (mutated({"f": content}, [Mutation("f", operator, seed)])["f"] for _ in range(2))
    assert once == again
    assert isinstance(once, bytes | Special)


def test_every_operator_belongs_to_a_family_and_every_family_is_used() -> None:
    assert {name for family in FAMILIES.values() for name in family} == set(OPERATORS)


@pytest.mark.parametrize("kind", FAST)
def test_most_mutations_change_their_seed(kind: str) -> None:
    rng = random.Random(SEED)
    for seed in seeds(kind):
        drawn = [draw(rng, seed.targets) for _ in range(40)]
        changed = sum(mutated(seed.files, mutations) != seed.files for mutations in drawn)
        assert changed > 20, seed.name


def test_members_of_archives_are_changed() -> None:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("sheet.xml", "<v>1</v>" * 20)
    content = stream.getvalue()
    results = {mutated({"f": content}, [Mutation("f", "zip", n)])["f"] for n in range(20)}
    assert len(results) > 10
    assert all(zipfile.is_zipfile(io.BytesIO(result)) for result in results)


# Workers ----------------------------------------------------------------------------------------

# What a command might do wrong, as the body of a function, and how that must be judged.
WRONG = {
    "raises": ("raise KeyError(3)", "crashed", "KeyError"),
    "panics": ("class P(BaseException): pass\n    raise P", "crashed", "P at"),
    "dies": ("import os; os.abort()", "crashed", "exit status -6"),
    "allocates": ("bytearray(10**10)", "crashed", "MemoryError"),
    "fills": ("b'x' * 400_000_000\n    raise SystemExit(0)", "crashed", "too large"),
    "fills and waits": ("a = b'x' * 400_000_000\n    while a: pass", "crashed", "too large at cli.py"),
    "waits": ("while True: pass", "timed out", "cli.py"),
    "says nothing": ("import sys; sys.exit(2)", "misbehaved", "message"),
    "spams": (
        "import sys; sys.stderr.write('warning: x\\n' * 10000)\n    sys.exit(0)",
        "misbehaved",
        "few lines",
    ),
    "writes": ("open('stray', 'w').close()\n    raise SystemExit(0)", "misbehaved", "elsewhere"),
    "writes and hides it": (
        "import os, tempfile; os.remove(tempfile.mkstemp()[1])\n    raise SystemExit(0)",
        "misbehaved",
        "elsewhere",
    ),
    "starts": (
        "import subprocess; subprocess.run(['true'])\n    raise SystemExit(0)",
        "misbehaved",
        "started",
    ),
    "prints codes": ("print('\\x1b[31m')\n    raise SystemExit(0)", "misbehaved", "printable"),
    "is good": ("raise SystemExit(0)", "accepted", ""),
    "refuses": ("import sys; sys.stderr.write('error: no\\n')\n    sys.exit(2)", "refused", ""),
}


@pytest.fixture(scope="module")
def impostor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a package in the place of opfmodel, whose command does what it is told."""
    folder = tmp_path_factory.mktemp("impostor")
    (folder / "opfmodel").mkdir()
    (folder / "opfmodel" / "__init__.py").write_text("")
    bodies = [f"def f{n}():\n    {body}\n" for n, (body, _, _) in enumerate(WRONG.values())]
    main = "import sys\ndef main():\n    globals()[sys.argv[1]]()\n"
    (folder / "opfmodel" / "cli.py").write_text(main + "".join(bodies))
    return folder


@pytest.mark.parametrize("name", WRONG)
def test_what_a_command_does_wrong_is_noticed(
    name: str, impostor: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", os.fspath(impostor))
    monkeypatch.setattr("fuzz.run.CPU_SECONDS", 1.0)
    monkeypatch.setattr("fuzz.run.MEGABYTES", 300.0)
    worker = Worker(tmp_path)
    try:
        outcome = worker.run({}, [f"f{list(WRONG).index(name)}"])
    finally:
        worker.stop()
    _, status, what = WRONG[name]
    assert outcome.status == status, outcome
    assert what in outcome.what
    assert outcome.fault == (status in FAULTS)


def test_a_worker_goes_on_after_a_crash(
    impostor: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", os.fspath(impostor))
    number = {name: f"f{n}" for n, name in enumerate(WRONG)}
    worker = Worker(tmp_path)
    try:
        found = [worker.run({}, [number[name]]).status for name in ("is good", "dies", "is good", "refuses")]
    finally:
        worker.stop()
    assert found == ["accepted", "crashed", "accepted", "refused"]


def test_a_fault_is_shortened_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (source,) = seeds("table")[:1]
    needed = Mutation("t.csv", "empty", 0)
    case = Case(
        source,
        [Mutation("t.csv", "flip", 1), needed, Mutation("t.csv", "byte-order mark", 2)],
        ("validate", "s.yaml"),
    )

    def run(self: Pool, case: Case) -> Outcome:
        return Outcome("crashed", "here") if needed in case.mutations else Outcome("accepted")

    monkeypatch.setattr(Pool, "run", run)
    with Pool(tmp_path, 1) as pool:
        shorter = minimised(pool, case, pool.run(case))
    assert list(shorter.mutations) == [needed]
    kept = keep(shorter, Outcome("crashed", "here"), tmp_path)
    assert (kept / "input" / "t.csv").read_bytes() == b""
    assert json.loads((kept / "case.json").read_text())["command"] == ["validate", "s.yaml"]


def test_special_files_are_placed(tmp_path: Path) -> None:
    place({special.name: special for special in Special} | {"a/b": b"text"}, tmp_path)
    assert (tmp_path / "FOLDER").is_dir()
    assert (tmp_path / "PIPE").is_fifo()
    assert (tmp_path / "LOOP").is_symlink()
    assert (tmp_path / "DEVICE").is_char_device()
    assert not os.path.lexists(tmp_path / "NONE")
    assert (tmp_path / "a" / "b").read_bytes() == b"text"
