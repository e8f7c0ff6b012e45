"""Objects as a notebook shows them."""

from __future__ import annotations

import html
from collections.abc import Mapping

__all__ = ["pairs"]


def pairs(title: str, values: Mapping[str, str]) -> str:
    """Return a title and names with their values, as HTML.

    Examples
    --------
    >>> pairs("a < b", {"buses": "5"})
    "<b>a &lt; b</b><table><tr><th style='text-align:left'>buses</th><td>5</td></tr></table>"
    """
    rows = (
        f"<tr><th style='text-align:left'>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>"
        for name, value in values.items()
    )
    return f"<b>{html.escape(title)}</b><table>{''.join(rows)}</table>"
