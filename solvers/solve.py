"""Selecting a back end, by name or by the structure of the program, and solving."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache, cached_property
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Protocol

from solvers.errors import UnknownSolverError, UnsupportedProgramError
from solvers.program import Instance, Program
from solvers.sharing import Sharing, of_starts, structure_digest
from solvers.solution import Solution, Start
from solvers.status import SolutionStatus, TerminationCondition
from solvers.structure import Kind, Structure, classify, curvature_varies

__all__ = [
    "BackEnd",
    "Session",
    "back_ends",
    "broken_back_ends",
    "choose",
    "find",
    "in_parts",
    "installed",
    "prepare",
    "recall_session",
    "rescan",
    "session_memory",
    "solve",
]

GROUP = "solvers.backends"
Options = Mapping[str, Any]


class Session(Protocol):
    """A program prepared by a back end for repeated solves.

    A session whose solves depend on earlier ones, besides on their start, also has the methods ``memory()``
    and ``recall(memory)``; see :func:`session_memory`.
    """

    def solve(self, instance: Instance, start: Start | None = None) -> Solution:
        """Solve an instance, from ``start`` if the back end supports warm starts."""
        ...


def session_memory(session: Session) -> dict[str, Any]:
    """Return what the next solves of a session depend on besides their arguments; empty if on nothing.

    Returns
    -------
    dict
        Plain data: nested mappings, lists, numbers, texts and arrays. A new session of the same program that
        takes them back by :func:`recall_session` solves as this one would.
    """
    own = getattr(session, "memory", None)
    return {} if own is None else dict(own())


def recall_session(session: Session, memory: Mapping[str, Any]) -> None:
    """Put back what :func:`session_memory` returned, in another process for instance.

    An empty memory is that of a new session: what it has learnt since is forgotten.
    """
    own = getattr(session, "recall", None)
    if own is not None:
        own(memory)


class BackEnd(Protocol):
    """Interface of a back end: one class in one file, registered as an entry point.

    Attributes
    ----------
    name
        Name of the back end.
    accepts
        Most general kind of program that it solves.
    in_parts
        Optional: whether it solves programs part by part and never holds the whole one.
    """

    name: str
    accepts: Kind

    def solvers(self) -> Iterator[str]:
        """Names of the installed solvers that it can call, the default first."""
        ...

    def prepare(self, program: Program, solver: str, options: Options, verbose: bool) -> Session:
        """Prepare ``program`` for repeated solves."""
        ...


@cache
def back_ends() -> dict[str, BackEnd]:
    """All back ends that can be loaded, by name, simplest problem class first.

    A third-party back end that fails to load is left out; :func:`broken_back_ends` lists it.
    """
    loaded = {name: end for name, end in _load().items() if not isinstance(end, Exception)}
    return dict(sorted(loaded.items(), key=lambda pair: (pair[1].accepts, pair[0])))


def broken_back_ends() -> dict[str, Exception]:
    """Back ends that fail to load or to list their solvers, and why."""
    broken = {name: end for name, end in _load().items() if isinstance(end, Exception)}
    for name, end in back_ends().items():
        called = _installed(end)
        if isinstance(called, Exception):
            broken[name] = called
    return broken


def installed(end: BackEnd) -> tuple[str, ...]:
    """Names of the installed solvers that a back end can call, default first; empty if it is broken."""
    called = _installed(end)
    return () if isinstance(called, Exception) else called


def rescan() -> None:
    """Look for back ends again, after one was installed in the running process."""
    _load.cache_clear()
    back_ends.cache_clear()


@cache
def _load() -> dict[str, BackEnd | Exception]:
    found: dict[str, BackEnd | Exception] = {}
    for point in entry_points(group=GROUP):
        found[point.name] = _load_one(point)
    return found


def _load_one(point: EntryPoint) -> BackEnd | Exception:
    """A back end, or the reason why it cannot be loaded; any error of its module is reported by name."""
    try:
        end: BackEnd = point.load()()
        name, accepts, ready = end.name, end.accepts, callable(end.solvers) and callable(end.prepare)
    except Exception as error:
        return error
    except SystemExit as stop:
        return UnknownSolverError(f"its module exits: {stop}")
    if not (name == point.name and isinstance(accepts, Kind) and ready):
        return UnknownSolverError(f"{point.value} is not a back end: name = {name!r}, accepts = {accepts!r}")
    return end


def _installed(end: BackEnd) -> tuple[str, ...] | Exception:
    try:
        return tuple(end.solvers())
    except (Exception, SystemExit) as error:  # reported by name, like a back end that fails to load
        return UnknownSolverError(f"cannot list its solvers: {type(error).__name__}: {error}")


def find(name: str, kind: Kind) -> tuple[BackEnd, str]:
    """Find the back end and solver that ``name`` refers to, for a program of this kind.

    Parameters
    ----------
    name
        A back end (``"ipopt"``, ``"clarabel"``, ``"qp"``), a solver that one of them calls
        (``"scs"``), or both (``"conic:scs"``).
    kind
        Kind of the program, which decides between back ends that offer the same solver.

    Raises
    ------
    UnknownSolverError
        No back end or installed solver has this name.
    """
    ends = back_ends()
    prefix, _, rest = name.partition(":")
    if prefix in ends and rest:
        if rest in installed(ends[prefix]):
            return ends[prefix], rest
    elif name in ends:
        for default in installed(ends[name]):
            return ends[name], default
    else:
        offering = [end for end in ends.values() if name in installed(end)]
        accepting = [end for end in offering if end.accepts >= kind]
        for end in accepting or offering:
            return end, name
    raise UnknownSolverError(f"no installed solver is named {name!r}; {_inventory(ends)}")


def in_parts(name: str) -> bool:
    """Whether the back end that ``name`` refers to solves programs part by part, in little memory."""
    return isinstance(name, str) and getattr(back_ends().get(name.partition(":")[0]), "in_parts", False)


def _inventory(ends: Mapping[str, BackEnd]) -> str:
    parts = [f"{end.name} ({', '.join(installed(end)) or 'nothing installed'})" for end in ends.values()]
    text = f"available: {'; '.join(parts) or 'none'}"
    broken = broken_back_ends()
    if broken:
        text += "; could not be loaded: " + ", ".join(f"{n} ({e})" for n, e in broken.items())
    return text


def prepare(
    program: Program,
    solver: str = "auto",
    options: Options | None = None,
    verbose: bool = False,
) -> Session:
    """Prepare a program for repeated solves by one back end.

    Parameters
    ----------
    solver
        See :func:`find`; ``"auto"`` selects a back end by structure and size.
    options
        Passed to the solver unchanged; they override this package's defaults.
    verbose
        Whether the solver prints its iterations.

    Raises
    ------
    UnknownSolverError
        No back end or installed solver has this name.
    UnsupportedProgramError
        The back end cannot represent the program, or the quadratic cost is not convex; the message
        names the blocks. If parameters enter the Hessian, each solve tests its instance.
    """
    structure = classify(program)
    name = choose(program, structure.kind) if solver == "auto" else solver
    end, solver_name = find(name, structure.kind)
    _check_accepted(program, structure, end, name)
    session = end.prepare(program, solver_name, dict(options or {}), verbose)
    if end.accepts < Kind.NONLINEAR and curvature_varies(program):
        session = _ConvexSession(session, program, end, name)
    if solver == "auto" and name != _LAST_RESORT:
        session = _SecondOpinion(session, lambda: prepare(program, _LAST_RESORT, None, verbose))
    sharing = of_starts()
    return session if sharing is None else _SharedStart(session, sharing, program)


class _SecondOpinion:
    """A session that falls back to another back end when the automatically selected one fails.

    Results and proofs of the first back end stand; only a solve without a result is repeated.
    """

    def __init__(self, session: Session, other: Callable[[], Session]) -> None:
        self._session = session
        self._prepare = other

    @cached_property
    def _other(self) -> Session:
        return self._prepare()

    def memory(self) -> dict[str, Any]:
        """Return what both sessions remember."""
        made = {"first": session_memory(self._session)}
        if "_other" in vars(self):
            made["other"] = session_memory(self._other)
        return {name: memory for name, memory in made.items() if memory}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Put back what both sessions remembered."""
        recall_session(self._session, memory.get("first", {}))
        if "other" in memory or "_other" in vars(self):
            recall_session(self._other, memory.get("other", {}))

    def solve(self, instance: Instance, start: Start | None = None) -> Solution:
        """Solve, with the other back end if the first finds nothing."""
        solution = self._session.solve(instance, start)
        if solution.status is not SolutionStatus.NONE or solution.termination in _ENDED_BY_WILL:
            return solution
        second = self._other.solve(instance, start)
        if not second.status.is_optimal:
            return solution
        message = f"{second.message}, after {solution.solver} failed: {solution.message}"
        return replace(second, message=message).after(solution)


