"""Make small faults in the code, one at a time, and count how many of them the tests notice.

    make mutants                                             # 200 mutants drawn by seed 0
    python tools/mutants.py --seed 1 --number 50 --json mutants.json

The faults are Cosmic Ray's: an operator, a comparison, a number, a condition or a loop is changed.
They are drawn evenly over the changeable places of `AREAS`. A mutant is killed when a test that
executes its lines fails; the tests are found by one run of `make test` under coverage, and those of
a mutant run cheapest first until one fails or `--limit` seconds are over. A mutant that differs in
nothing but annotations is not drawn; one that cannot differ in behaviour is listed with its reason
in `tools/equivalent_mutants.json` and left out of the share.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import difflib
import json
import os
import queue
import re
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names
from coverage import CoverageData
from tqdm import tqdm

from saver_advisors.reporting.provenance import provenance, write_json_atomic

ROOT = Path(__file__).resolve().parents[1]
EQUIVALENT = ROOT / "tools" / "equivalent_mutants.json"

#: What is mutated: where a silent fault would spoil results or safety.
AREAS = (
    "saver_envs/episodes.py",
    "saver_envs/simulation.py",
    "saver_envs/control.py",
    "saver_envs/tasks",
    "saver_envs/perception/parsing.py",
    "saver_envs/perception/estimator.py",
    "saver_advisors/advising",
    "saver_advisors/learner",
    "saver_advisors/variable_reward",
    "saver_advisors/evaluation",
    "saver_advisors/integration/safety.py",
    "saver_advisors/integration/control_stages.py",
    "saver_advisors/integration/wire.py",
)
#: Operators whose mutants any test would notice, since they raise where they stand: they would
#: only raise the share.
UNUSED_OPERATORS = re.compile(
    "RemoveDecorator|Variable|(Add|Sub|Mul|Div|FloorDiv|Mod|Pow)_(Bit|LShift|RShift)"
    "|Operator_(Eq|NotEq|Lt|LtE|Gt|GtE)_Is"
)


@dataclass
class Mutant:
    """One fault, and what came of it."""

    file: str
    line: int
    operator: str
    occurrence: int
    before: str
    after: str
    status: str = ""
    killed_by: str = ""
    tests: int = 0
    source: str = field(default="", repr=False)


def places(path: Path) -> dict[tuple[int, int], list[tuple[str, int]]]:
    """Changeable places of a file (line, column), each with the operators that apply there."""
    nodes = list(ast_nodes(get_ast(path.read_text())))
    found: dict[tuple[int, int], list[tuple[str, int]]] = defaultdict(list)
    for name in operator_names():
        if UNUSED_OPERATORS.search(name):
            continue
        operator = get_operator(name)()
        occurrence = 0
        for node in nodes:
            for start, _ in operator.mutation_positions(node):
                found[start].append((name, occurrence))
                occurrence += 1
    return found


def behaviour(source: str) -> str:
    """Return the source's syntax tree without docstrings and annotations."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.AnnAssign):
            node.annotation = ast.Constant(None)
        elif isinstance(node, ast.arg):
            node.annotation = None
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            node.returns = None
    return ast.dump(tree)


def mutant_at(path: Path, operator: str, occurrence: int) -> Mutant | None:
    """Return a mutant, or None where it is not Python or changes annotations only."""
    original = path.read_text()
    try:
        mutated = mutate_code(original, get_operator(operator)(), occurrence)
        if mutated is None or behaviour(mutated) == behaviour(original):
            return None
    except (SyntaxError, AttributeError):  # Cosmic Ray cannot replace `except module.Error`
        return None
    changed = list(difflib.ndiff(original.splitlines(), mutated.splitlines()))
    before = [line[2:].strip() for line in changed if line.startswith("- ")]
    after = [line[2:].strip() for line in changed if line.startswith("+ ")]
    pairs = zip(original.splitlines(), mutated.splitlines(), strict=False)
    return Mutant(
        file=str(path.relative_to(ROOT)),
        line=next(number for number, (old, new) in enumerate(pairs, 1) if old != new),
        operator=operator.removeprefix("core/"),
        occurrence=occurrence,
        before=" ".join(before),
        after=" ".join(after),
        source=mutated,
    )


