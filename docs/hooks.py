"""What the site does with pages besides what MkDocs does.

Formulas become MathML, which needs no script. The search works without a network: the script that it needs
in pages opened from files is that in ``assets/iframe-worker`` (version 1.0.4, MIT licence).
"""

from __future__ import annotations

import html
import re
from typing import Any

from latex2mathml.converter import convert
from mkdocs.utils import get_relative_url

_FORMULA = re.compile(r'<(span|div) class="arithmatex">(?:\\\((.*?)\\\)|\\\[(.*?)\\\])</\1>', re.DOTALL)
_REMOTE, _OWN = "https://unpkg.com/iframe-worker/shim", "assets/iframe-worker/index.js"


def on_page_content(content: str, **_: Any) -> str:
    """Return the page with formulas in MathML."""

    def formula(found: re.Match[str]) -> str:
        inline = found[2] is not None
        text = html.unescape(found[2] if inline else found[3])
        return str(convert(text.strip(), display="inline" if inline else "block"))

    return _FORMULA.sub(formula, content)


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """Return the page with the script of the search from the site itself."""
    return output.replace(_REMOTE, get_relative_url(_OWN, page.url))


def on_post_template(output: str, **_: Any) -> str:
    """Return a page that is no page of the documentation, such as that of a missing one."""
    return output.replace(_REMOTE, f"/{_OWN}")
