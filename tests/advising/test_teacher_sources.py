"""Teachers from a run's folder, a zip file of SB3, or a function; nothing is unpickled."""

from __future__ import annotations

import io
import json
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from sb3_contrib import TQC
from stable_baselines3 import DDPG, PPO, SAC, TD3
from stable_baselines3.common.vec_env import VecNormalize
from tiny_runs import TINY_RUN, write_settings
from torch import nn

from saver_advisors.advising import make_advisor
from saver_advisors.cli import main
from saver_advisors.learner import GoalTD3
from saver_advisors.learner.algorithms import GoalSAC, GoalTQC
from saver_advisors.policies.files import load_teacher
from saver_advisors.policies.teacher import Teacher
from saver_advisors.training.launch import load_trained, train
from saver_advisors.training.settings import AdviceConfig, RunConfig
from saver_envs.envs.sb3_vec_env import SaverVecEnv

MODELS: dict[str, tuple[type[Any], dict[str, Any]]] = {
    "ddpg": (DDPG, {"net_arch": {"pi": [8], "qf": [9, 9]}}),
    "td3": (TD3, {"net_arch": [16, 8], "activation_fn": nn.Tanh}),
    "sac": (SAC, {"net_arch": [8]}),
    "tqc": (TQC, {"n_quantiles": 5, "activation_fn": nn.ELU}),
    "goal_td3": (GoalTD3, {"net_arch": [16], "n_values": 1}),
    "goal_sac": (GoalSAC, {"features_extractor_kwargs": {"achieved_goal": True}}),
    "goal_tqc": (GoalTQC, {"layer_norm": False}),
}


@pytest.fixture(scope="module")
def env() -> SaverVecEnv:
    torch.set_num_threads(1)
    return SaverVecEnv("JacoPush-v0", n_envs=3, seed=1_000_000, max_episode_steps=10)


@pytest.fixture(scope="module")
def seen(env: SaverVecEnv) -> tuple[Any, Any, Any]:
    observation = env.reset()
    return tuple(observation[key] for key in ("observation", "desired_goal", "achieved_goal"))  # type: ignore[return-value]


def built(env: Any, kind: type[Any], arguments: dict[str, Any], **more: Any) -> Any:
    return kind("MultiInputPolicy", env, policy_kwargs=arguments, buffer_size=100, seed=0, **more)


def assert_same(one: Teacher, other: Teacher, seen: tuple[Any, Any, Any]) -> None:
    assert one.networks.spec == other.networks.spec
    action = one.act(*seen)
    np.testing.assert_array_equal(action, other.act(*seen))
    values = [each.q_value(*seen[:2], action, seen[2]) for each in (one, other)]
    np.testing.assert_array_equal(*values)


@pytest.mark.parametrize("name", MODELS)
def test_a_zip_file_holds_the_same_teacher_as_its_model(
    env: SaverVecEnv, seen: tuple[Any, Any, Any], tmp_path: Path, name: str
) -> None:
    model = built(env, *MODELS[name])
    if "goal" in name:
        model.policy.actor.features_extractor.update(env.reset())
    model.save(tmp_path / "mine.zip")
    teacher = load_teacher(tmp_path / "mine.zip")
    assert teacher.name == "mine"
    assert_same(teacher, Teacher.from_sb3(model), seen)


class Evil:
    def __reduce__(self) -> tuple[Any, ...]:
        return (open, ("unpickled.txt", "w"))


