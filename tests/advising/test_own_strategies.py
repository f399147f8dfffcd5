"""Strategies of one's own, by name and by "module:Class"."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_advisor import observation, students
from toy_arms import make_teacher
from toy_runs import BLOCK, advisor_state, assert_resumes_exactly, save_teacher, settings

from saver_advisors.advising import STRATEGIES, make_advisor, make_strategy, register_strategy


class EveryNth:
    """Advises every n-th step, and remembers how many there were."""

    name = "every-nth"
    needs_critics = False

    def __init__(self, n: int = 2) -> None:
        self.settings = {"n": n}
        self.seen = 0
        self.begun: list[Any] = []

    def begin(self, run: Any, budget: Any) -> None:
        self.begun.append((run.total_steps, run.horizon, run.seed, budget.total))

    def decide(self, context: Any) -> Any:
        self.seen += 1
        return np.full(context.shape, self.seen % self.settings["n"] == 0)

    def state_dict(self) -> dict[str, int]:
        return {"seen": self.seen}

    def load_state_dict(self, state: Any) -> None:
        self.seen = state["seen"]


@pytest.fixture(autouse=True)
def _registry() -> Iterator[None]:
    before = dict(STRATEGIES)
    yield
    STRATEGIES.clear()
    STRATEGIES.update(before)


def test_a_registered_strategy_goes_by_its_name() -> None:
    assert register_strategy(EveryNth) is EveryNth
    assert register_strategy(EveryNth) is EveryNth, "a module may be imported again"
    made = make_strategy("every-nth", settings={"n": 3})
    assert isinstance(made, EveryNth)
    assert made.settings == {"n": 3}
    with pytest.raises(ValueError, match="'every-nth' takes no m=3; its settings are n"):
        make_strategy("every-nth", settings={"m": 3})
    with pytest.raises(ValueError, match="'every-nth' takes no threshold"):
        make_strategy("every-nth", 0.1)


class AnySettings(EveryNth):
    def __init__(self, **settings: Any) -> None:
        super().__init__()
        self.settings = settings


def test_settings_are_checked_unless_the_class_takes_any(monkeypatch: pytest.MonkeyPatch) -> None:
    for one in (AnySettings, EveryNth):
        monkeypatch.setitem(STRATEGIES, one.__name__, one)
    assert make_strategy("AnySettings", settings={"pace": 3}).settings == {"pace": 3}
    with pytest.raises(ValueError, match="takes no pace=3; its settings are n"):
        make_strategy("EveryNth", settings={"pace": 3})


def test_a_name_belongs_to_one() -> None:
    class Early:
        name = "early"

        def decide(self, context: Any) -> Any:
            return np.ones(context.shape, bool)

    with pytest.raises(ValueError, match=r"'early' of Early belongs to EarlyAdvising already"):
        register_strategy(Early)  # type: ignore[type-var]
    with pytest.raises(TypeError, match="must be a class"):
        register_strategy(Early())  # type: ignore[type-var]


def test_what_a_class_lacks_is_named() -> None:
    class Nameless:
        def decide(self, context: Any) -> Any:
            return np.ones(context.shape, bool)

    with pytest.raises(TypeError, match="lacks name: a strategy has name, needs_critics, set"):
        register_strategy(Nameless)  # type: ignore[type-var]

    class Careless(Nameless):
        name = "careless"

    register_strategy(Careless)  # type: ignore[type-var]
    with pytest.raises(TypeError, match="lacks needs_critics, settings"):
        make_strategy("careless")


def test_a_run_takes_a_class_by_its_module_and_resumes(tmp_path: Path) -> None:
    advice = {
        "strategy": f"{__name__}:EveryNth",
        "teacher": save_teacher(tmp_path),
        "budget": 3 * BLOCK,
        "settings": {"n": 3},
    }
    assert_resumes_exactly(settings(advice), tmp_path)
    state = advisor_state(tmp_path / "parts")
    assert (state["strategy"], state["settings"]) == ("every-nth", {"n": 3})
    assert state["strategy_state"] == {"seen": 60}
    assert state["budget"]["spent"] == 20 * 4


def test_it_is_told_of_the_run_once() -> None:
    strategy = EveryNth()
    make_advisor(strategy, make_teacher(), 5, n_arms=2, total_steps=100, horizon=10, seed=7)
    assert strategy.begun == [(100, 10, 7, 5)]


@pytest.mark.parametrize("decision", [np.ones(2, bool), np.ones((2, 2)), np.ones((2, 3), bool)])
def test_a_decision_of_another_shape_or_kind_is_refused(decision: Any) -> None:
    class Wrong(EveryNth):
        name = "wrong"

        def decide(self, context: Any) -> Any:
            return decision

    advisor = make_advisor(Wrong(), make_teacher(), 10, n_arms=2)
    with pytest.raises(ValueError, match=r"'wrong' decided .*\(n_envs, n_arms\) = \(2, 2\)"):
        advisor.advise(observation(2), students(2))
