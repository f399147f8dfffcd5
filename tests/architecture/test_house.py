"""The rules of docs/architecture.md that can be read off the source."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))

from house import TASK_MODULES, House  # noqa: E402  (after the path is set)


@pytest.fixture(scope="module")
def house() -> House:
    return House(ROOT)


def test_imports_go_one_way(house: House) -> None:
    """Rule 1: reproduction -> saver_advisors -> saver_envs, inside a package downwards."""
    assert house.upward() == []


def test_no_imports_in_circles(house: House) -> None:
    """Rule 1: neither between modules nor between sub-packages, deferred imports included."""
    assert house.circles() == []


def test_no_module_outside_tasks_knows_a_task(house: House) -> None:
    """Rule 2: no class, no name, no flag."""
    assert house.knows("tasks", TASK_MODULES) == []


def test_public_class_names_are_unique(house: House) -> None:
    """Rule 8."""
    assert house.twice() == {}


def test_file_names_say_what_is_in_them(house: House) -> None:
    """Rule 8."""
    assert house.vague() == []


def test_the_check_sees_what_it_should(tmp_path: Path) -> None:
    """Each rule fails on a tree that breaks it."""
    files = {
        "saver_envs/tasks/push.py": (
            "from saver_envs.episodes import Episodes\nclass Push:\n    name: str = 'push'\n"
        ),
        "saver_envs/episodes.py": (
            "from saver_envs.tasks.push import Push\n"
            "def f(x):\n    import saver_advisors.cli\n    return isinstance(x, Push)\n"
        ),
        "saver_envs/registration.py": "ROWS = ('JacoPush',)\n",
        "saver_advisors/cli.py": "ENV = 'JacoPush-v0'\nclass Push:\n    pass\n",
        "saver_advisors/command.py": "",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    broken = House(tmp_path)
    assert ["saver_envs.episodes", "saver_envs.tasks.push"] in broken.circles()
    assert "saver_envs.episodes -> saver_advisors.cli" in broken.upward()
    known = "\n".join(broken.knows("tasks", TASK_MODULES))
    for text in ("episodes:1 imports", "episodes:4 names Push", "cli:1 names 'JacoPush-v0'"):
        assert text in known
    assert list(broken.twice()) == ["Push"]
    assert broken.vague() == ["saver_advisors/command.py"]