class _SharedStart:
    """A session whose first solve starts from the first solution of another program of the same structure."""

    def __init__(self, session: Session, sharing: Sharing, program: Program) -> None:
        self._session = session
        self._sharing = sharing
        self._digest = structure_digest(program)
        self._first = True

    def memory(self) -> dict[str, Any]:
        """Return what the session remembers, and whether it has solved anything."""
        return {"first": self._first, "session": session_memory(self._session)}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Put back what :meth:`memory` returned."""
        self._first = bool(memory.get("first", True))
        recall_session(self._session, memory.get("session", {}))

    def solve(self, instance: Instance, start: Start | None = None) -> Solution:
        """Solve an instance; the first one from the shared starting point, unless it has its own."""
        if not self._first:
            return self._session.solve(instance, start)
        self._first = False
        shared = self._sharing.start(self._digest) if start is None else None
        solution = self._session.solve(instance, start if shared is None else shared)
        if shared is not None and solution.status not in _PROVEN and not solution.status.is_optimal:
            again = self._session.solve(instance)
            solution = replace(again, seconds=again.seconds + solution.seconds)
        if solution.status.is_optimal:
            # other numbers let other limits bind, as in a problem that is moved in time
            self._sharing.keep_start(self._digest, replace(solution.start(), moved=1))
        return solution


class _ConvexSession:
    """A session of a convex back end for a program that an instance can make non-convex."""

    def __init__(self, session: Session, program: Program, end: BackEnd, name: str) -> None:
        self._session = session
        self._program = program
        self._end = end
        self._name = name

    def memory(self) -> dict[str, Any]:
        """Return what the session remembers."""
        return session_memory(self._session)

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Put back what the session remembered."""
        recall_session(self._session, memory)

    def solve(self, instance: Instance, start: Start | None = None) -> Solution:
        """Solve the instance if it is convex."""
        _check_accepted(self._program, classify(self._program, instance), self._end, self._name)
        return self._session.solve(instance, start)


