"""Strict checks of MATPOWER case files before they are parsed.

A parser made for speed is lenient: it reads bus 1.5 as bus 1, drops ``NaN`` cost coefficients, which
makes the cost zero, and uses the first of two tables of the same name where MATLAB uses the last.
:func:`read_case` splits a file into statements as MATLAB does, checks the tables that opfmodel uses, and
writes each of them once, row by row, to a normalized text that every parser reads in the same way.

The module is not an interpreter. Tables and scalars must be plain numbers. Statements that modify them
afterwards (``mpc.bus(:, PD) = ...``) are kept in place for the parser to evaluate or refuse. Control flow
is reported but not executed, and any other statement that could change the case is an error with its line.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from opfmodel.data.files import MB, read_text
from opfmodel.errors import CaseError, listed
from opfmodel.network.cases import capability

__all__ = ["CaseFile", "read_case"]

MOST_BYTES = 100 * MB  # the largest PGLib case, with 78,484 buses, has 27 MB

# Required columns, by table.
COLUMNS = {
    name: tuple(columns.split())
    for name, columns in {
        "bus": "BUS_I BUS_TYPE PD QD GS BS BUS_AREA VM VA BASE_KV ZONE VMAX VMIN",
        "gen": "GEN_BUS PG QG QMAX QMIN VG MBASE GEN_STATUS PMAX PMIN",
        "branch": "F_BUS T_BUS BR_R BR_X BR_B RATE_A RATE_B RATE_C TAP SHIFT BR_STATUS ANGMIN ANGMAX",
        "gencost": "MODEL STARTUP SHUTDOWN NCOST",
        "storage": "STORAGE_BUS PS QS ENERGY ENERGY_RATING CHARGE_RATING DISCHARGE_RATING "
        "CHARGE_EFFICIENCY DISCHARGE_EFFICIENCY THERMAL_RATING QMIN QMAX R X P_LOSS Q_LOSS STATUS",
        "dcline": "F_BUS T_BUS BR_STATUS PF PT QF QT VF VT PMIN PMAX QMINF QMAXF QMINT QMAXT LOSS0 LOSS1",
        "dclinecost": "MODEL STARTUP SHUTDOWN NCOST",
    }.items()
}
SCALARS = ("baseMVA", "version")
# Columns of generators that a file may have after the required ones; capability curves and RAMP_30 are
# represented, and APF, the share in an area's regulation, means nothing to a power flow or an optimum.
_MORE_COLUMNS = "PC1 PC2 QC1MIN QC1MAX QC2MIN QC2MAX RAMP_AGC RAMP_10 RAMP_30 RAMP_Q APF"
MORE_COLUMNS = tuple(_MORE_COLUMNS.split())
HARMLESS = {"areas", "bus_name", "branch_name", "gen_name", "gentype", "genfuel"}

EXACT = 2**53  # all integers up to this are exact in floating point
BUS_NUMBERS = ("GEN_BUS", "F_BUS", "T_BUS", "STORAGE_BUS")
# Minimum and maximum of columns that hold integers.
WHOLE = {
    "BUS_I": (1, EXACT),
    **dict.fromkeys(BUS_NUMBERS, (1, EXACT)),
    "BUS_AREA": (0, EXACT),
    "ZONE": (0, EXACT),
    "BUS_TYPE": (1, 4),
    "GEN_STATUS": (0, 1),
    "BR_STATUS": (0, 1),
    "STATUS": (0, 1),
    "MODEL": (1, 2),
    "NCOST": (1, EXACT),
}


@dataclass(frozen=True)
class Table:
    """A matrix in a case file.

    Attributes
    ----------
    line
        Line of the file on which the matrix begins.
    words
        Entries as written, row by row.
    values
        Numerical values, ``(rows, columns)``.
    lines
        Line of the file of each row.
    """

    name: str
    line: int
    words: Sequence[str]
    values: npt.NDArray[np.float64]
    lines: Sequence[int]

    def __len__(self) -> int:
        return len(self.lines)

    def column(self, name: str) -> npt.NDArray[np.float64]:
        """Values of a column."""
        return self.values[:, COLUMNS[self.name].index(name)] if len(self) else np.zeros(0)


@dataclass
class CaseFile:
    """A checked case file.

    Attributes
    ----------
    text
        Normalized text of the case, for the parser.
    lines
        Line of each row, by table.
    changes
        Line and text of each statement that modifies a table after its assignment. The parser
        reports whether they are evaluated.
    remarks
        Warnings for the user, with file and line.
    losses
        What opfmodel does not represent, with the line.
    """

    path: Path
    text: str = ""
    lines: dict[str, Sequence[int]] = field(default_factory=dict)
    changes: list[tuple[int, str]] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    losses: list[str] = field(default_factory=list)

    def place(self, table: str, row: int) -> str:
        """File and line of a table row."""
        return f"{self.path}:{self.lines[table][row]}"

    def unevaluated(self, statements: Sequence[tuple[int, str]]) -> str:
        """Describe the loss of statements that have no effect."""
        (line, code), *others = statements
        more = f" nor are those on lines {listed(str(n) for n, _ in others)}," if others else ""
        return f"line {line}: {_short(code)} is not evaluated,{more} and the tables are used as written"


def read_case(path: Path) -> CaseFile:
    """Read and check a MATPOWER case file.

    Raises
    ------
    CaseError
        The file cannot be opened, a table or scalar does not consist of plain numbers, the rows of a
        table differ in length, a bus number, type, status or cost model is invalid, or a statement
        is not understood.
    """
    text = read_text(path, CaseError, MOST_BYTES).removeprefix("\ufeff").replace("\r", "\n")
    parser = _Parser(path)
    for line, code in _statements(path, _without_block_comments(path, text)):
        if not parser.take(line, code):
            break
    case = parser.finish()
    _Checks(case, parser.tables).run()
    return case


# Statements -------------------------------------------------------------------------------------

_BLANK = re.compile(r"(?:[\s;,]+|%[^\n]*|\.\.\.[^\n]*)*+")
_TABLE = re.compile(rf"mpc\.(?:{'|'.join(COLUMNS)})\s*=\s*\[")
# A quote begins a string unless it follows an operand, where it means transposition.
_MARK = re.compile(
    r"""%[^\n]*|\.\.\.[^\n]*\n?|(?<![\w)\]}.'])'(?:[^'\n]|'')*+'|"(?:[^"\n]|"")*+"|[\[({]|[])}]|[;,\n]"""
)