def rewritten(source: Path, target: Path, **changed: bytes) -> Path:
    """A copy of a zip file with other members."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            new.writestr(name, changed.get(name.replace(".", "_"), old.read(name)))
    return target


def test_what_only_unpickling_shows_is_refused_with_the_way_that_works(
    env: SaverVecEnv, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    plain, sde, ppo = (tmp_path / f"{name}.zip" for name in ("plain", "sde", "ppo"))
    built(env, *MODELS["sac"]).save(plain)
    built(env, SAC, {"net_arch": [8]}, use_sde=True).save(sde)
    PPO("MultiInputPolicy", env, n_steps=8, batch_size=8).save(ppo)
    odd = tmp_path / "odd.zip"
    built(env, SAC, {"net_arch": [8], "activation_fn": nn.Softplus}).save(odd)
    for path, reason in ((sde, "gSDE"), (odd, "activation")):
        with pytest.raises(ValueError, match=rf"{path.name} .*{reason}.*Teacher.from_sb3\(model\)"):
            load_teacher(path)
    with pytest.raises(ValueError, match=r"ppo.zip cannot be read .* policy is one of \S+common"):
        load_teacher(ppo)
    with zipfile.ZipFile(plain) as archive:
        data = json.loads(archive.read("data"))
    whole = io.BytesIO()
    torch.save({"actor.mu.weight": torch.ones(3, 8)}, whole)
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("policy/data.pkl", bytes(300_000_000))
    cases = {
        "pickle": {"policy_pth": pickle.dumps(Evil())},
        "text": {"data": b"no json"},
        "deep": {"data": b"[" * 100_000},
        "list": {"data": b"[]"},
        "spaceless": {"data": json.dumps({**data, "observation_space": None}).encode()},
        "partly": {"policy_pth": whole.getvalue()},
        "bomb": {"policy_pth": bomb.getvalue()},
    }
    for name, changed in cases.items():
        path = rewritten(plain, tmp_path / f"{name}.zip", **changed)
        with pytest.raises(ValueError, match=rf"{name}\.zip"):
            load_teacher(path)
    assert (tmp_path / "bomb.zip").stat().st_size < 10**6
    (tmp_path / "zip.zip").write_bytes(b"not a zip file")
    with pytest.raises(ValueError, match=r"zip\.zip cannot be read"):
        load_teacher(tmp_path / "zip.zip")
    assert not (tmp_path / "unpickled.txt").exists()


def test_a_model_whose_inputs_were_normalised_outside_is_refused(
    env: SaverVecEnv, tmp_path: Path
) -> None:
    wrapped = VecNormalize(env, norm_reward=False)
    built(wrapped, *MODELS["td3"]).save(tmp_path / "mine.zip")
    wrapped.save(str(tmp_path / "vecnormalize.pkl"))
    with pytest.raises(ValueError, match="normalised by VecNormalize"):
        load_teacher(tmp_path / "mine.zip")


def test_tensors_that_do_not_fit_together_are_refused_before_memory_is_taken(
    env: SaverVecEnv, tmp_path: Path
) -> None:
    """Widths of 65,536, in small tensors: the network would take 16 GB."""
    model = built(env, *MODELS["td3"])
    model.save(tmp_path / "small.zip")
    state = model.policy.state_dict()
    for layer in (0, 2):
        state[f"actor.mu.{layer}.weight"] = torch.zeros(65_536, 34 if layer == 0 else 1)
        state[f"actor.mu.{layer}.bias"] = torch.zeros(65_536)
    content = io.BytesIO()
    torch.save(state, content)
    rewritten(tmp_path / "small.zip", tmp_path / "large.zip", policy_pth=content.getvalue())
    with pytest.raises(ValueError, match=r"large.zip has networks that cannot be frozen"):
        load_teacher(tmp_path / "large.zip")


@pytest.mark.parametrize("algorithm", ["td3", "sac"])
def test_a_run_is_a_teacher(seen: tuple[Any, Any, Any], tmp_path: Path, algorithm: str) -> None:
    run = tmp_path / "run"
    config = RunConfig.from_mapping({**TINY_RUN.to_mapping(), "algorithm": algorithm})
    with pytest.raises(ValueError, match="is not the folder of a run that has a policy"):
        load_teacher(tmp_path)
    train(config, run, progress=False)
    assert_same(load_teacher(run), Teacher.from_sb3(load_trained(run, "best")), seen)
    with pytest.raises(ValueError, match=r"there is no weight file '\S+nothing'"):
        load_teacher(tmp_path / "nothing")


def towards(observation: Any, goal: Any) -> Any:
    """A teacher of push."""
    return np.clip(5 * (goal - observation[:, :3]), -1, 1)


NUMBER = 3


def test_a_function_advises(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dual = SaverVecEnv("DualJacoPush-v0", n_envs=2, seed=1_000_000)
    observation = dual.reset()
    spaces = {"observation_space": dual.observation_space, "action_space": dual.action_space}
    name = f"{__name__}:towards"
    for teacher in (towards, name, [towards, name]):
        advisor = make_advisor("early", teacher, 10, n_arms=2, **spaces)
        advice = advisor.advise(observation, np.zeros((2, 6), np.float32))
        for arm in range(2):
            rows = observation["observation"].reshape(2, 2, -1)[:, arm]
            goals = observation["desired_goal"].reshape(2, 2, -1)[:, arm]
            wanted = towards(rows, goals)
            np.testing.assert_allclose(advice.actions[:, 3 * arm : 3 * arm + 3], wanted)
    for wrong, error, message in (
        (f"{__name__}:nothing", ValueError, "cannot be imported"),
        ("no_such_module:f", ValueError, "cannot be imported"),
        (f"{__name__}:NUMBER", TypeError, "must be a function"),
    ):
        with pytest.raises(error, match=message):
            make_advisor("early", wrong, 10, n_arms=2, **spaces)
    with pytest.raises(ValueError, match="give n_arms, observation_space and action_space"):
        make_advisor("early", towards, 10, n_arms=2)
    with pytest.raises(ValueError, match="compares Q values"):
        make_advisor("mc-q", towards, 10, n_arms=2, **spaces)
    bad = make_advisor("early", lambda observation, goal: goal[:, :2], 10, n_arms=2, **spaces)
    with pytest.raises(
        ValueError, match=r"returned \(4, 2\): it must return finite actions \(4, 3"
    ):
        bad.advise(observation, np.zeros((2, 6), np.float32))


def test_every_kind_of_teacher_works_in_settings_and_commands(
    env: SaverVecEnv, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    train(TINY_RUN, tmp_path / "run", progress=False)
    built(env, *MODELS["td3"]).save(tmp_path / "mine.zip")
    for number, teacher in enumerate(
        (str(tmp_path / "run"), str(tmp_path / "mine.zip"), f"{__name__}:towards")
    ):
        config = RunConfig.from_mapping(
            {
                **TINY_RUN.to_mapping(),
                "env_id": "DualJacoPush-v0",
                "advice": {"strategy": "early", "teacher": [teacher, "jaco-push"], "budget": 20},
            }
        )
        assert isinstance(config.advice, AdviceConfig)
        assert train(config, tmp_path / f"settings{number}", progress=False).finished
        write_settings(config, tmp_path / "run.yml")
        words = ["train", "--config", tmp_path / "run.yml", "--output", tmp_path / f"c{number}"]
        words += ["--teacher", teacher, "--no-progress"]
        assert main([str(word) for word in words]) == 0
        record = json.loads((tmp_path / f"c{number}" / "run.json").read_text())
        assert record["config"]["advice"]["teacher"] == teacher


def test_a_function_advises_under_rl_zoo(tmp_path: Path) -> None:
    words = ["train", "--zoo", "td3", "--env", "DualJacoPush-v0", "--output", str(tmp_path)]
    words += ["--teacher", f"{__name__}:towards", "--advice", "early", "--budget", "20"]
    words += ["--steps", "40", "--env-kwargs", "max_episode_steps=10", "--set", "n_envs=2"]
    words += ["learning_starts=20", "policy_kwargs.net_arch=[8]", "--", "--eval-freq", "-1"]
    assert main(words) == 0
