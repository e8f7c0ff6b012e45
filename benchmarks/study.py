"""Speed-up of a study from a second worker.

python -m benchmarks.study
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from benchmarks.harness import arguments, measure, median, report

SCENARIO = Path(__file__).parent.parent / "scenarios" / "case5-step.yaml"


def study(workers: int, runs: int, steps: int) -> dict[str, Any]:
    """Run a study, including the start of its workers."""
    from opfmodel.study import read_study, run_study

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.yaml"
        weights = [0.01 * (1 + number) for number in range(runs)]  # different runs of nearly equal effort
        path.write_text(
            f"scenario: {SCENARIO}\nset: {{time.steps: {steps}}}\n"
            f"vary: {{controller.regularisation: {weights}}}\n",
            encoding="utf-8",
        )
        loaded = read_study(path)
        outcome = run_study(loaded, Path(folder) / "out", workers=workers)
    return {"workers": workers, "runs": outcome.total, "done": outcome.done, "seconds": outcome.seconds}


def main() -> None:
    """Measure and report."""
    options = arguments(__doc__ or "")
    runs, steps = (4, 2) if options.quick else (24, 49)
    rows: dict[int, list[dict[str, Any]]] = {1: [], 2: []}
    for _ in range(options.repeat):  # alternate, so that a drift of the machine affects both
        for workers, list_ in rows.items():
            list_.append(measure(study, workers, runs, steps))
    one, two = (median(list_) for list_ in rows.values())
    named = [
        {"measurement": f"{runs} runs of {steps} steps, {count} worker{'s'[: count - 1]}", **row}
        for count, row in zip(rows, (one, two), strict=True)
    ]
    report("study", named, {"one worker / two workers (goal >= 1.8)": one["seconds"] / two["seconds"]})


if __name__ == "__main__":
    main()
