"""The API reference lists every public name, and each has a docstring."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("saver_envs", "saver_advisors")
REFERENCE = [
    name
    for page in sorted((ROOT / "docs" / "reference").glob("*.md"))
    for name in re.findall(r"^::: (\S+)$", page.read_text(), re.MULTILINE)
]


@cache
def resolved(name: str) -> Any:
    module, _, attribute = name.rpartition(".")
    return getattr(importlib.import_module(module), attribute)


def exported() -> Iterator[str]:
    """Names in an `__all__` of the installed packages."""
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            for node in ast.parse(path.read_text()).body:
                if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
                    module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
                    for name in ast.literal_eval(node.value):
                        yield f"{module.removesuffix('.__init__')}.{name}"


def shown() -> Iterator[str]:
    """Names that the code of the documentation imports."""
    texts = [path.read_text() for path in (ROOT / "docs" / "examples").rglob("*.py")]
    for page in (*ROOT.glob("docs/**/*.md"), ROOT / "README.md"):
        texts += re.findall(
            r"^```python[^\n]*\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE
        )
    for text in texts:
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(PACKAGES):
                yield from (f"{node.module}.{alias.name}" for alias in node.names)


def test_every_public_name_is_documented() -> None:
    objects = {id(resolved(name)) for name in REFERENCE}
    public = {*exported(), *shown()}
    assert len(public) > 80
    assert sorted(name for name in public if id(resolved(name)) not in objects) == []


def test_no_name_is_documented_twice() -> None:
    assert len(REFERENCE) == len({id(resolved(name)) for name in REFERENCE})


@pytest.mark.parametrize("name", REFERENCE)
def test_a_documented_name_explains_itself(name: str) -> None:
    found = resolved(name)
    if not (inspect.isclass(found) or inspect.isroutine(found)):
        assert name.rpartition(".")[2] in explained_constants(name), "no text below the constant"
        return
    assert found.__doc__
    assert not found.__doc__.startswith(f"{found.__name__}("), "a dataclass without a docstring"
    if inspect.isclass(found) and issubclass(found, Exception):
        return
    accepted = inspect.signature(found).parameters
    if all(one.kind is not inspect.Parameter.VAR_KEYWORD for one in accepted.values()):
        assert set(re.findall(r":param (\w+):", found.__doc__)) <= set(accepted)
    methods = vars(found) if inspect.isclass(found) else {}
    silent = [
        method
        for method, function in methods.items()
        if not method.startswith("_")
        and (inspect.isroutine(function) or isinstance(function, property))
        and not inspect.getdoc(getattr(found, method))
    ]
    assert silent == []


def explained_constants(name: str) -> set[str]:
    """Constants with a text below them, in the folder of a name's module."""
    module = importlib.import_module(name.rpartition(".")[0])
    names = set()
    for path in Path(inspect.getfile(module)).parent.glob("*.py"):
        body = ast.parse(path.read_text()).body
        for node, after in pairwise(body):
            text = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            if text and isinstance(node, ast.Assign | ast.AnnAssign):
                target = node.target if isinstance(node, ast.AnnAssign) else node.targets[0]
                names.add(ast.unparse(target))
    return names
