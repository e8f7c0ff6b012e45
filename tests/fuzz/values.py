"""What mutations put in place of values, keys, cells and characters."""

from __future__ import annotations

# Values of scenarios and studies, as YAML.
VALUES = (
    *("null", "true", "false", "0", "1", "2", "-1", "3.5", "-0.5", "0.25", "100", "1000000", "1_000"),
    *("1e308", "-1e308", "1e-308", "1e31", "1e29", "5e-324", "1e400", ".inf", "-.inf", ".nan", "0x10", "012", "1000000000"),
    *("9223372036854775807", "-9223372036854775808", "99999999999999999999", "1" * 400, "1" * 5000),
    *('""', '" "', "a", "b", "coal", "line", "town", '"*"', '"**"', '"c*"', "on", "2019-07-22", "12:30:45", "2019-07-22T10:00:00Z"),
    *('"\\0"', '"a\\0b"', '"\\e[31m"', '"a\\nb"', '"\\u202e"', '"\\x85"', f'"{"x" * 5000}"', '"[/red]"', '"%s{}"', '"../x"'),
    *("10% of p_max", "1e400% of p_max", "50% of bus", "300% of energy", "single-stage", "none.csv", "/dev/zero", "/", "series.csv"),
    *("200 MWh", "15 min", "120 MVA", "0.5 pu", "40 EUR/MWh", "1e400 MW", "3 furlongs", "nan MW", "- MW", "1 000 MW", "5 kV", "90 deg"),
    *("2025-03-30T02:30", "2025-13-45", "9999-12-31T23:59", "0001-01-01", "Europe/Berlin", "../../etc/passwd", "repeat", "shrink"),
    *("[]", "{}", "[[]]", "[{}]", "[null]", "[1]", "[1, 2]", "[2, 1]", "[1, 2, 3]", "[.inf, -.inf]", "[.nan, .nan]", "[a, b]"),
    *("[1e308, 1e308]", "[[0, 0], [1, 1]]", "[[1, 2], [1, 3]]", "[[0, 0], [5e-324, 1]]", "{a: 1}", "{a: {b: {c: 1}}}", "{1: 2}"),
    *("{file: series.csv}", "{file: none.csv}", "{file: /dev/zero}", "{file: series.csv, column: curve}", "{file: series.csv, column: x}"),
    *("{c2: -1}", "{c1: 1e308}", "{points: [[0, 0]]}", "{points: 3}", "{points: [1, 2]}", "{c3: 1}", "{name: osqp}", "{mode: nominal}"),
    *("!!omap [a: 1]", "!!set {a}", "!!binary aGVsbG8=", "!!python/object:os.system {}", "!t 1", "{[a]: 1}", "{{a: 1}: 1}", "{? a}"),
    *("*none", "&a [*a]", "&x {<<: *x}", "{<<: 3}", "{<<: {a: 1}}", "[" * 60 + "]" * 60, "[" * 3000, "{a: " * 3000, '"'),
    "[&l0 [x, x]" + "".join(f", &l{n} [{', '.join([f'*l{n - 1}'] * 9)}]" for n in range(1, 12)) + "]",  # billion laughs
    *("economic", "loss-minimisation", "state-of-charge-tracking", "stored-energy-value", "{stored-energy-value: {price: 1}}"),
    *("ac", "dc", "soc", "copperplate", "lindistflow", "perfect", "persistence", "noisy", "{file: {file: series.csv}}"),
    *("power-flow", "redispatch", "nominal", "elastic", "stop", "auto", "ipopt", "conic", "qp:highs", "gurobi"),
)  # fmt: skip

# Values of JSON files.
JSON_VALUES = (
    *("null", "true", "false", "0", "1", "-1", "0.5", "1e308", "-1e308", "1e400", "5e-324", "NaN", "Infinity", "-Infinity", "9" * 30),
    *("9" * 5000, "9223372036854775808", "[]", "{}", "[[]]", "[1]", '{"a": 1}', '""', '"x"', '"NaN"', '"\\u0000"', '"\\u202e"', '"\\ud800"'),
    *('"2019-07-22"', f'"{"x" * 5000}"', "[" * 2000, "[" * 60 + "]" * 60, '"\\u001b[31m"', '"done"', '"../x"', '"%s{}"', "[null, 1, \"a\"]"),
    *('{"_module": "os", "_class": "system", "_object": "touch stray"}', '{"_module": "builtins", "_class": "eval", "_object": "1/0"}'),
    *('{"_module": "subprocess", "_class": "Popen", "_object": ["true"]}', '{"_module": "nosuch", "_class": "x", "_object": ""}'),
    *('{"_module": "pandas.core.frame", "_class": "DataFrame", "_object": "{}"}', '{"_module": "pandas", "_class": "read_pickle", "_object": "x"}'),
)  # fmt: skip

KEYS = (
    *("a", "coal", "line", "network", "controller", "variants", "file", "name", "bus", "p", "weight", "terms", "options", "<<"),
    *("", " ", "a.b", "controller.horizon", "*", "x" * 5000, "a/b", "..", "1", "é", "\x1b[1m", "\n", "\u2028", "__class__", "self"),
    *("_module", "_class", "_object", "dtype", "schema", "checksum", "labels", "result"),
)  # fmt: skip

# Words between separators: cells of tables, arguments of statements.
WORDS = (
    *("0", "1", "2", "-1", "0.5", "1e3", "1e308", "-1e308", "1e400", "5e-324", "nan", "NaN", "inf", "-inf", "Inf", "1e", "--1", "+", "."),
    *("9223372036854775808", "4294967296", "9" * 400, "9" * 5000, "0x10", "1_000", "1,5", "1;5", "1e-400", "٣", "²", "１"),
    *("", " ", "null", "None", "true", "x", "x" * 5000, "é", "\u202e", "\x1b[31m", "\x00", "\ufeff", "'", '"', '"a,b"', "=1+1", "#"),
    *("2025-03-30T02:30", "2025-03-29T00:00+01:00", "30/03/2025", "2025-02-30", "1900-01-01", "12:30", "{}", "[]", "%", "...", "[", "]"),
    *("time", "town.p", "town.q", "town.x", "coal.p_max", "a.b.c", ".p", "p.", "town.p ", "/dev/zero", "../x"),
)  # fmt: skip

TEXTS = (
    *("\t", "\n", " ", "  ", ":", ": ", "-", "- ", "[", "]", "{", "}", ",", "#", "&a ", "*a", "!", "!!map ", "|\n", ">\n", "'", '"'),
    *("%YAML 1.1\n---\n", "\n%YAML 1.2\n---\n", "\n---\n", "\n...\n", "%TAG ! tag:x:\n---\n", "? ", "<<: ", "@", "`", "\\", "~", "\r"),
    *("\x00", "\x1b", "\x7f", "\x85", "\ufeff", "\u2028", "\ud800", "\U0001f600", "9" * 30, "e999", "1e400", "[" * 100, "{" * 2000),
)  # fmt: skip