def _check_accepted(program: Program, structure: Structure, end: BackEnd, name: str) -> None:
    if structure.kind <= end.accepts:
        return
    able = ", ".join(e.name for e in back_ends().values() if e.accepts >= structure.kind) or "none"
    blocks = f"{_blocks(structure.culprits)} of {program.name!r}"
    makes = "make" if len(structure.culprits) > 1 else "makes"
    reason = (
        f"the quadratic {blocks} is not convex"
        if structure.nonconvex
        else f"{blocks} {makes} it a {structure.kind}"
    )
    raise UnsupportedProgramError(
        f"{name!r} solves at most a {end.accepts}, but {reason}; back ends that accept it: {able}"
    )


_PROVEN = (SolutionStatus.PROVEN_INFEASIBLE,)
# Fallback of "auto" when the preferred back end finds nothing.
_LAST_RESORT = "ipopt"
_ENDED_BY_WILL = (
    TerminationCondition.INTERRUPTED,
    TerminationCondition.ITERATION_LIMIT,
    TerminationCondition.TIME_LIMIT,
    TerminationCondition.LIMIT,
    TerminationCondition.UNBOUNDED,
)
# Number of variables up to which "auto" prefers Clarabel, which certifies optima and infeasibility of
# convex programs, to IPOPT, which is faster on large ones; docs/backends.md has the measurements.
_PREFERRED = "clarabel"
_MOST_VARIABLES = {Kind.LINEAR: 5_000, Kind.QUADRATIC: 5_000, Kind.CONIC: 20_000, Kind.NONLINEAR: 0}


def choose(program: Program, kind: Kind) -> str:
    """Back end that ``"auto"`` selects for the kind and size of the program."""
    end = back_ends().get(_PREFERRED)
    suits = program.n_variables <= _MOST_VARIABLES[kind]
    return _PREFERRED if suits and end is not None and installed(end) else _LAST_RESORT


def _blocks(names: tuple[str, ...]) -> str:
    shown = ", ".join(repr(n) for n in names[:3])
    return (
        ("blocks " if len(names) > 1 else "block ")
        + shown
        + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    )


def solve(
    program: Program,
    solver: str = "auto",
    instance: Instance | None = None,
    start: Start | None = None,
    options: Options | None = None,
    verbose: bool = False,
) -> Solution:
    """Solve a program once. For a sequence of instances, reuse the session of :func:`prepare`."""
    session = prepare(program, solver, options, verbose)
    return session.solve(program.default if instance is None else instance, start)