def _without_block_comments(path: Path, text: str) -> str:
    """Blank out ``%{ ... %}`` comments, keeping the line numbers."""
    if "%{" not in text:
        return text
    begun: list[int] = []
    kept = []
    for number, line in enumerate(text.split("\n"), start=1):
        inside = bool(begun)
        if line.strip() == "%{":
            begun.append(number)
        elif line.strip() == "%}" and begun:
            begun.pop()
        kept.append("" if inside or begun else line)
    if begun:
        raise CaseError(f"{path}:{begun[0]}: cannot be read as a network: %{{ has no closing %}}")
    return "\n".join(kept)


def _statements(path: Path, text: str) -> Iterator[tuple[int, str]]:
    """Line and text of each statement, without the separators and comments in between."""
    line, counted = 1, 0
    start = _end_of(_BLANK, text, 0)
    while start < len(text):
        line += text.count("\n", counted, start)
        counted = start
        table = _TABLE.match(text, start)
        inside = start if table is None else _end_of_table(text, table.end())
        end = -1 if inside < 0 else _end_of_statement(text, inside)
        if end < 0:
            raise CaseError(
                f"{path}:{line}: cannot be read as a network: {_short(text[start:])} has no closing bracket"
            )
        yield line, text[start:end]
        start = _end_of(_BLANK, text, end)


