"""Pages: sections of tiles, charts, tables and diagrams as plain values, and the file that shows them.

A page is one HTML file. The values of all its charts are in one block of JSON; the scripts that draw them,
this package's own and plotly.js, are in the file as well, so that it opens without a network.
"""

from __future__ import annotations

import base64
import gzip
import html
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.results.store import finite, write_file

__all__ = ["Chart", "Diagram", "Explorer", "Notes", "Page", "Section", "Table", "Tile", "Tiles", "View", "of"]

Array = npt.NDArray[np.float64]
Trace = dict[str, Any]

_MOST_EXACT = 30_000  # values of an array in double precision; larger ones are in single precision


def of(name: str, row: int | None = None) -> dict[str, Any]:
    """Stand in a trace for an array of the page, or for one of its rows."""
    return {"array": name} if row is None else {"array": name, "row": row}


@dataclass(frozen=True)
class Tile:
    """A figure in short: what it is, its value as text, and a remark."""

    label: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class Tiles:
    """Figures in short, side by side."""

    tiles: Sequence[Tile]


@dataclass(frozen=True)
class Notes:
    """Sentences that a reader must not miss, or, if ``mild``, that explain what follows."""

    texts: Sequence[str]
    mild: bool = False


@dataclass(frozen=True)
class View:
    """What a chart shows if its label is chosen: traces of plotly.js, and changes of the layout."""

    label: str
    traces: Sequence[Trace]
    layout: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Chart:
    """A chart of plotly.js, with a choice if it has several views.

    Attributes
    ----------
    title
        What it shows, in a few words; also its accessible name.
    layout
        Layout of plotly.js; colours come from the page.
    height
        In pixels.
    choice
        What is chosen by the views.
    """

    title: str
    views: Sequence[View]
    layout: Mapping[str, Any] = field(default_factory=dict)
    height: int = 340
    choice: str = "show"


@dataclass(frozen=True)
class Table:
    """A table that sorts by its columns; cells are texts, numbers or links ``(text, address)``."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    most: int = 100


@dataclass(frozen=True)
class Diagram:
    """The network, coloured by one of several quantities at one of several moments.

    Attributes
    ----------
    buses, places
        Names and positions of the buses, in a square from 0 to 1.
    edges
        Names of the branches, and positions of their buses among the buses.
    colours
        Quantity by label: ``kind`` (bus or branch), ``array``, ``unit``, and the ``low`` and ``high`` end
        of the scale.
    moments
        Labels of the columns of the arrays.
    """

    title: str
    buses: Sequence[str]
    places: Sequence[tuple[float, float]]
    branches: Sequence[str]
    edges: Sequence[tuple[int, int]]
    colours: Mapping[str, Mapping[str, Any]]
    moments: Sequence[str]


@dataclass(frozen=True)
class Explorer:
    """The runs of a study: any figure against any axis, and runs side by side.

    Attributes
    ----------
    axes, figures
        Names of the columns that vary, and of those with results.
    rows
        Values of the runs by column.
    links
        Address of the report of each run, empty if there is none.
    """

    title: str
    axes: Sequence[str]
    figures: Sequence[str]
    rows: Sequence[Mapping[str, Any]]
    links: Sequence[str]


Part = Tiles | Notes | Chart | Table | Diagram | Explorer


@dataclass(frozen=True)
class Section:
    """A part of a page with a heading, to which its menu leads."""

    title: str
    parts: Sequence[Part]


@dataclass(frozen=True)
class Page:
    """A page.

    Attributes
    ----------
    title, subtitle
        Heading, and the line below it.
    arrays
        Arrays for which :func:`of` stands, of one or two dimensions.
    """

    title: str
    subtitle: str
    sections: Sequence[Section]
    arrays: Mapping[str, Array] = field(default_factory=dict)

    def html(self) -> str:
        """The page as one file of HTML."""
        content = {
            "sections": [
                {"title": section.title, "parts": [_plain(part) for part in section.parts]}
                for section in self.sections
            ],
            "arrays": {name: _encoded(values) for name, values in self.arrays.items()},
        }
        # "<" could end the block in which the browser reads it
        dumped = json.dumps(finite(content), allow_nan=False, separators=(",", ":"), default=_listed)
        text = dumped.replace("<", "\\u003c")
        values = {
            "title": html.escape(self.title),
            "subtitle": html.escape(self.subtitle),
            "style": _asset("page.css"),
            "content": text,
            "plotly": _plotly(),
            "script": _asset("page.js"),
        }
        return re.sub(r"\{\{ (\w+) \}\}", lambda place: values[place[1]], _asset("page.html"))

    def write(self, path: Path) -> Path:
        """Write the page to a file, atomically; its folder is created if necessary.

        Raises
        ------
        ResultError
            The file cannot be written.
        """
        return write_file(path, self.html().encode())


def _plain(part: Part) -> dict[str, Any]:
    """Return a part as plain data, with the name of its class."""
    made: dict[str, Any] = {"part": type(part).__name__.lower()}
    for name, value in vars(part).items():
        if name in ("tiles", "views"):
            made[name] = [dict(vars(each)) for each in value]
        else:
            made[name] = value
    return made


def _listed(value: Any) -> Any:
    """Return numbers of NumPy as those of Python, without NaN, which JSON lacks."""
    return finite(value.tolist())


def _encoded(values: Array) -> dict[str, Any]:
    """Return an array as plotly.js reads it: the bytes of its numbers in base 64."""
    kind = "<f8" if values.size <= _MOST_EXACT else "<f4"
    packed = np.ascontiguousarray(values, dtype=kind)
    return {
        "dtype": kind[1:],
        "bdata": base64.b64encode(packed.tobytes()).decode("ascii"),
        "shape": list(values.shape),
    }


def _asset(name: str) -> str:
    return resources.files(__package__).joinpath("assets", name).read_text(encoding="utf-8")


@cache
def _plotly() -> str:
    """Return plotly.js, compressed and in base 64, a third of its size; browsers expand it."""
    source = resources.files("plotly").joinpath("package_data", "plotly.min.js").read_bytes()
    return base64.b64encode(gzip.compress(source, 9, mtime=0)).decode("ascii")
