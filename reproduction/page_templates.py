"""Render pages from their templates in ``reproduction/templates``."""

from __future__ import annotations

import re
from typing import Any

from saver_advisors.reporting.tables import rows_table


def page(name: str, /, **content: Any) -> str:
    """Render a page; several empty lines in a row become one.

    :param name: of the template. It can render rows with ``rows | table(columns)``, see
        :func:`saver_advisors.reporting.tables.rows_table`.
    :param content: what the template shows.
    :return: Markdown that ends with a line break.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    templates = Environment(
        loader=PackageLoader("reproduction"),
        undefined=StrictUndefined,
        trim_blocks=True,
        # Markdown needs no HTML escapes, and all of it comes from our own code.
        autoescape=False,
    )
    templates.filters["table"] = rows_table
    text = templates.get_template(f"{name}.md.j2").render(content)
    return re.sub(r"\n{3,}", "\n\n", text).rstrip("\n") + "\n"
