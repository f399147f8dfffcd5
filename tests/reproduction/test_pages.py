"""The generated pages are complete, and are noticed when they are out of date."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from reproduction.pages.worlds import DRAWS, world_pictures
from reproduction.program import main as reproduce
from saver_envs.randomization.parameters import COMMON
from saver_envs.registration import ENVIRONMENTS
from saver_envs.sensor_errors import SENSORS

ROOT = Path(__file__).resolve().parents[2]


def test_docs_are_complete_and_noticed_when_stale(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    docs, readme = tmp_path / "docs", tmp_path / "README.md"
    readme.write_text(
        "Table:\n<!-- envs:begin -->\nold\n<!-- envs:end -->\n"
        "Success:\n<!-- success:begin -->\nold\n<!-- success:end -->\nrest\n"
    )
    (docs / "results").mkdir(parents=True)
    (docs / "results" / "speed.json").write_text('{"rows": [{"env": "X", "n_envs": 4}]}')
    for policy, rate in (("dual-jaco-push", 0.9), ("side-by-side:jaco-push", 0.7), ("my.zip", 1.0)):
        figures = {"env": "DualJacoPush-v0", "policy": policy, "success_rate": rate}
        figures |= {"ci95": [rate, 1], "episodes": 9, "final_distance_mean": [0.1, 0.1]}
        file = docs / "results" / f"{policy[:4]}.json"
        file.write_text(json.dumps({**figures, "seed": 0, "cost_means": {}}))
    assert reproduce(["pages", "--output", str(docs), "--check"]) == 1
    assert not (docs / "environments").exists()
    assert reproduce(["pages", "--output", str(docs), "--no-pictures"]) == 0
    assert reproduce(["pages", "--output", str(docs), "--check"]) == 0
    text = readme.read_text()
    assert text.startswith("Table:\n<!-- envs:begin -->\n| id |")
    assert text.endswith("<!-- success:end -->\nrest\n")
    assert "old" not in text
    # The shipped policy stands beside its teachers, and nobody else's does.
    assert (
        "| `dual-jaco-push` | 0.900 [0.900, 1.000] of 9 | 0.700 [0.700, 1.000] of 9 | - |" in text
    )
    assert "my.zip" not in text
    for name in ENVIRONMENTS:
        page = (docs / "environments" / f"{name.replace('Dense', '')}.md").read_text()
        assert f"`{name}`" in page or f"# {name}\n" in page
    worlds = (docs / "worlds.md").read_text()
    for row in ENVIRONMENTS.values():
        for parameter in (*row.task.parameters, *COMMON):
            assert f"| `{parameter.name}` | {parameter.text}" in worlds
    for sensor in SENSORS:
        assert f"| {sensor.part} |" in worlds
    assert "| 0.05 to 0.8, log | 0.126 to 0.317, log | 0.8 to 1.2 |" in worlds
    assert "| X | 4 |" in (docs / "results.md").read_text()
    page = docs / "environments" / "JacoPush-v0.md"
    page.write_text(page.read_text().replace("5 cm", "6 cm"))
    assert reproduce(["pages", "--output", str(docs), "--check"]) == 1
    assert "JacoPush-v0.md" in capsys.readouterr().err


def test_the_pages_of_this_repository_are_up_to_date(capsys: pytest.CaptureFixture[str]) -> None:
    status = reproduce(["pages", "--output", str(ROOT / "docs"), "--check"])
    assert status == 0, capsys.readouterr().err


def test_the_pictures_of_worlds_differ() -> None:
    strip = world_pictures("JacoPush-v0")
    height, width, _ = strip.shape
    pictures = strip.reshape(2, height // 2, DRAWS // 2, width // (DRAWS // 2), 3).swapaxes(1, 2)
    shown = pictures.reshape(DRAWS, -1)
    assert len({picture.tobytes() for picture in shown}) == DRAWS
    # It is the same scene from nearly the same place.
    assert (abs(shown.astype(int) - shown.mean(axis=0)).mean(axis=1) < 40).all()
