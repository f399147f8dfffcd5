"""A reader who follows a tutorial line by line, from an empty environment."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest
from follow_tutorial import TutorialError, follow, main, steps_of
from fresh_install import ROOT

PAGE = """\
# Page

```bash
export WORD=hello
echo $WORD \\
  again > said.txt
```

```python
import os

print(sum(range(5_000_000)), file=open("sum.txt", "w"))
assert os.environ["WORD"] == "hello"
```

```yaml
not: code
```

## The end of it

```bash
false
```
"""


def test_steps() -> None:
    steps = steps_of(PAGE, "end of it")
    assert [language for language, _ in steps] == ["bash", "bash", "python"]
    assert steps[1] == ("bash", "echo $WORD    again > said.txt")
    assert len(steps_of(PAGE)) == 4
    with pytest.raises(ValueError, match="until='nowhere'"):
        steps_of(PAGE, "nowhere")
    with pytest.raises(ValueError, match="no code"):
        steps_of("# Page\n")


def python_of_this_test() -> dict[str, str]:
    folder = Path(sys.executable).parent
    return {**os.environ, "PATH": f"{folder}{os.pathsep}{os.environ['PATH']}"}


def test_lines_share_a_shell_and_are_timed(tmp_path: Path) -> None:
    done = follow(steps_of(PAGE, "end of it"), tmp_path, variables=python_of_this_test())
    assert (tmp_path / "said.txt").read_text() == "hello again\n"
    assert (tmp_path / "sum.txt").read_text() == "12499997500000\n"
    export, _, block = done
    assert export.text == "export WORD=hello"
    assert block.processor_seconds >= 0.1 > export.processor_seconds


def test_a_line_that_fails_is_named(tmp_path: Path) -> None:
    with pytest.raises(TutorialError, match="status 1: false"):
        follow(steps_of(PAGE), tmp_path, variables=python_of_this_test())
    bad = [("python", "print(1)\nraise SystemExit(3)\n"), ("bash", "touch later")]
    with pytest.raises(TutorialError, match="status 3: print"):
        follow(bad, tmp_path, variables=python_of_this_test())
    assert not (tmp_path / "later").exists()


def test_the_wheel_takes_the_place_of_the_package(tmp_path: Path) -> None:
    install, other = "echo pip install 'saver-envs[train]' > said", "echo saver-envs >> said"
    done = follow([("bash", install), ("bash", other)], tmp_path, tmp_path / "saver.whl")
    said = (tmp_path / "said").read_text()
    assert said == f"pip install {tmp_path}/saver.whl[train]\nsaver-envs\n"
    assert done[0].text == install  # as the page has it


@pytest.mark.long
def test_a_first_policy_from_an_empty_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Ten minutes or so on two free cores; how many is printed."""
    record = tmp_path / "minutes.json"
    page = ROOT / "docs" / "first-policy.md"
    words = ["follow_tutorial", str(page), "--until", "Two arms", "--json", str(record)]
    monkeypatch.setattr(sys, "argv", words)
    assert main() == 0
    said = capfd.readouterr().out
    assert "minutes by the clock" in said
    steps = [step["text"] for step in json.loads(record.read_text())["steps"]]
    assert any("--video first.mp4" in step for step in steps)
