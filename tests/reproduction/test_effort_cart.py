"""The problem with a known optimum: its closed form, its environment, and what is learned on it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize
from stable_baselines3.common.evaluation import evaluate_policy

from reproduction.constraints import safe_command
from reproduction.constraints.effort_cart import (
    COST_LIMIT,
    HORIZON,
    EffortCartVecEnv,
    best_return,
)
from reproduction.program import main as reproduce
from saver_advisors.cli.measured import read_measurement
from saver_advisors.safe_baselines import ALGORITHMS

DOCS = Path(__file__).parents[2] / "docs"


def best_efforts(horizon: int = HORIZON, cost_limit: float = COST_LIMIT) -> np.ndarray:
    """The optimal efforts of the module's closed form."""
    left = np.arange(horizon, 0, -1)
    return left * np.sqrt(cost_limit / np.sum(left**2))


class Efforts:
    """Pushes as it is told, whatever it observes."""

    def __init__(self, efforts: np.ndarray) -> None:
        self.efforts = efforts

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        step = np.rint((1 - observation[:, 1]) * len(self.efforts)).astype(int)
        return self.efforts[step][:, None].astype(np.float32), None


@pytest.mark.parametrize(("horizon", "limit"), [(20, 4.0), (5, 1.0), (1, 0.5)])
def test_the_closed_form_is_the_numerical_optimum(horizon, limit):
    left = np.arange(horizon, 0, -1)
    found = minimize(
        lambda u: -(left @ u) / horizon,
        np.full(horizon, 0.1),
        bounds=[(-1, 1)] * horizon,
        constraints={"type": "ineq", "fun": lambda u: limit - u @ u},
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-10},
    )
    assert found.success
    np.testing.assert_allclose(found.x, best_efforts(horizon, limit), atol=1e-3)
    assert best_return(horizon, limit) == pytest.approx(-found.fun, rel=1e-5)


def test_the_environment_pays_and_charges_what_the_form_says():
    returned, cost = safe_command.evaluate(Efforts(best_efforts()), deterministic=True)
    assert cost == pytest.approx(COST_LIMIT, rel=1e-5)
    # Up to the mean of 2,000 starting speeds, which is felt in every step.
    assert returned == pytest.approx(best_return(), abs=4 * HORIZON * 0.2 / np.sqrt(3 * 2000))
    constant = Efforts(np.full(HORIZON, np.sqrt(COST_LIMIT / HORIZON)))
    worse, same_cost = safe_command.evaluate(constant, deterministic=True)
    assert same_cost == pytest.approx(COST_LIMIT, rel=1e-5)
    assert worse < 0.9 * best_return()


def test_episodes_end_for_good_and_are_reported():
    env = EffortCartVecEnv(4, horizon=3, seed=0)
    observation = env.reset()
    assert observation.shape == (4, 2)
    for step in range(3):
        observation, rewards, dones, infos = env.step(np.full((4, 1), 2.0))
        assert [info["cost"] for info in infos] == [1.0] * 4, "efforts are clipped to 1"
        assert dones.all() == (step == 2)
    assert infos[0]["TimeLimit.truncated"] is False
    assert infos[0]["terminal_observation"][1] == 0.0
    np.testing.assert_allclose(infos[1]["terminal_observation"][0], rewards[1])
    assert observation[0, 1] == 1.0
    mean, _ = evaluate_policy(Efforts(np.zeros(3)), EffortCartVecEnv(4, 3, 0), 8, warn=False)
    assert abs(mean) < 1.0


def test_the_closed_form_holds_for_the_limit():
    assert best_efforts().max() <= 1


def test_the_command_writes_a_file_and_a_table(tmp_path, capsys):
    figures, page = tmp_path / "safe.json", tmp_path / "page.md"
    page.write_text(f"before\n{safe_command.BEGIN}\nold\n{safe_command.END}\nafter\n")
    words = f"safe --algorithms cpo --seeds 3 --steps 4000 --json {figures}"
    # Four thousand steps, one rollout, are not enough, and the status says so.
    assert reproduce([*words.split(), "--table", str(page)]) == 1
    content = json.loads(figures.read_text())
    (row,) = content["rows"]
    assert (row["algorithm"], row["seed"], row["steps"]) == ("CPO", 3, 4000)
    assert row["share_of_optimum"] == pytest.approx(row["return"] / best_return())
    assert content["provenance"].keys() >= {"command", "commit", "versions", "machine"}
    text = page.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert f"| {row['cost']:.3f} |" in text
    assert "old" not in text
    capsys.readouterr()
    assert reproduce(["safe", "--from", str(figures)]) == 1
    assert capsys.readouterr().out.strip() in text


@pytest.mark.parametrize("text", ['{"rows": [', "[]", '{"kind": "speed"}'])
def test_a_file_that_is_no_measurement_is_named(text, tmp_path, capsys):
    path = tmp_path / "cut.json"
    path.write_text(text)
    assert reproduce(["safe", "--from", str(path)]) == 2
    assert str(path) in capsys.readouterr().err


def test_the_page_shows_the_file():
    """What the docs show was measured, and is what the file holds: nothing where there is none."""
    page, file = DOCS / "safe-baselines.md", DOCS / "results" / "safe.json"
    text = page.read_text()
    if not file.exists():
        assert not text.partition(safe_command.BEGIN)[2].partition(safe_command.END)[0].strip()
        return
    figures = read_measurement(file, "safe")
    assert safe_command.page_with(page, safe_command.render(figures)) == text
    assert safe_command.BEGIN in text
    assert {one["algorithm"] for one in figures["rows"]} == {
        algorithm.__name__ for algorithm in ALGORITHMS.values()
    }
    assert all(one["limit_met"] and one["near_optimum"] for one in figures["rows"])


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", safe_command.NAMES)
def test_each_meets_the_limit_near_the_optimum(name, seed):
    row = safe_command.one_run((name, seed, safe_command.STEPS[name]))
    assert row["cost"] <= COST_LIMIT
    assert 1 - safe_command.WITHIN <= row["share_of_optimum"] <= 1.0 + 1e-6
