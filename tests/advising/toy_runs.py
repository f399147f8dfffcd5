"""Whole runs in the toy environment, from settings as a YAML file would hold them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.torch import load_file
from tiny_runs import outcomes
from toy_arms import make_teacher, make_vec_env

from saver_advisors.policies.files import save_policy
from saver_advisors.training.curve_file import OF_THE_MACHINE
from saver_advisors.training.launch import train
from saver_advisors.training.run import RunResult
from saver_advisors.training.settings import RunConfig

N_ENVS, HORIZON = 4, 10
BLOCK = N_ENVS * HORIZON
BLOCKS = 6
SETTINGS: dict[str, Any] = {
    "env_id": "ToyArms",
    "n_envs": N_ENVS,
    "total_steps": BLOCKS * BLOCK,
    "net_arch": [32, 32],
    "batch_size": 16,
    "buffer_size": BLOCKS * BLOCK,
    "gradient_steps": 4,
    "eval_every": BLOCK,
    "eval_episodes": 3,
    "checkpoint_every": BLOCK,
}
CARD = {
    "env_id": "ToyArm",
    "algorithm": "td3",
    "command": "none",
    "steps": 0,
    "wall_clock_s": 0.0,
    "seed": 0,
    "commit": "",
    "success": 0.0,
    "success_episodes": 1,
    "task": "",
}


def save_teacher(folder: Path, seed: int = 0, name: str = "toy", **arguments: Any) -> str:
    """A teacher's weight file, with the clip that the learner's own normaliser has; its path."""
    teacher = make_teacher(seed, **arguments)
    teacher.networks.clip.fill_(5.0)
    return str(save_policy(folder / f"{name}.safetensors", teacher, CARD))


def settings(advice: dict[str, Any] | None, **changes: Any) -> RunConfig:
    """A run's settings, by way of JSON."""
    values = {**SETTINGS, "advice": advice, **changes}
    return RunConfig.from_mapping(json.loads(json.dumps(values)))


def start(config: RunConfig, folder: Path, **arguments: Any) -> RunResult:
    """Train; evaluations succeed as often as `rates` says, one after the other."""
    rates = iter(arguments.pop("rates", ()))
    envs: list[Any] = arguments.pop("envs", [])

    def make(wanted: RunConfig, threads: int = 1) -> Any:
        envs.append(make_vec_env(wanted.n_envs, **wanted.env_kwargs))
        return envs[-1]

    def evaluate(predict: Any, env_id: str, *, episodes: int, **named: Any) -> Any:
        env = make_vec_env(episodes, **config.env_kwargs)
        env.seed(0)
        predict(env.reset())
        reached = round(episodes * next(rates, 0.0))
        return outcomes(np.arange(episodes) < reached, {})

    with pytest.MonkeyPatch.context() as changed:
        changed.setattr("saver_advisors.training.launch.build_env", make)
        changed.setattr("saver_advisors.training.run.evaluate_policy", evaluate)
        return train(config, folder, **({"progress": False} | arguments))


def steps_taken(env: Any) -> int:
    """Steps that the environments of a vector were told to do."""
    return sum(len(actions) for actions in env.env_method("executed_actions"))


def curve(folder: Path) -> list[dict[str, Any]]:
    """The lines of a run's curve, without the clock."""
    lines = [json.loads(line) for line in (folder / "curve.jsonl").read_text().splitlines()]
    return [{k: v for k, v in line.items() if k not in OF_THE_MACHINE} for line in lines]


def advisor_state(folder: Path) -> dict[str, Any]:
    """What the latest checkpoint says of the advisor."""
    state = json.loads((folder / "latest" / "state.json").read_text())
    advisor: dict[str, Any] = state["extra"]["advisor"]
    return advisor


def replay(folder: Path, name: str = "replay") -> dict[str, Any]:
    """The arrays of the latest checkpoint's buffer."""
    with np.load(folder / "latest" / f"{name}.npz") as file:
        return {key: file[key] for key in file.files}


def assert_resumes_exactly(config: RunConfig, folder: Path, **arguments: Any) -> None:
    """A run in three parts leaves what an uninterrupted one leaves, bit for bit."""
    rates = list(arguments.pop("rates", ()))
    whole, parts = folder / "whole", folder / "parts"
    start(config, whole, rates=rates)
    start(config, parts, rates=rates, stop_after_steps=BLOCK)
    start(config, parts, rates=rates[1:], resume=True, stop_after_steps=3 * BLOCK)
    start(config, parts, rates=rates[3:], resume=True)
    assert curve(parts) == curve(whole)
    one, other = parts / "latest", whole / "latest"
    assert sorted(p.name for p in one.iterdir()) == sorted(p.name for p in other.iterdir())
    for file in one.glob("*.npz"):
        with np.load(file) as a, np.load(other / file.name) as b:
            for name in a.files:
                np.testing.assert_array_equal(a[name], b[name], err_msg=f"{file.name} {name}")
    for name in ("policy.safetensors", "training.safetensors"):
        tensors, others = load_file(one / name), load_file(other / name)
        for key, tensor in tensors.items():
            assert tensor.equal(others[key]), key
    states = [json.loads((f / "state.json").read_text()) for f in (one, other)]
    for state in states:
        # The times differ, and with them the checksums; so does the order of a header in a file.
        del (
            state["extra"]["wall_clock_s"],
            state["extra"]["processor_s"],
            state["files"],
            state["sha256"],
        )
    assert states[0] == states[1]
