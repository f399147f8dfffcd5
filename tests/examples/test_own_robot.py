"""An arm from a model that is not ours, driven through a task of ours."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from rollouts import begun

from saver_envs.experts import make_expert
from saver_envs.robots.from_model import robot_from_model
from saver_envs.tasks.push import Push

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"
ENV_ID = "own_robot:FrankaPush-v0"


def own_robot() -> Any:
    return importlib.import_module("own_robot")


def test_it_is_as_short_as_promised() -> None:
    assert len((EXAMPLES / "own_robot.py").read_text().splitlines()) <= 60


def test_what_the_model_tells_is_derived() -> None:
    robot = own_robot().FRANKA
    np.testing.assert_allclose(robot.joint_lower[:2], (-2.8973, -1.7628))
    assert robot.joint_torque_limits == (87.0,) * 4 + (12.0,) * 3
    assert robot.holds_orientation
    assert "panda0_link0_geom1" in robot.off_table_geoms
    for joint, lower, upper in zip(robot.home, robot.joint_lower, robot.joint_upper, strict=True):
        assert lower <= joint <= upper


def test_the_tool_points_down_at_home_with_the_axes_of_the_base() -> None:
    episodes = begun(ENV_ID, 2)
    state = episodes.simulation.arm_state()
    np.testing.assert_allclose(
        state.tool_rotation, np.broadcast_to(np.eye(3), state.tool_rotation.shape), atol=2e-2
    )
    np.testing.assert_allclose(state.tool_position, episodes.set_point, atol=1e-3)


def test_checker() -> None:
    check_env(gymnasium.make(ENV_ID).unwrapped, skip_render_check=True)


@pytest.mark.slow
def test_the_expert_of_push_drives_it() -> None:
    episodes, expert = begun(ENV_ID, 20, seed=1000), make_expert(ENV_ID)
    for _ in range(50):
        outcome = episodes.step(expert.predict(episodes.observation().as_dict())[0])
    assert outcome.success.mean() >= 0.7


ARM = {
    "base_body": "panda0_link0",
    "tool": "end_effector",
    "arm_joints": [f"robot:panda0_joint{index}" for index in range(1, 8)],
}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"base_body": "link0"}, "base_body='link0': the model has the bodies"),
        ({"tool": "hand"}, "tool='hand': the model has no site and no body"),
        ({"arm_joints": ["elbow"]}, "joint 'elbow': the model has the joints"),
        ({"joint_torque_limits": [1.0]}, "joint_torque_limits=.*each of 7 joints"),
        ({"joint_speed_limits": [-1.0] * 7}, "joint_speed_limits=.*positive number"),
        ({"home": [0.0]}, "home=.*each of 7 joints"),
        ({"home": [10.0] * 7}, "home=.*within their limits"),
        ({"tool_offset": (0, 0, 5.0)}, "cannot point down"),
    ],
)
def test_what_a_model_lacks_is_named(changed: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        robot_from_model("other", own_robot().franka, **{**ARM, **changed})  # type: ignore[arg-type]


def test_a_file_that_is_not_there() -> None:
    with pytest.raises(ValueError, match="there is no such file"):
        robot_from_model("other", "nowhere.xml", **ARM)  # type: ignore[arg-type]


def test_a_path_is_a_model_too(tmp_path: Path) -> None:
    """The same arm, written as a file."""
    joint = "<joint name='j{0}' type='hinge' axis='{1}' range='-2 2' limited='true'/>"
    link = (
        "<body name='b{0}' pos='0 0 {2}'>{3}"
        "<geom size='0.03' fromto='0 0 0 0 0 {4}' type='capsule'/>"
    )
    text, axes = "", ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1")
    heights = (0.1, 0.15, 0.35, 0.3, 0.1, 0.08)
    for index, (axis, height) in enumerate(zip(axes, heights, strict=True)):
        text += link.format(index, axis, height, joint.format(index, axis), 0.07)
    text += "<site name='tip' pos='0 0 0.12'/>" + "</body>" * 6
    path = tmp_path / "arm.xml"
    path.write_text(
        "<mujoco><compiler angle='radian'/><worldbody><body name='base'>"
        f"<geom type='box' size='0.05 0.05 0.05'/>{text}</body></worldbody></mujoco>"
    )
    robot = robot_from_model(
        "stick", path, base_body="base", tool="tip", arm_joints=[f"j{i}" for i in range(6)]
    )
    assert robot.joint_lower == (-2.0,) * 6
    assert robot.joint_torque_limits == (50.0,) * 6
    model = robot.build(Push.fingers).compile()
    assert isinstance(model, mujoco.MjModel)