def _end_of(pattern: re.Pattern[str], text: str, start: int) -> int:
    found = pattern.match(text, start)
    return start if found is None else found.end()


def _end_of_table(text: str, start: int) -> int:
    """Position after the closing bracket of a numeric table, or -1 if there is none."""
    close = text.find("]", start)
    while close >= 0:
        before = text[max(text.rfind("\n", start, close), start) : close]
        if "%" not in before and "..." not in before:
            return close + 1
        following = text.find("\n", close)
        close = text.find("]", following) if following >= 0 else -1
    return -1


def _end_of_statement(text: str, start: int) -> int:
    """Position of the separator or comment that ends a statement, or -1 if a bracket is still open."""
    depth = 0
    for found in _MARK.finditer(text, start):
        mark = found.group()
        if mark in ("[", "(", "{"):
            depth += 1
        elif mark in ("]", ")", "}"):
            depth -= 1
        elif depth <= 0 and mark[0] in ";,\n%":
            return found.start()
    return -1 if depth > 0 else len(text)


# Meaning of statements --------------------------------------------------------------------------

_FUNCTION = re.compile(r"function\b")
_HEADER = re.compile(r"function\s+(?:mpc|\[\s*mpc\s*\])\s*=\s*\w+\s*(?:\(.*\)\s*)?")
_ASSIGNMENT = re.compile(r"mpc\.(\w+)\s*=(?!=)\s*")
_PART = re.compile(r"mpc\.(\w+)\s*([.({])")
_VARIABLE = re.compile(r"(?!mpc\b)(?:[A-Za-z]\w*(?:[.({][^='\"]*+)?|\[(?:(?!\bmpc\b)[^]=])*+\])\s*+=(?!=)")
_OPENING = re.compile(r"(?:if|for|while|switch|try|parfor)\b")
_CONSTANTS = re.compile(r"define_constants\s*")
_END = re.compile(r"end\s*")
_LAST = re.compile(r"(?:end|return)\s*")
# Text, cells of text, and nothing at all, which mean nothing electrical.
_TEXT = re.compile(r"""(?:'[^']*+'|"[^"]*+"|[\[{](?:'(?:[^']|'')*+'|"[^"]*+"|[\s;,]|%[^\n]*+)*+[]}])\s*+""")
_VERSION = re.compile(r"(['\"]?)[12]\1")
_NUMBER = re.compile(r"[-+]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|[Ii]nf|NaN|nan)")


