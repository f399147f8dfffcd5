"""Count lines and check the rules of docs/architecture.md: `python tools/house.py [ROOT]`.

It reads the source only, imports nothing of it, and works on any checkout, so that two commits can
be compared. `tests/architecture/` asserts what it finds.
"""

from __future__ import annotations

import ast
import json
import sys
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

#: Packages, from what is imported to what imports.
PACKAGES = ("saver_envs", "saver_advisors", "reproduction")
#: Sub-packages and modules in their order, lowest first; an import goes from a later row to an
#: earlier one. Modules of one row may not import each other's.
LAYERS: dict[str, tuple[str, ...]] = {
    "saver_envs": (
        "files validation",
        "weights",
        "robots",
        "world",
        "scenes",
        "simulation",
        "control",
        "reachability",
        "randomization",
        "cameras",
        "people",
        "tasks",
        "sensor_errors",
        "worlds",
        "episodes",
        "registration",
        "digest",
        "experts modelling perception",
        "envs",
        "wrappers",
    ),
    "saver_advisors": (
        "evaluation",
        "reporting",
        "learner",
        "policies",
        "pretrained",
        "advising",
        "safe_baselines",
        "variable_reward",
        "training",
        "datasets experiments zoo",
        "benchmark integration viewing",
        "cli",
    ),
    "reproduction": (
        "program findings command_parts page_templates",
        "advising constraints ecosystem joint_speeds learning modelling transfer warp_models "
        "wrist_push",
        "pages",
    ),
}
#: Where a task may be named.
TASK_MODULES = ("saver_envs.tasks", "saver_envs.experts", "saver_envs.registration")
ROBOT_MODULES = (
    "saver_envs.robots",
    "saver_envs.experts",
    "saver_envs.registration",
    "saver_envs.modelling.arms",
)
#: Names of files that do not say what is in them.
VAGUE_FILES = ("command.py", "page.py", "report.py")


@dataclass(frozen=True)
class House:
    """The source of a checkout.

    :param root: its top folder
    """

    root: Path
    trees: dict[str, ast.Module] = field(default_factory=dict)

    @cached_property
    def files(self) -> dict[str, Path]:
        """Module -> file, of all packages."""
        found = {}
        for package in PACKAGES:
            for path in sorted((self.root / package).rglob("*.py")):
                parts = list(path.relative_to(self.root).with_suffix("").parts)
                if parts[-1] == "__init__":
                    parts.pop()
                found[".".join(parts)] = path
        return found

    def tree(self, module: str) -> ast.Module:
        """The parsed source of a module."""
        if module not in self.trees:
            self.trees[module] = ast.parse(self.files[module].read_text(encoding="utf-8"))
        return self.trees[module]

    @cached_property
    def imports(self) -> dict[str, set[str]]:
        """Module -> the modules of ours that it imports, deferred imports included."""
        return {module: set(self._imported(module)) - {module} for module in self.files}

    def _imported(self, module: str) -> Iterator[str]:
        for node in ast.walk(self.tree(module)):
            names: list[str] = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                for alias in node.names:
                    whole = f"{node.module}.{alias.name}"
                    names.append(whole if whole in self.files else node.module)
            yield from (name for name in names if name in self.files)

    def code_lines(self) -> dict[str, int]:
        """Package -> lines that hold code: no docstrings, comments or blanks."""
        counted: Counter[str] = Counter(dict.fromkeys(PACKAGES, 0))
        for module, path in self.files.items():
            counted[module.split(".")[0]] += len(_lines_of_code(path, self.tree(module)))
        return dict(counted)

    def circles(self) -> list[list[str]]:
        """Modules, and sub-packages, that import one another in a circle."""
        by_package: dict[str, set[str]] = defaultdict(set)
        for module, imported in self.imports.items():
            for other in imported:
                if _part(other) != _part(module):
                    by_package[_part(module)].add(_part(other))
        return [*_circles(self.imports), *_circles(by_package)]

    def upward(self) -> list[str]:
        """Imports against the order of packages and layers."""
        found = []
        for module, imported in self.imports.items():
            for other in imported:
                packages = module.split(".")[0], other.split(".")[0]
                if packages[0] != packages[1]:
                    if PACKAGES.index(packages[0]) < PACKAGES.index(packages[1]):
                        found.append(f"{module} -> {other}")
                elif _part(module) != _part(other) and _layer(module) <= _layer(other):
                    found.append(f"{module} -> {other}")
        return sorted(found)

    def knows(self, kind: str, allowed: tuple[str, ...]) -> list[str]:
        """Installed modules outside ``allowed`` that name a task (or a robot), or ask which it is.

        :param kind: ``tasks`` or ``robots``
        :param allowed: the modules that may, with everything below them
        """
        classes, names = self._named(kind)
        ids = {name for name in names if name.endswith("-v0")}
        found = []
        for module in self.files:
            if module.startswith((*allowed, "reproduction")):
                continue
            for node in _without_docstrings(self.tree(module)):
                text = None
                if isinstance(node, ast.ImportFrom) and node.module in classes.values():
                    text = f"imports {node.module}"
                elif isinstance(node, ast.Name) and node.id in classes:
                    text = f"names {node.id}"
                elif isinstance(node, ast.Constant) and node.value in (ids or names):
                    text = f"names {node.value!r}"
                elif isinstance(node, ast.Attribute) and node.attr == "moves_person":
                    text = "asks moves_person"
                if text:
                    found.append(f"{module}:{node.lineno} {text}")
        return sorted(set(found))

    def _named(self, kind: str) -> tuple[dict[str, str], set[str]]:
        """Classes or constants that describe one task or robot -> their module; names, and ids."""
        classes: dict[str, str] = {}
        names: set[str] = set()
        for module in self.files:
            if not module.startswith(f"saver_envs.{kind}."):
                continue
            for node in self.tree(module).body:
                if isinstance(node, ast.ClassDef):
                    found = _class_constant(node, "name")
                    if found:
                        classes[node.name] = module
                        names.add(found)
                elif isinstance(node, ast.Assign) and isinstance(node.value, ast.Call):
                    for keyword in node.value.keywords:
                        if keyword.arg == "name" and isinstance(keyword.value, ast.Constant):
                            target = node.targets[0]
                            if isinstance(target, ast.Name) and target.id.isupper():
                                classes[target.id] = module
                                names.add(str(keyword.value.value))
        if kind == "tasks":
            names |= set(_ids(self.tree("saver_envs.registration")))
        return classes, names

    def twice(self) -> dict[str, list[str]]:
        """Public class names that two modules define."""
        where: dict[str, list[str]] = defaultdict(list)
        for module in self.files:
            for node in self.tree(module).body:
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    where[node.name].append(module)
        return {name: modules for name, modules in where.items() if len(modules) > 1}

    def vague(self) -> list[str]:
        """Files whose names do not say what is in them."""
        return [
            str(path.relative_to(self.root))
            for path in self.files.values()
            if path.name in VAGUE_FILES
        ]


