"""Fuzz opfmodel: ``python -m tests.fuzz [--seconds 300] [--kind KIND] [--seed N] [--out FOLDER] [--docs FILE]``."""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

from .corpus import KINDS
from .run import fuzz

BEGIN, END = "<!-- counts of make fuzz -->", "<!-- end of the counts -->"


def main() -> int:
    """Fuzz and report; exit status 1 if a fault was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--seconds", type=float, default=300, help="time for all kinds together")
    parser.add_argument("--number", type=int, help="number of inputs of each kind, instead of a time")
    parser.add_argument("--kind", action="append", choices=KINDS, help="kind of input; repeatable")
    parser.add_argument("--seed", default=str(int(time.time())), help="seed of the random numbers")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("results/fuzz"))
    parser.add_argument("--docs", type=Path, help="page whose table of counts is replaced")
    chosen = parser.parse_args()
    out = chosen.out.resolve()
    report = fuzz(chosen.kind or KINDS, chosen.seed, chosen.seconds, out, chosen.workers, chosen.number)
    out.mkdir(parents=True, exist_ok=True)
    (out / "counts.json").write_text(json.dumps(report.as_dict(), indent=1) + "\n")
    (out / "counts.md").write_text(report.markdown())
    if chosen.docs is not None:
        before, _, rest = chosen.docs.read_text().partition(BEGIN)
        after = rest.partition(END)[2]
        chosen.docs.write_text(f"{before}{BEGIN}\n{report.markdown()}{END}{after}")
    sys.stdout.write(report.markdown())
    return 1 if report.faults else 0


if __name__ == "__main__":
    sys.exit(main())
