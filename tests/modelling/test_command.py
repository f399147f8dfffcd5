"""`saver model`, and the snippets of the page on modelling."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from reproduction.modelling.model_arguments import cards_of, origin, trained_before
from saver_advisors.cli import main
from saver_advisors.cli.model import draw_recording
from saver_advisors.reporting.errors import UsageError
from saver_envs.modelling.arms import Task, arm_named
from saver_envs.modelling.datasets import Recording, save_recordings
from saver_envs.modelling.models import load_model, new_model, read_card

PAGE = Path(__file__).parents[2] / "docs" / "modelling.md"


def moving(samples: int = 150) -> Recording:
    generator = np.random.default_rng(0)
    position = np.array([0.0, 2.2, 4.2, 0.0]) + 0.3 * generator.normal(size=(samples, 4))
    motion = generator.normal(size=(3, samples, 4))
    return Recording(position, *motion, arm_named("mico").chain.position(position))


def test_training_from_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, weights = tmp_path / "own.npz", tmp_path / "own.safetensors"
    save_recordings(data, "mico", [moving(), moving()])
    command = "model train --robot mico --task id --model lsgan --set epochs=2 layers=1 width=8"
    words = [*command.split(), "sigma=0.2", "--data", str(data), "--output", str(weights)]
    assert main(words) == 0
    card = read_card(weights)
    assert (card["samples"], card["training"]["sigma"]) == (300, 0.2)
    assert card["provenance"]["versions"]
    model = load_model(weights, "mico", "id")
    assert np.isfinite(model.predict(np.zeros((1, 12)))).all()
    assert "lsgan" in weights.with_suffix(".md").read_text()
    assert f"wrote {weights}" in capsys.readouterr().out


def test_training_on_the_workspace(tmp_path: Path) -> None:
    weights = tmp_path / "mico.safetensors"
    words = "model train --robot mico --data workspace --samples 200 --set epochs=1 width=8"
    assert main([*words.split(), "--output", str(weights)]) == 0
    assert read_card(weights)["unseen_targets_mm"]["as_used"]["median"] < 2


def test_weights_that_were_trained_before(tmp_path: Path) -> None:
    card = {"training": {"epochs": 3}, "samples": 1000}
    ours, bare = tmp_path / "flow.safetensors", tmp_path / "bare.safetensors"
    new_model("analytic", "mico", "ik").save(ours, card)
    new_model("analytic", "mico", "ik").save(bare)
    found = trained_before([ours, bare], ["mico", "jaco"], "ik", ["shipped"])
    assert {robot: list(models) for robot, models in found.items()} == {
        "mico": ["flow", "bare"],
        "jaco": [],
    }
    assert origin(cards_of([ours, bare])) == " Trained before: `flow`: 3 epochs of 1,000 samples."
    assert origin({}) == origin(cards_of([bare])) == ""


@pytest.mark.parametrize(
    ("name", "robots", "task", "message"),
    [
        ("own", ["mico"], "id", "is of task 'ik', not 'id'"),
        ("own", ["fetch"], "ik", "a model of 'mico', but --robots selects fetch"),
        ("shipped", ["mico"], "ik", "there is another 'shipped' for 'mico'; rename the file"),
        ("cut", ["mico"], "ik", "not a complete safetensors file"),
    ],
)
def test_weights_that_cannot_be_measured(
    name: str, robots: list[str], task: Task, message: str, tmp_path: Path
) -> None:
    path = tmp_path / f"{name}.safetensors"
    new_model("analytic", "mico", "ik").save(path)
    if name == "cut":
        path.write_bytes(path.read_bytes()[:20])
    with pytest.raises(UsageError, match="argument --weights") as caught:
        trained_before([path], robots, task, ["shipped"])
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--set epoch=3", "setting 'epoch' is unknown (did you mean epochs?)"),
        ("--set epochs=0", "epochs=0: must be at least 1"),
        ("--model wgan", "model='wgan': must be one of"),
        ("--task id --data workspace", "workspace is for --task ik only"),
        ("--data nowhere.npz", "nowhere.npz is not a complete data file"),
        ("--robot jaco", "robot='jaco': there are data sets of mico, fetch"),
    ],
)
def test_mistakes_are_one_line(
    words: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["model", "train", "--output", str(tmp_path / "x.safetensors"), *words.split()]
    if "--robot" not in given:
        given += ["--robot", "mico"]
    assert main(given) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_a_recording_is_drawn_joint_by_joint() -> None:
    figure = draw_recording(moving(), "mico")
    assert len(figure.axes) == 16
    drawn = figure.axes[5].lines[0].get_ydata()
    assert np.array_equal(drawn, moving().velocity[:, 1])


def test_the_pages_snippets_run() -> None:
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), flags=re.DOTALL | re.MULTILINE)
    assert len(blocks) == 2
    names: dict[str, object] = {}
    for code in blocks:
        exec(compile(code, str(PAGE), "exec"), names)
