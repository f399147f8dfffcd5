"""The notebooks say what their pages say, and run."""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path
from typing import Any

import pytest

from reproduction.pages.notebooks import EXCERPT, FOLDER, TUTORIALS, notebook

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
LARGEST = 50_000
"""Bytes of a notebook: it has no outputs."""

PAGE = """\
# A page

See [another](other.md#part), [the index](https://pypi.org) and [below](#end).

```bash
pip install 'saver-envs[train]'
```

```python title="mine.py"
x = 1
```

```bash
export PYTHONPATH=.
saver train --env X \\
  --output runs/x
saver evaluate --video film.mp4
saver curves runs/x --output plot.png
```

```yaml
a: 1
```

## End

```python title="from example.py"
y = 2
```

```python
print(x)
```
"""


def cells_of(text: str) -> list[tuple[str, str]]:
    return [(one["cell_type"], "".join(one["source"])) for one in json.loads(text)["cells"]]


def test_a_page_becomes_a_notebook(tmp_path: Path) -> None:
    (tmp_path / "examples").mkdir()
    (tmp_path / "examples" / "example.py").write_text("# whole\ny = 2\n")
    (tmp_path / "page.md").write_text(PAGE)
    assert cells_of(notebook(tmp_path / "page.md")) == [
        ("code", '%pip install --quiet "saver-envs[train]"'),
        (
            "markdown",
            "# A page\n\nSee [another](../other.md#part), [the index](https://pypi.org) "
            "and [below](#end).",
        ),
        ("code", "%%writefile mine.py\nx = 1"),
        (
            "code",
            "%env PYTHONPATH=.\n!saver train --env X \\\n  --output runs/x\n"
            "!saver evaluate --video film.mp4\n!saver curves runs/x --output plot.png",
        ),
        (
            "code",
            "from IPython.display import Image, Video, display\n\n"
            'display(Video("film.mp4", embed=True))\ndisplay(Image("plot.png"))',
        ),
        ("markdown", "```yaml\na: 1\n```"),
        ("markdown", "## End"),
        ("code", "%%writefile example.py\n# whole\ny = 2"),
        ("markdown", '```python title="from example.py"\ny = 2\n```'),
        ("code", "print(x)"),
    ]


@pytest.mark.parametrize("name", TUTORIALS)
def test_each_tutorial_links_its_small_notebook(name: str) -> None:
    file = DOCS / FOLDER / f"{name}.ipynb"
    assert file.stat().st_size < LARGEST
    assert f"]({FOLDER}/{name}.ipynb)" in (DOCS / f"{name}.md").read_text()


def test_excerpts_are_in_their_files() -> None:
    excerpts = [
        (file, code)
        for page in DOCS.rglob("*.md")
        for file, code in re.findall(
            rf'^```python title="{EXCERPT}([^"]+)"\n(.*?)^```', page.read_text(), re.M | re.S
        )
    ]
    assert excerpts
    for file, code in excerpts:
        lines = (DOCS / "examples" / file).read_text().splitlines()
        assert [line for line in code.splitlines() if line not in lines] == []


def short_program(folder: Path) -> Path:
    """Write a program `saver` that takes seconds, and return the file that lists what it did."""
    done = folder / "done"
    program = folder / "saver"
    program.write_text(
        f'#!/bin/sh\nPYTHONPATH="{ROOT}:$PYTHONPATH" "{sys.executable}" '
        f'"{ROOT}/tests/cli/short_saver.py" "$@"\n'
        f'status=$?\necho "$status $*" >> "{done}"\nexit $status\n'
    )
    program.chmod(0o755)
    return done


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if name == "your-own-task" else pytest.mark.long)
        for name in TUTORIALS
    ],
)
def test_notebooks_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nbformat: Any = pytest.importorskip("nbformat")
    nbclient: Any = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    programs, work = tmp_path / "programs", tmp_path / "work"
    programs.mkdir()
    work.mkdir()
    done = short_program(programs)
    monkeypatch.setenv("PATH", f"{programs}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    for variable in ("IPYTHONDIR", "JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR"):
        monkeypatch.setenv(variable, str(tmp_path / variable))

    book = nbformat.read(DOCS / FOLDER / f"{name}.ipynb", as_version=4)
    nbformat.validate(book)
    install = book.cells.pop(0)  # what is tested is installed
    assert install.source.startswith("%pip install")
    code = "\n".join(cell.source for cell in book.cells if cell.cell_type == "code")
    resources = {"metadata": {"path": str(work)}}
    nbclient.NotebookClient(book, timeout=900, resources=resources).execute()
    lines = done.read_text().splitlines()
    assert len(lines) == len(re.findall(r"^!saver ", code, re.MULTILINE)) > 1
    assert [line for line in lines if not line.startswith("0 ")] == []
