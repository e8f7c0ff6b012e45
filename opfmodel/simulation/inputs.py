"""Digests of what a closed loop depends on, by name, so that what has changed can be named."""

from __future__ import annotations

import hashlib
import inspect
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cached_property, partial, singledispatch
from pathlib import Path
from types import CodeType, FunctionType, MethodType, NoneType
from typing import Any

import numpy as np

from opfmodel.objectives.base import Objective
from opfmodel.plugins.versions import versions
from opfmodel.simulation.controller import Controller
from opfmodel.simulation.plants.base import Plant

__all__ = ["changed", "digest", "inputs"]

Inner = Callable[[Any], Iterator[bytes]]

_DIGITS = 16
_DEEPEST = 20
_OWN = ("opfmodel.", "solvers.")  # modules whose version is an input

# What a problem is made of, besides its network and its series.
_STATED = (
    "horizon", "formulation", "objective", "generator_delay", "end", "regularisation", "elastic", "risk",
    "security", "outages", "devices", "at_end", "solver", "options", "constraints",
)  # fmt: skip


def inputs(
    controller: Controller,
    plant: Plant,
    steps: int,
    objective: Objective | None = None,
) -> dict[str, str]:
    """Return a digest of everything that the trajectories of a closed loop depend on, by name.

    Two loops with the same digests have the same trajectories on the same machine. Objects count by their
    class, the arguments of its constructor and their public attributes, functions by their code, paths by
    the content of the file, and packages by their version. Other packages' classes also count by their code.

    The parameters are those of :func:`opfmodel.simulate`. The initial state is not among them: it may be the
    result of a solver, which differs in the last digits on another machine.
    """
    problem = controller.problem
    network, metered = problem.network, problem.objective if objective is None else objective
    named: dict[str, Any] = {"steps": steps, "cost": metered, "plant": plant}
    named |= {"controller": type(controller), "problem": type(problem)}
    named["network"] = (network.base_mva, network.currency)
    for kind in network.kinds():
        named[f"network {kind.plural}"] = network.of(kind)
    series: dict[str, list[Any]] = defaultdict(list)
    for key, values in sorted(problem.profiles.items()):
        series[f"series {key.field}"].append((key.component, values))
    named |= series
    named["calendar"] = problem.profiles.calendar
    named |= {name.replace("_", " "): getattr(problem, name) for name in _STATED}
    for name in ("forecast", "scenarios", "on_infeasible"):
        named[name.replace("_", " ")] = getattr(controller, name)
    named["elastic prices"] = controller.elastic
    named["expected"] = controller.expected(0)  # what forecasts and scenarios read from files, as numbers
    named |= {f"package {package}": version for package, version in versions().items()}
    return {name: digest(value) for name, value in named.items()}


