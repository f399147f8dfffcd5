"""The worked example of docs/integration.md runs, and the page names stages and topics rightly."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from saver_advisors.integration.assembly import OUTPUTS, LoopSettings

PAGE = Path(__file__).resolve().parents[2] / "docs" / "integration.md"


def test_the_page_has_every_stage_and_its_topic() -> None:
    rows = [
        [cell.strip() for cell in line.strip("| \n").split("|")]
        for line in PAGE.read_text(encoding="utf-8").splitlines()
        if line.startswith("|")
    ]
    told = {row[0]: row[2].strip("`") for row in rows if row[2].startswith("`")}
    assert set(told) == set(LoopSettings().order)
    assert {name: told[name] for name in OUTPUTS} == OUTPUTS


@pytest.mark.slow
def test_a_replaced_stage_runs(capsys: pytest.CaptureFixture[str]) -> None:
    text = PAGE.read_text(encoding="utf-8")
    example = re.findall(r"^```python\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)[-1]
    exec(compile(example, str(PAGE), "exec"), {})
    assert "failed in reaching" in capsys.readouterr().out
