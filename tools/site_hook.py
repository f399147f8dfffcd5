"""What MkDocs does to the HTML of every page of the site: see ``hooks`` in mkdocs.yml.

Formulas become MathML, which browsers draw without a script, so that the site loads nothing from
elsewhere. Sphinx's roles in docstrings become code, as MkDocs does not know them.
"""

from __future__ import annotations

import html
import re
from typing import Any

from latex2mathml.converter import convert

#: What `pymdownx.arithmatex` leaves of a formula: `\\(...\\)` in a line, `\\[...\\]` on its own.
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', flags=re.DOTALL)
ROLE = re.compile(r":(?:class|data|exc|func|meth|mod):<code>~?([^<]*)</code>")


def on_page_content(text: str, **_: Any) -> str:
    """Replace formulas and roles.

    :param text: HTML of a page.
    :return: the HTML with MathML.
    """
    return ROLE.sub(_last_name, FORMULA.sub(_mathml, text))


def _mathml(found: re.Match[str]) -> str:
    display = "inline" if found[2] == "(" else "block"
    formula: str = convert(html.unescape(found[3]).strip(), display=display)
    return formula


def _last_name(found: re.Match[str]) -> str:
    """Return the name without its modules."""
    return f"<code>{found[1].rsplit('.', 1)[-1]}</code>"
