"""`saver pose`, `saver train-pose`, `saver benchmark pose` on tiny settings."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from saver_advisors.benchmark.pose.blazepose_worker import MAPS
from saver_advisors.benchmark.pose.pose_page import pose_page
from saver_advisors.cli import main, pose
from saver_envs.perception.network import LIGHT, PoseNetwork
from saver_envs.perception.parsing import Poses
from saver_envs.perception.skeleton import JOINTS
from saver_envs.perception.weights import save_network


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "network.safetensors"
    save_network(PoseNetwork(LIGHT), path, {"frames": 0})
    return path


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    path = tmp_path / "photo.png"
    pixels = np.random.default_rng(0).integers(0, 256, (120, 90, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(path)
    return path


def test_a_picture(weights: Path, photo: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, record = photo.with_name("out.png"), photo.with_name("out.json")
    words = [
        "pose",
        str(photo),
        "--out",
        str(out),
        "--weights",
        str(weights),
        "--json",
        str(record),
    ]
    assert main(words) == 0
    assert Image.open(out).size == (90, 120)
    content = json.loads(record.read_text())
    assert content["joints"] == list(JOINTS)
    assert len(content["frames"]) == 1
    assert "provenance" in content
    assert "people in 1 frames" in capsys.readouterr().out


def test_a_video(weights: Path, tmp_path: Path) -> None:
    import imageio_ffmpeg

    source, out = tmp_path / "in.mp4", tmp_path / "out.mp4"
    writer = imageio_ffmpeg.write_frames(str(source), (64, 48), fps=10, ffmpeg_log_level="error")
    writer.send(None)
    for value in range(5):
        writer.send(np.full((48, 64, 3), 40 * value, np.uint8))
    writer.close()
    words = ["pose", str(source), "--out", str(out), "--weights", str(weights), "--turn", "2"]
    assert main([*words, "--json", str(tmp_path / "out.json")]) == 0
    about = next(imageio_ffmpeg.read_frames(str(out)))
    assert about["size"] == (64, 48)
    assert len(json.loads((tmp_path / "out.json").read_text())["frames"]) == 5


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere.png", "--out", "o.png"], "'nowhere.png' does not exist"),
        (["notes.txt", "--out", "o.png"], "must end in .png"),
        (["PHOTO", "--out", "o.mp4"], "must be a picture"),
        (["PHOTO", "--out", "o.png", "--limbs", "tail"], "'tail' is none of head"),
        (["PHOTO", "--out", "o.png", "--weights", "PHOTO"], "argument --weights"),
        (["BROKEN", "--out", "o.png"], "broken.png is not a picture"),
    ],
)
def test_mistakes_are_one_line(
    words: list[str],
    said: str,
    photo: Path,
    weights: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(photo.parent)
    broken = photo.with_name("broken.png")
    broken.write_bytes(b"no picture")
    words = [{"PHOTO": str(photo), "BROKEN": str(broken)}.get(word, word) for word in words]
    if "--weights" not in words:
        words += ["--weights", str(weights)]
    assert main(["pose", *words]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_weights_of_other_limbs(
    tmp_path: Path, photo: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "head.safetensors"
    save_network(PoseNetwork(LIGHT, ["head"]), path, {})
    out = str(tmp_path / "o.png")
    words = ["pose", str(photo), "--out", out, "--weights", str(path), "--limbs", "left_thigh"]
    assert main(words) == 2
    assert "has no branches of left_thigh; it has head" in capsys.readouterr().err


@pytest.mark.slow
def test_the_benchmark(weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from saver_advisors.benchmark.pose import accuracy, speed
    from saver_advisors.cli import benchmark_pose as command

    monkeypatch.setattr(accuracy, "SHARD", 2)
    monkeypatch.setattr(accuracy, "SETS", {"test": accuracy.SETS["test"]})
    monkeypatch.setattr(speed, "SIZES", ((64, 96),))
    monkeypatch.setattr("saver_envs.perception.network.ARCHITECTURES", {"light": LIGHT})
    monkeypatch.setattr(command, "THREADS", (1,))
    assert command.PARTS == ("accuracy", "speed")
    record = tmp_path / "pose.json"
    words = ["benchmark", "pose", "--weights", str(weights), "--frames", "20", "--rounds", "1"]
    monkeypatch.setattr("saver_advisors.cli.arguments.at_least", lambda least: int)
    words[words.index("20")] = "2"
    assert main([*words, "--cache", str(tmp_path), "--json", str(record)]) == 0
    content = json.loads(record.read_text())
    row = content["models"]["saver"]["test"]
    assert row.keys() >= {"pck_0.2", "error_px", "error_mm", "frames_per_second", "oks_ap"}
    assert row["frames"] == 2
    parts = content["speed"][0]["milliseconds"]
    assert parts.keys() >= {"backbone", "stage1", "stage2", "stage2_sequential", "network"}
    assert {one["people"] for one in content["parsing"]} == {1, 2, 5, 10}
    assert content["parsing"][0]["found"] == 1
    assert "provenance" in content
    page = pose_page(content)
    assert f"{row['pck_0.2']:.3f}" in page
    assert f"{parts['network']:.1f}" in page


def test_the_detectors_anchors_are_as_many_as_its_boxes() -> None:
    assert sum((224 // stride) ** 2 * count for stride, count in MAPS) == 2254


def test_perception_knows_no_task_and_robots_no_torch() -> None:
    code = (
        "import sys, saver_envs, saver_envs.people.manikin, saver_envs.perception.parsing,"
        " saver_envs.cameras.rgbd, saver_envs.perception.rendered_scenes,"
        " saver_envs.wrappers.pose_observation;"
        " loaded = set(sys.modules);"
        " assert 'torch' not in loaded, 'torch';"
        " assert not any(name.startswith('saver_advisors') for name in loaded)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
    folder = Path(__file__).parents[2] / "saver_envs" / "perception"
    for path in folder.glob("*.py"):
        text = path.read_text()
        for room in ("tasks", "envs", "episodes", "registration", "wrappers"):
            assert f"from saver_envs.{room}" not in text, (path, room)


def test_a_picture_has_a_name_of_its_own(
    weights: Path, photo: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["pose", str(photo), "--weights", str(weights)]) == 0
    out = photo.with_name("photo-poses.png")
    assert Image.open(out).size == (90, 120)
    captured = capsys.readouterr()
    assert f"wrote {out}" in captured.out
    assert "warning: in 1 of 1 frames no person has a score of 0.4 or more" in captured.err


def test_a_high_score_is_not_warned_about(
    photo: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    one = Poses(np.full((1, 14, 2), 9.0), np.full((1, 14), 0.7), np.array([0.7]))
    monkeypatch.setattr(pose, "_estimator", lambda args: lambda image: one)
    assert main(["pose", str(photo)]) == 0
    assert capsys.readouterr().err == ""


def test_a_rotated_photograph_is_turned_upright(weights: Path, tmp_path: Path) -> None:
    image = Image.new("RGB", (90, 120))
    exif = image.getexif()
    exif[0x112] = 6  # the camera was turned by a quarter
    image.save(tmp_path / "photo.jpg", exif=exif)
    out = tmp_path / "out.png"
    words = ["pose", str(tmp_path / "photo.jpg"), "--weights", str(weights), "--out", str(out)]
    assert main(words) == 0
    assert Image.open(out).size == (120, 90)
