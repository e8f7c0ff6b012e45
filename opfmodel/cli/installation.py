"""Examination of the installation: versions, optional packages, and a small problem on every solver."""

from __future__ import annotations

import importlib.util
import os
import platform
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from opfmodel.errors import OpfmodelError

__all__ = ["Installation", "OptionalPackage", "SelfTest", "examine"]

_REQUIRED = (
    "opfmodel", "casadi", "numpy", "scipy", "networkx", "powerio", "cvxpy", "qpsolvers", "clarabel", "osqp",
    "xarray", "pydantic",
)  # fmt: skip
# Package, module, what it enables, how to install it.
_OPTIONAL = (
    ("pandapower", "pandapower", "networks of pandapower", "pip install 'opfmodel[pandapower]'"),
    ("pypsa", "pypsa", "networks of PyPSA with their time series", "pip install 'opfmodel[pypsa]'"),
    ("simbench", "simbench", "networks and profiles of SimBench", "pip install 'opfmodel[simbench]'"),
    ("pandas", "pandas", "tables of pandas as time series", "pip install pandas"),
    ("openpyxl", "openpyxl", "time series from Excel files", "pip install openpyxl"),
    ("numba", "numba", "faster conversion of pandapower's networks", "pip install numba"),
    ("piqp", "piqp", "the solver piqp", "pip install piqp"),
    ("highspy", "highspy", "the solver highs", "pip install highspy"),
    ("psutil", "psutil", "memory in benchmarks", "pip install psutil"),
)
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_COST = 1800.0  # $/h: 60 MW over the line at 10 $/MWh, 40 MW from the unit at the load at 30 $/MWh
_TOLERANCE = 1e-3  # of solvers of first order


@dataclass(frozen=True)
class OptionalPackage:
    """A package that may be missing, with its version if it is not."""

    name: str
    version: str | None
    enables: str
    install: str


@dataclass(frozen=True)
class SelfTest:
    """Result of the small problem on one solver.

    Attributes
    ----------
    status
        Status of the plan, or ``"error"``.
    detail
        The cost, or what went wrong.
    """

    back_end: str
    solver: str
    formulation: str
    status: str
    passed: bool
    detail: str


@dataclass(frozen=True)
class Installation:
    """What is installed and whether it works."""

    versions: dict[str, str]
    machine: dict[str, str]
    optional: tuple[OptionalPackage, ...]
    tests: tuple[SelfTest, ...]
    broken: dict[str, str]

    @property
    def healthy(self) -> bool:
        """Whether every back end loads and every self-test passes."""
        return bool(self.tests) and not self.broken and all(test.passed for test in self.tests)

    def as_dict(self) -> dict[str, Any]:
        """Convert to plain data."""
        return {**asdict(self), "healthy": self.healthy}


def examine() -> Installation:
    """Examine the installation; solves one problem of two buses with every installed solver."""
    from solvers import broken_back_ends

    return Installation(
        {"python": platform.python_version(), **{name: _version(name) or "missing" for name in _REQUIRED}},
        {
            "system": f"{platform.system()} {platform.machine()}",
            "cores": str(os.cpu_count()),
            "threads": ", ".join(f"{name}={os.environ.get(name, 'unset')}" for name in _THREADS),
        },
        tuple(
            OptionalPackage(
                name, _version(name) if importlib.util.find_spec(module) else None, enables, install
            )
            for name, module, enables, install in _OPTIONAL
        ),
        tuple(_tests()),
        {name: f"{type(error).__name__}: {error}" for name, error in broken_back_ends().items()},
    )


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _tests() -> Iterator[SelfTest]:
    from solvers import Kind, back_ends, installed

    for name, end in back_ends().items():
        for solver in installed(end):
            yield _test(name, solver, "dc")
            if end.accepts == Kind.NONLINEAR and _takes_all(solver):
                yield _test(name, solver, "ac")


def _takes_all(solver: str) -> bool:
    """Whether a solver is not a back end for convex programs only, which windows can call."""
    from solvers import Kind, back_ends

    end = back_ends().get(solver)
    return end is None or end.accepts == Kind.NONLINEAR


def _test(back_end: str, solver: str, formulation: str) -> SelfTest:
    from opfmodel.plan import MultiStage
    from solvers import SolverError

    try:
        plan = MultiStage(_two_buses(), formulation=formulation, solver=f"{back_end}:{solver}").solve()
    except (OpfmodelError, SolverError) as error:
        return SelfTest(back_end, solver, formulation, "error", False, str(error))
    if not plan.optimal:
        return SelfTest(back_end, solver, formulation, plan.status, False, str(plan.termination))
    # Losses and the voltage move the optimum of the AC problem by less than a hundredth.
    allowed = 0.01 if formulation == "ac" else _TOLERANCE
    passed = abs(plan.objective - _COST) <= allowed * _COST
    detail = f"{plan.objective:.4f} $" + ("" if passed else f"; the optimum is {_COST:g} $")
    return SelfTest(back_end, solver, formulation, plan.status, passed, detail)


def _two_buses() -> Any:
    from opfmodel.network import Branch, Bus, Generator, Load, Network, Polynomial

    grid = Network("self-test")
    grid.north = Bus(reference=True)
    grid.south = Bus()
    grid.tie = Branch("north", "south", r=0.001, x=0.1, rating=60)
    grid.cheap = Generator("north", p=(0, 100), q=(-100, 100), cost=Polynomial(0, 10, 0))
    grid.local = Generator("south", p=(0, 100), q=(-100, 100), cost=Polynomial(0, 30, 0))
    grid.town = Load("south", p=100)
    return grid
