"""Render pages from templates, in HTML or Markdown."""

from __future__ import annotations

from typing import Any


def rendered(package: str, name: str, **values: Any) -> str:
    """Render a template.

    :param package: whose folder ``templates`` holds it
    :param name: of the file; values are escaped in HTML, but not in Markdown
    :param values: variables of the template
    :return: the page
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    templates = Environment(
        loader=PackageLoader(package),
        undefined=StrictUndefined,
        keep_trailing_newline=True,
        autoescape=".html" in name,
    )
    return templates.get_template(name).render(values)