class _Parser:
    """Process statements one by one and collect the contents of the case."""

    def __init__(self, path: Path) -> None:
        self.case = CaseFile(path)
        self.tables: dict[str, Table] = {}
        self.parts: dict[str | int, str] = {}  # normalized text in order, by name or number
        self.assigned: dict[str, int] = {}
        self.changed: set[str] = set()
        self.unread: dict[str, int] = {}
        self.blocks: list[tuple[int, str]] = []  # open control-flow blocks
        self.skipped: list[tuple[int, str]] = []
        self.begun = False
        self.handed_on = 0

    def take(self, line: int, code: str) -> bool:
        """Process one statement; return whether more may follow."""
        if _FUNCTION.match(code):
            if self.begun:  # local functions, which are never called
                return False
            if not _HEADER.fullmatch(code):
                raise self._error(line, f"{_short(code)}: must be 'function mpc = NAME'")
        elif self.blocks or _OPENING.match(code):
            self._take_in_block(line, code)
        elif assignment := _ASSIGNMENT.match(code):
            self._assign(line, assignment[1], code[assignment.end() :])
        elif part := _PART.match(code):
            self._change(line, code, part[1], part[2])
        elif _LAST.fullmatch(code):
            return False
        elif _VARIABLE.match(code) or _CONSTANTS.fullmatch(code):
            self._hand_on(code)
        else:
            raise self._error(
                line, f"{_short(code)} is not understood; use plain assignments: mpc.NAME = [ ... ];"
            )
        self.begun = True
        return True

    def finish(self) -> CaseFile:
        """Assemble the case after all statements."""
        if self.blocks:
            line, code = self.blocks[0]
            raise self._error(line, f"{_short(code)} has no matching 'end'")
        for name in ("baseMVA", "bus", "branch"):
            if name not in self.assigned:
                raise CaseError(f"{self.case.path}: cannot be read as a network: mpc.{name} is missing")
        for name, line in self.unread.items():
            self.case.losses.append(f"line {line}: mpc.{name} is not represented")
        if self.skipped:
            self.case.losses.append(self.case.unevaluated(self.skipped))
        self.case.text = "".join(self.parts.values())
        self.case.lines = {name: table.lines for name, table in self.tables.items()}
        return self.case

    def _take_in_block(self, line: int, code: str) -> None:
        """Skip control flow with a warning; refuse assignments of tables and scalars inside it."""
        if _OPENING.match(code):
            if not self.blocks:
                self.skipped.append((line, code))
            self.blocks.append((line, code))
        elif _END.fullmatch(code):
            self.blocks.pop()
        elif (assignment := _ASSIGNMENT.match(code)) and assignment[1] in (*COLUMNS, *SCALARS):
            raise self._error(line, f"mpc.{assignment[1]} is assigned inside {_short(self.blocks[0][1])}")

    def _assign(self, line: int, name: str, value: str) -> None:
        if name in COLUMNS:
            table, code = self._table(line, name, value)
            self.tables[name] = table
        elif name in SCALARS:
            code = self._scalar(line, name, value.strip())
        else:
            if name not in HARMLESS and not _TEXT.fullmatch(value):
                self.unread.setdefault(name, line)
            return
        if name in self.changed:
            raise self._error(line, f"mpc.{name} is assigned again after statements that modify it")
        if name in self.assigned:
            # MATLAB runs the file, so MATPOWER uses the last assignment. The earlier one may be a
            # leftover or intended, so the user is warned.
            self._remark(line, f"mpc.{name} is assigned again; this overrides line {self.assigned[name]}")
        self.assigned[name] = line
        self.parts.pop(name, None)
        self.parts[name] = code

    def _change(self, line: int, code: str, name: str, bracket: str) -> None:
        if name in (*COLUMNS, *SCALARS):
            if bracket != "(":
                raise self._error(
                    line, f"{_short(code)} is not understood; mpc.{name} must consist of numbers"
                )
            self.changed.add(name)
            self.case.changes.append((line, code))
            self._hand_on(code)
        elif name not in HARMLESS:
            self.unread.setdefault(name, line)

    def _hand_on(self, code: str) -> None:
        """Pass a statement to the parser, in its original position."""
        self.handed_on += 1
        self.parts[self.handed_on] = code + ";\n"

    def _scalar(self, line: int, name: str, value: str) -> str:
        if name == "version" and not _VERSION.fullmatch(value):
            raise self._error(line, f"mpc.version = {_short(value)}: must be '1' or '2'")
        if name == "baseMVA" and not (_NUMBER.fullmatch(value) and 0 < float(value) < np.inf):
            raise self._error(line, f"mpc.baseMVA = {_short(value)}: must be a positive number")
        return f"mpc.{name} = {value};\n"

    def _table(self, line: int, name: str, value: str) -> tuple[Table, str]:
        """Parse a table; return it and its text without comments, commas and line continuations."""
        close = _end_of_table(value, 1)
        if not value.startswith("[") or value[close:].strip():
            raise self._error(line, f"mpc.{name} = {_short(value)}: must be a table [ ... ] of numbers")
        body = re.sub("%[^\n]*", "", value[1 : close - 1])
        continued = "..." in body
        if continued:
            body = re.sub(r"\.\.\.[^\n]*\n?", "\f", body)  # white space that still counts as a line
        if "," in body:
            odd = re.search(r"(?:^|[;,\n])[^\S\n]*,", body)
            if odd:
                at = line + body.count("\n", 0, odd.end()) + body.count("\f", 0, odd.end())
                raise self._error(at, f"mpc.{name}: missing number before a comma")
            body = body.replace(",", " ")
        words: list[str] = []
        widths: list[int] = []
        lines: list[int] = []
        number = line
        for text in body.split("\n"):
            for row in text.split(";"):
                found = row.split()
                if found:
                    words += found
                    widths.append(len(found))
                    lines.append(number)
            number += 1 + (text.count("\f") if continued else 0)
        if len(set(widths)) > 1:
            usual = Counter(widths).most_common(1)[0][0]
            odd_row = next(i for i, width in enumerate(widths) if width != usual)
            whose = _whose(self.tables, name, odd_row)
            raise self._error(
                lines[odd_row], f"{whose}: the row has {widths[odd_row]} numbers; the other rows have {usual}"
            )
        if not (_plain(body) and (values := _floats(words)) is not None):
            blank = _ODD_BLANK.search(body)  # separates words in Python, but not in MATLAB
            if blank:
                at_line = line + body.count("\n", 0, blank.start()) + body.count("\f", 0, blank.start())
                raise self._error(at_line, f"mpc.{name}: {blank[0]!a} is not accepted between numbers")
            at, word = next((i, w) for i, w in enumerate(words) if not _NUMBER.fullmatch(w))
            row_at = at // widths[0]
            raise self._error(
                lines[row_at], f"{_whose(self.tables, name, row_at)}: {word!r} is not a plain number"
            )
        values = values.reshape(len(lines), widths[0] if widths else 0)
        table = Table(name, line, words, values, lines)
        return table, f"mpc.{name} = [\n{body}\n];\n"

    def _remark(self, line: int, what: str) -> None:
        self.case.remarks.append(f"{self.case.path}:{line}: {what}")

    def _error(self, line: int, what: str) -> CaseError:
        return CaseError(f"{self.case.path}:{line}: {what}")