def changed(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return the names of the inputs that differ."""
    return [name for name in {**now, **before} if before.get(name) != now.get(name)]


def digest(value: Any) -> str:
    """Return a digest of plain data, arrays, functions and objects made of them."""
    made = hashlib.sha256()
    for part in _inside(value, 0):
        made.update(part)
        made.update(b"\0")
    return made.hexdigest()[:_DIGITS]


def _inside(value: Any, depth: int) -> Iterator[bytes]:
    """Yield a value in pieces, the same in every process; what is nested too deeply counts by its class."""
    if depth > _DEEPEST:
        yield type(value).__name__.encode()
    else:
        yield from _parts(value, partial(_inside, depth=depth + 1))


@singledispatch
def _parts(value: Any, inner: Inner) -> Iterator[bytes]:
    """Yield an object in pieces; ``inner`` does so with what it is made of."""
    yield from inner(type(value))
    if hasattr(value, "__wrapped__"):  # by functools.lru_cache, for instance
        yield from inner(value.__wrapped__)
    yield from inner(_stated(value) if hasattr(value, "__dict__") or is_dataclass(value) else str(value))


@_parts.register(NoneType)
@_parts.register(bool)
@_parts.register(int)
@_parts.register(float)
@_parts.register(complex)
@_parts.register(str)
@_parts.register(bytes)
def _(value: Any, inner: Inner) -> Iterator[bytes]:  # noqa: ARG001
    yield repr(value).encode("utf-8", "backslashreplace")


@_parts.register
def _(value: np.ndarray, inner: Inner) -> Iterator[bytes]:
    yield f"{value.dtype}{value.shape}".encode()
    yield from inner(value.tolist()) if value.dtype.hasobject else [np.ascontiguousarray(value).tobytes()]


@_parts.register
def _(value: np.generic, inner: Inner) -> Iterator[bytes]:
    yield from inner(np.asarray(value))


@_parts.register
def _(value: Enum, inner: Inner) -> Iterator[bytes]:  # noqa: ARG001
    yield str(value).encode()


@_parts.register
def _(value: Path, inner: Inner) -> Iterator[bytes]:  # noqa: ARG001
    try:
        yield value.read_bytes() if value.is_file() else b""  # a folder has no content
    except OSError:
        yield b""


@_parts.register(Mapping)
def _(value: Mapping[Any, Any], inner: Inner) -> Iterator[bytes]:
    for key, entry in value.items():
        yield from inner(key)
        yield from inner(entry)
    yield b"}"


@_parts.register(list)
@_parts.register(tuple)
def _(value: Any, inner: Inner) -> Iterator[bytes]:
    for entry in value:
        yield from inner(entry)
    yield b"]"


@_parts.register(set)
@_parts.register(frozenset)
def _(value: Any, inner: Inner) -> Iterator[bytes]:  # noqa: ARG001
    yield from sorted(digest(entry).encode() for entry in value)


@_parts.register
def _(value: CodeType, inner: Inner) -> Iterator[bytes]:
    yield value.co_code
    yield from inner((value.co_consts, value.co_names))


@_parts.register
def _(value: FunctionType, inner: Inner) -> Iterator[bytes]:
    cells = [cell.cell_contents for cell in value.__closure__ or () if _filled(cell)]
    named = {name: value.__globals__.get(name) for name in value.__code__.co_names}
    beside = {name: each.__code__ for name, each in named.items() if isinstance(each, FunctionType)}
    yield from inner((value.__code__, value.__defaults__, value.__kwdefaults__, beside))
    yield from inner([cell for cell in cells if _is_plain(cell)])
    yield from inner({name: each for name, each in named.items() if each is not None and _is_plain(each)})
    if hasattr(value, "__wrapped__"):
        yield from inner(value.__wrapped__)


@_parts.register
def _(value: MethodType, inner: Inner) -> Iterator[bytes]:
    yield from inner((value.__func__, value.__self__))


@_parts.register
def _(value: np.ufunc, inner: Inner) -> Iterator[bytes]:  # noqa: ARG001
    yield value.__name__.encode()


@_parts.register
def _(value: np.random.Generator, inner: Inner) -> Iterator[bytes]:
    yield from inner(value.bit_generator.state)


@_parts.register
def _(value: partial, inner: Inner) -> Iterator[bytes]:  # type: ignore[type-arg]
    yield from inner((value.func, value.args, value.keywords))


@_parts.register
def _(value: type, inner: Inner) -> Iterator[bytes]:
    yield f"{value.__module__}.{value.__qualname__}".encode()
    if not value.__module__.startswith(_OWN):
        yield from inner({name: each for name, each in vars(value).items() if isinstance(each, FunctionType)})


def _stated(value: Any) -> dict[str, Any]:
    """Return what an object was made from: its fields, arguments of the constructor, public attributes."""
    if is_dataclass(value):
        return {each.name: getattr(value, each.name) for each in fields(value) if each.init}
    cached = {
        name for each in type(value).__mro__ for name, member in vars(each).items() if _is_cache(member)
    }
    known = {name: each for name, each in vars(value).items() if name not in cached}
    taken = inspect.signature(type(value).__init__).parameters
    made = {name: known[f"_{name}"] for name in taken if f"_{name}" in known}
    return made | {name: each for name, each in known.items() if not name.startswith("_")}


def _is_cache(member: object) -> bool:
    return isinstance(member, cached_property)


def _is_plain(value: Any) -> bool:
    """Whether a value that a function refers to is data: what else it may reach has no end."""
    if isinstance(value, list | tuple | set | frozenset):
        return all(map(_is_plain, value))
    if isinstance(value, Mapping):
        return all(_is_plain(entry) for pair in value.items() for entry in pair)
    return value is None or isinstance(value, bool | int | float | str | bytes | np.ndarray | np.generic)


def _filled(cell: Any) -> bool:
    try:
        return cell.cell_contents is not cell
    except ValueError:  # not assigned yet
        return False
