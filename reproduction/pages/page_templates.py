"""The templates of the generated pages."""

from __future__ import annotations

from typing import Any


def template(name: str) -> Any:
    """Return a template of this package.

    :param name: of its file.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    templates = Environment(
        loader=PackageLoader("reproduction.pages"),
        undefined=StrictUndefined,
        keep_trailing_newline=True,
        # Markdown needs no HTML escapes, and all of it comes from our own code.
        autoescape=False,
    )
    return templates.get_template(name)
