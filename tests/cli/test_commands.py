"""Each command once, from end to end, on tiny settings."""

from __future__ import annotations

import re
import shlex
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from commands import ROOT, Saver, read_json, tiny_train

from saver_advisors.cli import COMMANDS, main
from saver_advisors.experiments.grid import read_grid
from saver_advisors.learner.arms import ArmBlocks
from saver_advisors.training.settings import RunConfig
from saver_envs.registration import ENVIRONMENTS, make_episodes

NAME = "jaco-push"


def test_help_names_every_command(saver: Saver) -> None:
    result = saver("--help")
    assert result.status == 0
    for name in COMMANDS:
        assert re.search(rf"^    {name}\s", result.out, flags=re.MULTILINE)
    assert saver().out == result.out


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_examples(saver: Saver, command: str) -> None:
    result = saver(command, "--help")
    assert result.status == 0
    assert "examples:" in result.out
    assert f"saver {command}" in result.out


def test_envs(saver: Saver, tmp_path: Path) -> None:
    result = saver("envs", "--all", "--json", tmp_path / "envs.json")
    assert result.status == 0
    content = read_json(tmp_path / "envs.json")
    assert {one["env_id"] for one in content["environments"]} == set(ENVIRONMENTS)
    for name in ENVIRONMENTS:
        assert f" {name} " in result.out
    rows = {one["env_id"]: one for one in content["environments"]}
    distance = rows["DualJacoDistance-v0"]
    sizes = [distance[f"{name}_size"] for name in ("observation", "action", "goal")]
    assert sizes == [56, 8, 7]
    assert distance["summed_costs"] == ["distance"]
    assert distance["costs"] == ["collision", "distance"]
    assert "0.35 m" in distance["succeeds"]
    assert content["provenance"]["command"].startswith("saver envs --all")


def test_envs_as_markdown(saver: Saver) -> None:
    lines = saver("envs", "--markdown").out.splitlines()
    assert len(lines) == 2 + len(ENVIRONMENTS) / 2
    assert len({line.count("|") for line in lines}) == 1


