"""Render pages from templates, in HTML or Markdown."""

from __future__ import annotations

from typing import Any

from saver_advisors.reporting.tables import rows_table


def rendered(package: str, name: str, /, *, trim_blocks: bool = False, **values: Any) -> str:
    """Render a template, which can render rows with ``rows | table(columns)``; see
    :func:`saver_advisors.reporting.tables.rows_table`.

    :param package: whose folder ``templates`` holds it; web pages extend ``frame.html.j2`` of ours
    :param name: of the file; values are escaped in HTML, but not in Markdown
    :param trim_blocks: omit the line break after a block's tag
    :param values: variables of the template
    :return: the page
    """
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    templates = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader("saver_advisors.reporting")]),
        undefined=StrictUndefined,
        keep_trailing_newline=True,
        trim_blocks=trim_blocks,
        autoescape=".html" in name,
    )
    templates.filters["table"] = rows_table
    return templates.get_template(name).render(values)