def draw(number: int, seed: int) -> list[Mutant]:
    """Draw mutants, evenly over places, then over what can be done there."""
    generator = np.random.default_rng(seed)
    files = [
        path
        for area in AREAS
        for path in (
            sorted((ROOT / area).rglob("*.py")) if (ROOT / area).is_dir() else [ROOT / area]
        )
    ]
    everywhere = [
        (path, operators) for path in files for _, operators in sorted(places(path).items())
    ]
    drawn: list[Mutant] = []
    for index in generator.permutation(len(everywhere)):
        path, operators = everywhere[index]
        operator, occurrence = operators[generator.integers(len(operators))]
        if (mutant := mutant_at(path, operator, occurrence)) is not None:
            drawn.append(mutant)
        if len(drawn) == number:
            break
    return drawn


def pytest(tree: Path, *arguments: str, timeout: float | None = None) -> tuple[int | None, str]:
    """Run pytest in a tree; returns its exit status (None where it ran out of time) and output."""
    environment = os.environ | {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments]
    process = subprocess.Popen(
        command,
        cwd=tree,
        env=environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )
    try:
        output, _ = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, 9)
        output, _ = process.communicate()
        return None, output
    return process.returncode, output


@contextlib.contextmanager
def working_tree() -> Iterator[Path]:
    """Check the current commit out into a folder of its own, which is removed afterwards."""
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", str(tree), "HEAD"], check=True)
        try:
            yield tree
        finally:
            subprocess.run([*git, "remove", "--force", str(tree)], check=True)


class Coverage:
    """Which tests execute which lines, and how long each test takes."""

    def __init__(self, folder: Path) -> None:
        self.data = CoverageData(str(folder / "coverage"))
        self.data.read()
        some = next(one for one in self.data.measured_files() if one.endswith(AREAS[0]))
        #: Where the tests ran: the names of some contain it.
        self.tree = some.removesuffix(f"/{AREAS[0]}")
        self.seconds = {
            f"{case.get('classname')}.{case.get('name')}": float(case.get("time", 0))
            for case in ElementTree.parse(folder / "junit.xml").iter("testcase")
        }

    @classmethod
    def measure(cls, folder: Path, workers: int) -> Coverage:
        """Run `make test`'s tests under coverage, unless the folder has their outcome already.

        :raises SystemExit: where a test fails without any mutant.
        """
        if not (folder / "junit.xml").exists():
            folder.mkdir(parents=True, exist_ok=True)
            with working_tree() as tree:
                sources = ("--cov=saver_envs", "--cov=saver_advisors", "--cov-context=test")
                os.environ["COVERAGE_FILE"] = str(folder / "coverage")
                report = ("--cov-report=", f"--junit-xml={folder / 'partial.xml'}")
                status, output = pytest(
                    tree, "-n", str(workers), "-m", "not long", *sources, *report
                )
            if status:
                raise SystemExit(f"The tests fail without a mutant:\n{output[-4000:]}")
            (folder / "partial.xml").rename(folder / "junit.xml")
        return cls(folder)

    def tests_of(self, mutant: Mutant) -> list[str]:
        """Return the tests that execute a mutant, cheapest first.

        What is executed by an import alone, such as a default or a constant, is tested by what
        tests the function, class or module around it.
        """
        contexts = self.data.contexts_by_lineno(f"{self.tree}/{mutant.file}")
        for lines in _surroundings(ROOT / mutant.file, mutant.line):
            told = {one for line in lines for one in contexts.get(line, []) if one}
            if told:
                tests = {one.rpartition("|")[0] for one in told}
                return sorted(tests, key=lambda one: (self.seconds.get(_junit_name(one), 0.0), one))
        return []


def _junit_name(test: str) -> str:
    file, _, rest = test.partition("::")
    return f"{file.removesuffix('.py').replace('/', '.')}.{rest.replace('::', '.')}"


def _surroundings(path: Path, line: int) -> Iterator[range]:
    """Yield the lines of the statements around a line, from the innermost to the whole file."""
    text = path.read_text()
    around = [
        range(node.lineno, (node.end_lineno or line) + 1)
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.stmt) and node.lineno <= line <= (node.end_lineno or line)
    ]
    yield range(line, line + 1)
    yield from sorted(around, key=len)
    yield range(1, len(text.splitlines()) + 1)