def test_evaluate_a_shipped_policy(saver: Saver, tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    words = ("evaluate", "--env", "JacoPush-v0", "--policy", NAME, "--episodes", 8)
    result = saver(*words, "--seed", 3, "--json", path)
    assert result.status == 0, result.err
    content = read_json(path)
    assert (content["env"], content["policy"], content["episodes"]) == ("JacoPush-v0", NAME, 8)
    assert content["seed"] == 3
    assert content["ci95"][0] < content["success_rate"] <= content["ci95"][1]
    assert content["success_rate"] >= 0.75
    assert {"cost", "cost_collision"} <= content["cost_means"].keys()
    assert content["provenance"].keys() >= {"command", "commit", "versions", "machine", "time"}
    assert f"{content['success_rate']:.3f}" in result.out


@pytest.mark.parametrize(
    ("env", "policy"),
    [
        ("JacoPush-v0", "random"),
        ("DualJacoPush-v0", f"side-by-side:{NAME}"),
        ("DualJacoDistance-v0", "side-by-side:jaco-pick-and-place"),
        ("JacoPush-v0", "expert"),
        ("DualJacoPush-v0", "expert-uncoordinated"),
        ("DualJacoPush-v0", "frozen-arm:1"),
    ],
)
def test_evaluate_other_kinds(saver: Saver, tmp_path: Path, env: str, policy: str) -> None:
    path = tmp_path / "result.json"
    words = ("evaluate", "--env", env, "--policy", policy, "--episodes", 2)
    result = saver(*words, "--env-kwargs", "max_episode_steps=5", "--json", path)
    assert result.status == 0, result.err
    content = read_json(path)
    assert content["policy"] == policy
    assert content["length_mean"] == 5
    assert content["env_kwargs"] == {"max_episode_steps": 5}


def test_a_random_policy_is_reproducible(saver: Saver, tmp_path: Path) -> None:
    words = ("evaluate", "--env", "JacoPush-v0", "--policy", "random", "--episodes", 3)
    for name in "ab":
        saver(*words, "--env-kwargs", "max_episode_steps=5", "--json", tmp_path / f"{name}.json")
    first, second = (read_json(tmp_path / f"{name}.json") for name in "ab")
    assert first["final_distance_mean"] == second["final_distance_mean"]


@pytest.mark.slow
def test_a_video_shows_the_episodes_that_were_asked_for(saver: Saver, tmp_path: Path) -> None:
    import imageio_ffmpeg

    from saver_advisors.reporting.video import BAR_HEIGHT, FPS, HOLD

    path = tmp_path / "push.mp4"
    words = ("evaluate", "--env", "JacoPush-v0", "--policy", "random", "--episodes", 3)
    result = saver(
        *words, "--env-kwargs", "max_episode_steps=4", "--video", path, "--video-episodes", 2
    )
    assert result.status == 0, result.err
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert frames == 2 * (4 + 1 + HOLD)
    assert seconds == pytest.approx(frames / FPS, abs=0.1)
    meta = next(imageio_ffmpeg.read_frames(str(path)))
    assert meta["size"] == (640, 480 + BAR_HEIGHT)


def test_train_leaves_a_run_that_other_commands_read(
    saver: Saver, run_dir: Path, tmp_path: Path
) -> None:
    assert read_json(run_dir / "run.json")["config"]["net_arch"] == [8]
    result = saver(
        *("evaluate", "--env", "JacoPush-v0", "--policy", run_dir, "--episodes", 2),
        *("--env-kwargs", "max_episode_steps=5"),
    )
    assert result.status == 0, result.err
    figure, path = tmp_path / "curve.png", tmp_path / "curve.json"
    result = saver("curves", run_dir, "--output", figure, "--json", path)
    assert result.status == 0, result.err
    assert figure.read_bytes().startswith(b"\x89PNG")
    [run] = read_json(path)["runs"]
    assert (run["name"], run["env"], run["steps"]) == ("tiny", "JacoPush-v0", 40)
    assert [point["steps"] for point in run["points"]] == [20, 40]
    weights = tmp_path / "tiny.safetensors"
    result = saver("export", run_dir, "--path", weights, "--episodes", 2)
    assert result.status == 0, result.err
    assert "push, one arm" in weights.with_suffix(".md").read_text()
    result = saver(
        *("evaluate", "--env", "JacoPush-v0", "--policy", weights, "--episodes", 2),
        *("--env-kwargs", "max_episode_steps=5"),
    )
    assert result.status == 0, result.err


def test_train_goes_on_from_its_folder_alone(saver: Saver, tmp_path: Path) -> None:
    folder, path = tmp_path / "run", tmp_path / "train.json"
    assert saver(*tiny_train(folder)).status == 0
    result = saver(
        *("train", "--output", folder, "--resume", "--steps", 80, "--no-progress"),
        *("--json", path),
    )
    assert result.status == 0, result.err
    content = read_json(path)
    assert (content["finished"], content["steps"]) == (True, 80)
    assert content["config"]["net_arch"] == [8]
    assert [s["from_steps"] for s in read_json(folder / "run.json")["sessions"]] == [0, 40]


def test_a_time_limit_ends_a_run_with_a_checkpoint(saver: Saver, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    words = tiny_train(folder, "checkpoint_every=1000000", "eval_every=1000000")
    result = saver(*words, "--steps", 10_000_000, "--time-limit", 0.5)
    assert result.status == 0, result.err
    assert f"saver train --output {folder} --resume" in result.out
    assert (folder / "latest" / "state.json").exists()


def test_a_student_is_advised(saver: Saver, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    result = saver(
        *("train", "--env", "DualJacoPush-v0", "--output", folder, "--steps", 40),
        *("--advice", "mc-q", "--teacher", NAME, "--budget", 30, "--threshold", 0.05),
        *("--no-progress", "--env-kwargs", "max_episode_steps=10", "--set"),
        *(
            word
            for word in tiny_train(folder)
            if "=" in str(word) and "max_episode_steps" not in str(word)
        ),
    )
    assert result.status == 0, result.err
    advice = read_json(folder / "run.json")["config"]["advice"]
    assert (advice["strategy"], advice["budget"], advice["threshold"]) == ("mc-q", 30, 0.05)


def test_the_settings_are_those_of_the_shipped_weights(saver: Saver) -> None:
    """What a card's command does, a run of its own or of a grid, is what the card says was done."""
    from saver_advisors.pretrained import load_policy, shipped_policies

    free = {"total_steps", "eval_every", "eval_episodes", "checkpoint_every"}
    free.add("start_from")  # the name of a folder
    for name in shipped_policies():
        card = load_policy(name).card
        words = shlex.split(card.command)
        if words[:3] == ["saver", "experiments", "run"]:
            chosen = read_grid(ROOT / words[3]).only(words[words.index("--only") + 1 :]).runs
            (config,) = (one.config.to_mapping() for one in chosen if one.config.seed == card.seed)
        else:
            result = saver(*words[1:], "--print-config")
            assert result.status == 0, result.err
            config = RunConfig.from_mapping(yaml.safe_load(result.out)).to_mapping()
        # Settings that are younger than the card had their defaults then.
        used = RunConfig.from_mapping(card.notes["config"]).to_mapping()
        assert {k: v for k, v in config.items() if k not in free} == {
            k: v for k, v in used.items() if k not in free
        }


def test_every_entry_of_the_defaults_is_a_configuration(saver: Saver) -> None:
    content = yaml.safe_load((ROOT / "zoo_configs" / "saver.yml").read_text())
    names = set(content) - {"default", "dual"}
    assert names <= set(ENVIRONMENTS)
    for name in sorted(names):
        assert saver("train", "--env", name, "--print-config").status == 0


def test_every_entry_of_imitation_fits_its_environment(saver: Saver) -> None:
    path = ROOT / "zoo_configs" / "dagger.yml"
    for name in yaml.safe_load(path.read_text()):
        result = saver("train", "--config", path, "--env", name, "--print-config")
        assert result.status == 0, result.err
        config = RunConfig.from_mapping(yaml.safe_load(result.out))
        if config.shared_arms:
            ArmBlocks.of_episodes(make_episodes(name))  # raises where arms share a part


def test_the_run_with_labels_is_that_of_the_grid(saver: Saver) -> None:
    path = ROOT / "zoo_configs" / "labels.yml"
    result = saver("train", "--config", path, "--env", "DualJacoPush-v0", "--print-config")
    assert result.status == 0, result.err
    config = RunConfig.from_mapping(yaml.safe_load(result.out))
    (run,) = (
        read_grid(ROOT / "zoo_configs" / "advising_shared_arms.yml").only(["labels-seed0"]).runs
    )
    assert config.advice is not None and run.config.advice is not None
    assert config.advice.budget >= run.config.advice.budget == config.total_steps
    assert replace(config, advice=run.config.advice) == run.config


def test_settings_add_up_however_they_are_given(saver: Saver) -> None:
    first = ("--set", "batch_size=7", "gamma=0.5", "--env-kwargs", "max_episode_steps=9")
    second = ("--set", "seed=3", "--env-kwargs", "rated=true")
    result = saver("train", "--env", "JacoPush-v0", *first, *second, "--print-config")
    assert result.status == 0, result.err
    for line in ("batch_size: 7", "gamma: 0.5", "seed: 3", "max_episode_steps: 9", "rated: true"):
        assert line in result.out


@pytest.mark.long
def test_demo(saver: Saver, tmp_path: Path) -> None:
    result = saver(
        *("demo", "--output", tmp_path, "--episodes", 4, "--video-episodes", 1),
        *("--train-seconds", 20, "--json", tmp_path / "copy.json"),
    )
    assert result.status == 0, result.err
    page = (tmp_path / "index.html").read_text()
    assert page.count("data:video/mp4;base64,") == len(list(tmp_path.glob("*.mp4"))) > 0
    assert not re.search(r'(src|href)="(?!data:)', page), "the page is self-contained"
    content = read_json(tmp_path / "demo.json")
    assert content == read_json(tmp_path / "copy.json")
    assert {one["policy"] for one in content["evaluations"]} >= {NAME, "random"}
    assert all(path.stat().st_size < 2_000_000 for path in tmp_path.glob("*.mp4"))


@pytest.mark.parametrize("old", ["docs --check", "benchmark ik --json x.json", "benchmark safe"])
def test_a_command_that_moved_says_where(old: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(old.split()) == 2
    assert "is now 'python -m reproduction " in capsys.readouterr().err
