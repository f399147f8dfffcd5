"""Whichever way a policy is trained, its episodes start from training seeds alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from gymnasium.utils import seeding
from tiny_runs import TINY_RUN, write_settings

from saver_advisors.cli import main
from saver_advisors.evaluation.protocol import (
    MAX_RUN_SEED,
    REPORT_EPISODES,
    REPORT_SEED,
    SELECTION_SEEDS,
    TRAINING_SEED,
    training_seed,
)
from saver_advisors.experiments import worker
from saver_advisors.experiments.grid import ExperimentRun
from saver_advisors.training.launch import train
from saver_advisors.training.settings import AdviceConfig, RunConfig
from saver_envs.episodes import Episodes

SEED = 3
CONFIG = replace(TINY_RUN, seed=SEED, total_steps=60, eval_episodes=3, checkpoint_every=40)
Way = Callable[[Path], Any]


def state_of(generator: Any) -> int:
    """What an episode is drawn from."""
    return int(generator.bit_generator.state["state"]["state"])


def states_of(seeds: Any) -> set[int]:
    return {state_of(seeding.np_random(seed)[0]) for seed in seeds}


SELECTION = states_of(SELECTION_SEEDS)
REPORT = states_of(range(REPORT_SEED, REPORT_SEED + REPORT_EPISODES))


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Episodes, list[int]]]:
    """The state of the generator at every start, for each batch of episodes."""
    torch.set_num_threads(1)
    found: list[tuple[Episodes, list[int]]] = []
    begin = Episodes._begin

    def keep(self: Episodes, rows: Any) -> Any:
        states = next((states for one, states in found if one is self), None)
        if states is None:
            found.append((self, states := []))
        states += [state_of(self._generators[row]) for row in rows]
        return begin(self, rows)

    monkeypatch.setattr(Episodes, "_begin", keep)
    return found


def run(folder: Path, **changes: Any) -> None:
    train(replace(CONFIG, **changes), folder, progress=False)


def demonstrations(folder: Path) -> None:
    advice = AdviceConfig("none", "jaco-push", 40, demonstration_steps=40, cloning_updates=2)
    run(folder, advice=advice)


def resumed(folder: Path) -> None:
    train(CONFIG, folder, progress=False, stop_after_steps=20)
    train(CONFIG, folder, progress=False, resume=True)


def command(folder: Path) -> None:
    path = folder / "run.yml"
    write_settings(CONFIG, path)
    words = ["train", "--config", path, "--output", folder / "run", "--no-progress"]
    assert main([str(word) for word in words]) == 0


def grid(folder: Path) -> None:
    one = ExperimentRun("one", "push", "none", CONFIG, final_episodes=3)
    assert worker.execute(one, folder / "run", folder / "one.json") == worker.DONE


OFF_POLICY = ("learning_starts=20", "batch_size=16", "buffer_size=400")


def zoo(*more: str, algorithm: str = "td3", settings: tuple[str, ...] = OFF_POLICY) -> Way:
    def way(folder: Path) -> None:
        words = ["train", "--zoo", algorithm, "--env", "JacoPush-v0", "--output", str(folder)]
        words += ["--steps", "60", "--seed", str(SEED), "--env-kwargs", "max_episode_steps=10"]
        words += ["--set", "n_envs=2", "policy_kwargs.net_arch=[8]", *settings, "--", "--eval-freq"]
        assert main([*words, "20", "--eval-episodes", "5", "--n-eval-envs", "2", *more]) == 0

    return way


def third_party(algorithm: str, *more: str) -> Way:
    def way(folder: Path) -> None:
        words = ["benchmark", "run", "--env", "JacoPush-v0", "--algo", algorithm, "--steps", "60"]
        words += ["--seed", str(SEED), "--n-envs", "2", "--eval-every", "20", "--eval-episodes"]
        words += ["3", "--report-episodes", "3", "--env-kwargs", "max_episode_steps=10"]
        assert main([*words, "--output", str(folder), *more]) == 0

    return way


DRIFTER = f"{Path(__file__).parents[1] / 'benchmarks' / 'algorithms.py'}:Drifter"
WAYS: dict[str, Way] = {
    "saver train": command,
    "resumed": resumed,
    "demonstrations": demonstrations,
    "easier starts": lambda folder: run(folder, train_env_kwargs={"object_mass": 0.2}),
    "grid": grid,
    "RL Zoo": zoo(),
    "RL Zoo, single environments": zoo("--vec-env", "dummy"),
    "RL Zoo, normalised": zoo(settings=(*OFF_POLICY, "normalize=true")),
    "RL Zoo, goal learner": zoo(algorithm="goal_td3"),
    "RL Zoo, on policy": zoo(algorithm="ppolag", settings=("n_steps=10", "batch_size=10")),
    "SB3": third_party("stable_baselines3:SAC", "--algo-kwargs", "learning_starts=20"),
    "third party": third_party(DRIFTER),
}


@pytest.mark.parametrize("way", WAYS)
def test_training_selection_and_report_start_apart(
    drawn: list[tuple[Episodes, list[int]]], tmp_path: Path, way: str
) -> None:
    WAYS[way](tmp_path)
    # A seed starts the first episode of an environment; those that follow go on from there.
    first = [set(states[: episodes.n]) for episodes, states in drawn]
    selected = [one for one in first if one & SELECTION]
    reported = [one for one in first if one & REPORT]
    assert selected, "there were evaluations"
    assert all(one <= SELECTION for one in selected)
    assert all(one <= REPORT for one in reported)
    trained = [one for one in first if one not in selected and one not in reported]
    begun = [training_seed(SEED), *([training_seed(SEED, 20)] if way == "resumed" else [])]
    wanted = states_of(seed + environment for seed in begun for environment in range(2))
    assert set().union(*trained) == wanted, "the training starts with its own seed"
    for (_, states), one in zip(drawn, first, strict=True):
        if one in trained:
            assert not set(states) & (SELECTION | REPORT)


def test_all_episodes_of_an_evaluation_under_rl_zoo_have_selection_seeds(
    drawn: list[tuple[Episodes, list[int]]], tmp_path: Path
) -> None:
    WAYS["RL Zoo"](tmp_path)
    [states] = [states for _, states in drawn if set(states) & SELECTION]
    assert set(states) == states_of(SELECTION_SEEDS[:8]), "the episodes of three evaluations"


def test_restarts_of_a_run_go_on_with_other_training_seeds() -> None:
    seeds = {
        training_seed(seed, steps) for seed in range(20) for steps in range(0, 1_000_000, 50_000)
    }
    assert len(seeds) == 400
    for seed in (0, 7, MAX_RUN_SEED):
        for steps in (0, 50_000, 10**9):
            assert TRAINING_SEED + 1_000 * seed <= training_seed(seed, steps) <= 2**31 - 1_000
    assert training_seed(5, 50_000) == training_seed(5, 50_000)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"eval_seed": 0}, "eval_seed=0 with eval_episodes=100 evaluates on seeds 0 to 99"),
        ({"eval_seed": 10_950}, "10950 to 11049"),
        ({"eval_episodes": 1_001}, "10000 to 11000"),
        ({"seed": MAX_RUN_SEED + 1}, f"seed={MAX_RUN_SEED + 1} must be from 0 to {MAX_RUN_SEED}"),
    ],
)
def test_settings_that_leave_the_protocol_are_refused(
    changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        RunConfig("JacoPush-v0", **changes)