_ODD_BLANK = re.compile(r"[^\S \t\n\f]")
_DIGITS = str.maketrans("", "", "0123456789+-.eE \t\n\f;")


def _plain(body: str) -> bool:
    """Whether a table contains only numbers, infinity and NaN."""
    for word in ("Inf", "inf", "NaN", "nan"):
        body = body.replace(word, "")
    return not body.translate(_DIGITS)


def _floats(words: Sequence[str]) -> npt.NDArray[np.float64] | None:
    try:
        return np.array(words, dtype=float)
    except ValueError:
        return None


def _short(code: str) -> str:
    """Beginning of a statement, in quotes."""
    first = code.strip().split("\n", 1)[0].strip()
    return repr(first if len(first) <= 60 else first[:57] + "...")


# Checks -----------------------------------------------------------------------------------------


class _Checks:
    """Consistency checks of the tables of a case."""

    def __init__(self, case: CaseFile, tables: Mapping[str, Table]) -> None:
        self.case = case
        self.tables = tables

    def run(self) -> None:
        """Raise an error for the first invalid entry."""
        for table in self.tables.values():
            if len(table):
                self._columns(table)
        self._buses()
        if "gencost" in self.tables:
            self._costs(self.tables["gencost"])
        if "dclinecost" in self.tables:
            self._costs_of_dc_lines(self.tables["dclinecost"])
        if len(self.tables.get("gen", ())):
            self._more_columns(self.tables["gen"])

    def _columns(self, table: Table) -> None:
        """Check that all columns are present, and that bus numbers, types and states are integers."""
        columns = COLUMNS[table.name]
        if table.values.shape[1] < len(columns):
            raise CaseError(
                f"{self.case.place(table.name, 0)}: mpc.{table.name}: {table.values.shape[1]} columns; "
                f"at least {len(columns)} are required: {', '.join(columns)}"
            )
        for column in columns:
            if column in WHOLE:
                low, high = WHOLE[column]
                values = table.column(column)
                sound = (values >= low) & (values <= high) & (values == np.floor(values))
                accepted = f"at least {low}" if high == EXACT else f"from {low} to {high}"
                self._require(table, column, sound, f"must be an integer {accepted}")

    def _buses(self) -> None:
        """Check that bus numbers are unique, and that all referenced buses exist."""
        buses = self.tables["bus"]
        numbers = buses.column("BUS_I")
        first = np.zeros(len(numbers), dtype=bool)
        first[np.unique(numbers, return_index=True)[1]] = True
        self._require(buses, "BUS_I", first, "duplicate bus number")
        for table in self.tables.values():
            for column in BUS_NUMBERS:
                if column in COLUMNS[table.name]:
                    known = np.isin(table.column(column), numbers)
                    self._require(table, column, known, "no such bus")

    def _costs(self, costs: Table) -> None:
        """Check that there are one or two rows per generator, and that each has NCOST numbers or points."""
        generators = len(self.tables.get("gen", ()))
        if len(costs) not in (generators, 2 * generators):
            raise CaseError(
                f"{self.case.path}:{costs.line}: mpc.gencost has {len(costs)} rows for {generators} "
                "generators; one per generator is required, or two with costs of reactive power"
            )
        if not len(costs):
            return
        self._terms(costs)
        fixed = len(COLUMNS["gencost"])
        if np.any(costs.values[generators:, fixed:]):
            line = costs.lines[generators]
            self.case.losses.append(f"line {line}: mpc.gencost: costs of reactive power are not represented")

    def _costs_of_dc_lines(self, costs: Table) -> None:
        """Check that there is one row per DC line, and that each has NCOST numbers or points."""
        lines = len(self.tables.get("dcline", ()))
        if len(costs) != lines:
            raise CaseError(
                f"{self.case.path}:{costs.line}: mpc.dclinecost has {len(costs)} rows for {lines} DC lines; "
                "one per DC line is required"
            )
        if len(costs):
            self._terms(costs)

    def _terms(self, costs: Table) -> None:
        """Check that each row of a table of costs has NCOST numbers or points."""
        pairs = np.where(costs.column("MODEL") == 1, 2, 1)
        counts = costs.column("NCOST")
        given = costs.values.shape[1] - len(COLUMNS[costs.name])
        self._require(costs, "NCOST", counts >= pairs, "must be at least 2 for a piecewise-linear cost")
        self._require(costs, "NCOST", counts * pairs <= given, f"only {given} numbers follow in the row")

    def _more_columns(self, units: Table) -> None:
        """Report the columns of generators in service that are not represented and not zero."""
        fixed = len(COLUMNS["gen"])
        running = units.column("GEN_STATUS") > 0
        for number, column in enumerate(MORE_COLUMNS, start=fixed):
            if column in (*capability.COLUMNS, "RAMP_30", "APF") or number >= units.values.shape[1]:
                continue
            values = units.values[:, number]
            rows = np.flatnonzero(running & (values != 0) & np.isfinite(values))
            if len(rows):
                row = rows[0]
                more = f" and {len(rows) - 1} more" if len(rows) > 1 else ""
                what = f"gen{row + 1}{more}: {column} = {values[row]:g} is not represented"
                self.case.losses.append(f"line {units.lines[row]}: {what}")

    def _require(self, table: Table, column: str, sound: npt.NDArray[np.bool_], accepted: str) -> None:
        """Raise an error that names the first invalid row and its value."""
        if sound.all():
            return
        row = int(np.argmin(sound))
        word = table.words[row * table.values.shape[1] + COLUMNS[table.name].index(column)]
        whose = _whose(self.tables, table.name, row)
        raise CaseError(f"{self.case.place(table.name, row)}: {whose}: {column} = {word}: {accepted}")


def _whose(tables: Mapping[str, Table], table: str, row: int) -> str:
    """Name of the generator in a row, as in the network; the table name for other tables."""
    if table not in ("gen", "gencost"):
        return f"mpc.{table}"
    generators = len(tables.get("gen", ()))
    return f"gen{(row % generators if generators else row) + 1}"