def judge(mutant: Mutant, coverage: Coverage, tree: Path, limit: float) -> None:
    """Run the cheapest tests of a mutant, as many as take `limit` seconds, and note the outcome."""
    tests = coverage.tests_of(mutant)
    spent = np.cumsum([coverage.seconds.get(_junit_name(test), 0.0) for test in tests])
    tests = tests[: max(1, int(np.searchsorted(spent, limit)))]
    mutant.tests = len(tests)
    if not tests:
        mutant.status = "not executed"
        return
    file = tree / mutant.file
    original = file.read_text()
    file.write_text(mutant.source)
    listed = tree / ".mutant-tests"
    listed.write_text("\n".join(test.replace(coverage.tree, str(tree)) for test in tests))
    # A fault that hangs is noticed: nobody waits for it.
    status, output = pytest(tree, "-x", f"@{listed}", timeout=3 * limit + 60)
    file.write_text(original)
    if status not in (0, 1, None) and pytest(tree, "--collect-only", f"@{listed}")[0]:
        raise SystemExit(f"pytest does not find the tests of {mutant}:\n{output[-2000:]}")
    failed = [line for line in output.splitlines() if line.startswith(("FAILED", "ERROR"))]
    mutant.status = "survived" if status == 0 else "killed"
    mutant.killed_by = "out of time" if status is None else failed[0][:200] if failed else ""


def judge_all(
    mutants: Sequence[Mutant], coverage: Coverage, workers: int, limit: float
) -> Iterator[Mutant]:
    """Judge mutants in as many working trees as there are workers, as they are done."""
    trees: queue.SimpleQueue[Path] = queue.SimpleQueue()

    def one(mutant: Mutant) -> Mutant:
        tree = trees.get()
        try:
            judge(mutant, coverage, tree, limit)
        finally:
            trees.put(tree)
        return mutant

    with contextlib.ExitStack() as stack:
        for _ in range(workers):
            trees.put(stack.enter_context(working_tree()))
        pool = stack.enter_context(ThreadPoolExecutor(workers))
        yield from pool.map(one, mutants)


def equivalents() -> set[tuple[str, str, str]]:
    """Return the mutants listed as unable to differ in behaviour: file, line before, line after."""
    rows = json.loads(EQUIVALENT.read_text())
    return {(row["file"], row["before"], row["after"]) for row in rows}


def keep_killed(drawn: Sequence[Mutant], rows: Sequence[dict[str, Any]]) -> None:
    """Keep what an earlier run killed: tests that were added since cannot revive it."""
    before = {(row["file"], row["before"], row["after"]): row for row in rows}
    for mutant in drawn:
        row = before.get((mutant.file, mutant.before, mutant.after), {})
        if mutant.status == "" and row.get("status") == "killed":
            mutant.status, mutant.tests = "killed", row["tests"]
            mutant.killed_by = row["killed_by"]


def main() -> None:
    """Draw mutants, run their tests, print those that survive and write them all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--number", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit", type=float, default=150.0, help="seconds of tests a mutant")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--coverage", type=Path, required=True, help="folder of the coverage run")
    parser.add_argument("--json", type=Path, help="written; mutants.json in that folder by default")
    parser.add_argument(
        "--again", action="store_true", help="judge only what --json does not say is killed"
    )
    options = parser.parse_args()
    listed = equivalents()
    drawn = draw(options.number, options.seed)
    equal = [mutant for mutant in drawn if (mutant.file, mutant.before, mutant.after) in listed]
    for mutant in equal:
        mutant.status = "equivalent"
    file = options.json or options.coverage / "mutants.json"
    if options.again:
        keep_killed(drawn, json.loads(file.read_text())["mutants"])
    rest = [mutant for mutant in drawn if mutant.status == ""]
    coverage = Coverage.measure(options.coverage.resolve(), options.workers)
    with tqdm(total=len(rest)) as bar:
        for mutant in judge_all(rest, coverage, options.workers, options.limit):
            bar.update()
            if mutant.status != "killed":
                bar.write(f"{mutant.status}: {mutant.file}:{mutant.line} {mutant.operator}")
                bar.write(f"  - {mutant.before}\n  + {mutant.after}")
    killed = sum(mutant.status == "killed" for mutant in drawn)
    judged = len(drawn) - len(equal)
    print(f"{killed} of {judged} killed ({killed / judged:.3f}), {len(equal)} equivalent")
    rows = [{k: v for k, v in asdict(mutant).items() if k != "source"} for mutant in drawn]
    settings = {name: getattr(options, name) for name in ("number", "seed", "limit")}
    found = {"killed": killed, "judged": judged, "equivalent": len(equal), "mutants": rows}
    write_json_atomic(file, {"settings": settings, **found, "provenance": provenance()})


if __name__ == "__main__":
    main()
