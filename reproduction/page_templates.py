"""Render pages from their templates in ``reproduction/templates``."""

from __future__ import annotations

import re
from typing import Any

from saver_advisors.reporting.templates import rendered


def page(name: str, /, **content: Any) -> str:
    """Render a page; several empty lines in a row become one.

    :param name: of the template.
    :param content: what the template shows.
    :return: Markdown that ends with a line break.
    """
    text = rendered("reproduction", f"{name}.md.j2", trim_blocks=True, **content)
    return re.sub(r"\n{3,}", "\n\n", text).rstrip("\n") + "\n"