def _part(module: str) -> str:
    """``saver_envs.tasks`` of ``saver_envs.tasks.push``."""
    return ".".join(module.split(".")[:2])


def _layer(module: str) -> float:
    package, _, rest = module.partition(".")
    part = rest.split(".")[0]
    for index, row in enumerate(LAYERS[package]):
        if part in row.split():
            return index
    return float("inf")  # the package itself, which imports what it offers


def _lines_of_code(path: Path, tree: ast.Module) -> set[int]:
    quiet = {
        tokenize.COMMENT,
        tokenize.NL,
        tokenize.NEWLINE,
        tokenize.INDENT,
        tokenize.DEDENT,
        tokenize.ENCODING,
        tokenize.ENDMARKER,
    }
    lines: set[int] = set()
    with path.open("rb") as file:
        for token in tokenize.tokenize(file.readline):
            if token.type not in quiet:
                lines.update(range(token.start[0], token.end[0] + 1))
    for node in _docstrings(tree):
        lines -= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return lines


def _docstrings(tree: ast.Module) -> Iterator[ast.Expr]:
    """Texts that stand alone: docstrings of modules, classes, functions and constants."""
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            yield node


def _without_docstrings(tree: ast.Module) -> Iterator[ast.AST]:
    hidden = {id(node.value) for node in _docstrings(tree)}
    return (node for node in ast.walk(tree) if id(node) not in hidden)


def _class_constant(node: ast.ClassDef, name: str) -> str | None:
    for statement in node.body:
        if (
            isinstance(statement, ast.AnnAssign)
            and isinstance(statement.target, ast.Name)
            and statement.target.id == name
            and isinstance(statement.value, ast.Constant)
        ):
            return str(statement.value.value)
    return None


def _ids(tree: ast.Module) -> Iterator[str]:
    """Ids as the table of rows names them, with and without a version."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            text = node.value
            if text.endswith(("Push", "PickAndPlace", "Distance", "Pixels")) and text[0].isupper():
                yield text
                yield f"{text}-v0"


def _circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Strongly connected components with more than one node (Tarjan's algorithm)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in graph.get(node, ()):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            cut = stack.index(node)
            component = sorted(stack[cut:])
            del stack[cut:]
            if len(component) > 1:
                found.append(component)

    for node in list(graph):
        if node not in index:
            visit(node)
    return found


def main() -> None:
    """Print what was counted as JSON."""
    root = Path(sys.argv[1] if len(sys.argv) > 1 else ".").resolve()
    house = House(root)
    lines = house.code_lines()
    found = {
        "code_lines": lines,
        "installed": lines["saver_envs"] + lines["saver_advisors"],
        "all": sum(lines.values()),
        "circles": house.circles(),
        "upward": house.upward(),
        "know_a_task": house.knows("tasks", TASK_MODULES),
        "know_a_robot": house.knows("robots", ROBOT_MODULES),
        "defined_twice": house.twice(),
        "vague_files": house.vague(),
    }
    print(json.dumps(found, indent=1))
    counts = {name: len(value) for name, value in found.items() if not isinstance(value, int)}
    print(json.dumps({key: counts[key] for key in counts if key != "code_lines"}), file=sys.stderr)


if __name__ == "__main__":
    main()
