"""The model of an episode is the one that would be compiled with the episode's values."""

from __future__ import annotations

import copy
from dataclasses import replace
from itertools import chain
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from rollouts import CUBE_IDS, SPARSE_IDS, assert_same, begun, random_actions

from saver_envs.cameras.rendering import SceneRenderer
from saver_envs.envs.goal_env import SaverGoalEnv
from saver_envs.episodes import Episodes
from saver_envs.people.patient import Patient
from saver_envs.registration import make_episodes, parameters_of
from saver_envs.robots.description import Fingers, Robot
from saver_envs.scenes import Arms, compose

N = 3


def differing(one: mujoco.MjModel, other: mujoco.MjModel) -> dict[str, float]:
    """Name every array in which two models differ, with the greatest difference."""
    found = {}
    for name in dir(one):
        values = getattr(one, name)
        if name.startswith("_") or not isinstance(values, np.ndarray):
            continue
        others = getattr(other, name)
        if values.shape != others.shape:
            found[name] = np.inf
        elif (values != others).any():
            found[name] = float(np.abs(values.astype(float) - others.astype(float)).max())
    return found


def values_of(episodes: Episodes, row: int) -> dict[str, NDArray[np.float64]]:
    return {name: values[row] for name, values in episodes.worlds.values.items()}


def rebuilt(robot: Robot, base: mujoco.MjModel, values: dict[str, Any]) -> Robot:
    """A robot whose specification has an episode's servos and tool point."""

    def build(fingers: Fingers) -> mujoco.MjSpec:
        spec = robot.build(fingers)
        for actuator in spec.actuators:
            if actuator.name in robot.arm_actuators:
                stiffness = actuator.gainprm[0] * values["servo_stiffness"][0]
                actuator.gainprm[0], actuator.biasprm[1] = stiffness, -stiffness
                # Not as a ratio, which the compiler would multiply by the root of the stiffness.
                damping = base.actuator(f"arm0_{actuator.name}").biasprm[2]
                actuator.biasprm[2] = damping * values["servo_damping"][0]
        site = spec.site(robot.tool_site)
        site.pos = site.pos + values["tool_offset"]
        return spec

    return replace(robot, build=build)


@pytest.mark.parametrize("env_id", ["JacoPush-v0", "JacoPickAndPlace-v0", "MicoPickAndPlace-v0"])
def test_every_field_is_the_compilers(env_id: str) -> None:
    """Cubes, table, pads, servos and tool: in the first episodes, and after a reset of some."""
    known = parameters_of(make_episodes(env_id).task)
    varied: dict[str, Any] = {
        one.name: {"choice": list(one.names)} if one.names else one.wide for one in known
    }
    episodes = begun(env_id, N, randomization=varied)
    for reset in (None, [0, 2]):
        if reset is not None:
            episodes.reset(reset)
        for row in range(N):
            task, values = episodes.worlds.tasks[row], values_of(episodes, row)
            robot = rebuilt(episodes.settings.robot, episodes.scene.model, values)
            scene = compose(Arms(robot, task.n_arms, task.fingers, task.bases), task)
            found = differing(episodes.simulation.model_of(row), scene.model)
            # The order of two multiplications; nothing else may differ by a bit.
            assert {"site_pos", "site_quat"} >= found.keys(), found
            assert all(size < 1e-15 for size in found.values()), found


def test_every_field_of_a_board_is_the_compilers() -> None:
    known = make_episodes("DualJacoCarry-v0").task.parameters
    varied = {one.name: one.wide for one in known}
    episodes = begun("DualJacoCarry-v0", N, randomization=varied)
    for reset in (None, [0, 2]):
        if reset is not None:
            episodes.reset(reset)
        for row in range(N):
            task = episodes.worlds.tasks[row]
            arms = Arms(episodes.settings.robot, task.n_arms, task.fingers, task.bases)
            found = differing(episodes.simulation.model_of(row), compose(arms, task).model)
            # Masses and heights are computed in another order.
            assert all(size < 1e-9 for size in found.values()), found


@pytest.mark.parametrize("env_id", ["DualJacoPush-v0", "DualJacoDistance-v0"])
def test_each_arm_has_its_own_tool_point(env_id: str) -> None:
    episodes = begun(env_id, N, randomization={"tool_offset": [-0.01, 0.01]})
    scene, base = episodes.scene, episodes.scene.model
    for row in range(N):
        expected = copy.copy(base)
        offset = values_of(episodes, row)["tool_offset"].reshape(2, 3)
        assert len(np.unique(offset)) == 6
        expected.site_pos[scene.tool_site] = base.site_pos[scene.tool_site] + offset
        assert differing(episodes.simulation.model_of(row), expected) == {}


def test_every_field_of_a_person_is_mujocos() -> None:
    """Compared with the body's compiled model after its masses, friction and joints are changed."""
    episodes = begun("WristPush-v0", N, randomization="wide")
    scene, patient = episodes.scene, episodes.simulation.keep(Patient)
    where, arms = patient._where, episodes.simulation.arm_bodies
    for row in range(N):
        values = values_of(episodes, row)
        base = scene.models[int(values["person_body"][0])]
        expected = copy.copy(base)
        person = np.setdiff1d(np.arange(1, base.nbody), arms)
        expected.body_mass[person] *= values["person_mass"]
        expected.body_inertia[person] *= values["person_mass"]
        expected.dof_frictionloss[where.limb_dofs] *= values["person_stiffness"]
        expected.dof_damping[where.limb_dofs] *= values["person_stiffness"]
        expected.geom_friction[where.limb_geoms, 0] = values["person_friction"]
        servos, tools = scene.arm_ctrl.ravel(), scene.tool_site
        expected.actuator_gainprm[servos, 0] *= values["servo_stiffness"]
        expected.actuator_biasprm[servos, 1] *= values["servo_stiffness"]
        expected.actuator_biasprm[servos, 2] *= values["servo_damping"]
        expected.site_pos[tools] += values["tool_offset"].reshape(2, 3)
        mujoco.mj_setConst(expected, mujoco.MjData(expected))
        # The compiler fused bodies; inverse weights of contacts are those of the lightest part.
        expected.body_invweight0[:] = base.body_invweight0
        expected.body_invweight0[person] /= values["person_mass"]
        found = differing(episodes.simulation.model_of(row), expected)
        assert all(size < 1e-9 for size in found.values()), found


def test_people_lie_where_and_as_they_were_drawn() -> None:
    episodes = begun("WristPush-v0", 4, randomization="wide")
    values, memory = episodes.worlds.values, episodes.memory
    usual = np.array([begun("WristPush-v0", 1, person_x=0.0, person_y=0.0).memory["hips"][0]] * 4)
    np.testing.assert_array_equal(memory["body"], values["person_body"][:, 0])
    for name in ("friction", "stiffness", "mass", "yaw"):
        np.testing.assert_array_equal(memory[name], values[f"person_{name}"][:, 0])
    place = np.concatenate([values["person_x"], values["person_y"]], axis=1)
    np.testing.assert_allclose(memory["hips"], usual + place, atol=1e-12)


@pytest.mark.parametrize("env_id", SPARSE_IDS)
def test_nominal_values_in_all_fields_are_bit_identical(env_id: str) -> None:
    """With the same starts: a batch with a model each moves as one that shares its model."""
    plain = make_episodes(env_id, N)
    known = parameters_of(plain.task)
    nominal = {one.name: one.usual for one in known if one.usual is not None}
    varied = make_episodes(env_id, N, randomization=nominal)
    both = (plain, varied)
    for index in range(N):
        for episodes in both:
            episodes.set_generator(index, np.random.default_rng(index))
    for episodes in both:
        episodes.reset()
    for action in chain([None], random_actions(plain.action_size, 40, N)):
        if action is not None:
            outcomes = [episodes.step(action) for episodes in both]
            assert_same(*[outcome.info() for outcome in outcomes])
            assert_same(*[outcome.reward for outcome in outcomes])
        assert_same(*[vars(episodes.observation()) for episodes in both])
        assert_same(*[episodes.simulation.qpos for episodes in both])


# ---------------------------------------------------------------- tables and pictures


@pytest.mark.parametrize("height", [-0.02, 0.05])
@pytest.mark.parametrize("env_id", CUBE_IDS)
def test_everything_follows_the_height_of_the_table(env_id: str, height: float) -> None:
    """Cubes lie on it, hands are held above it, and targets and set-points are above it."""
    plain = begun(env_id, 4)
    for options in ({"table_height": height}, {"randomization": {"table_height": height}}):
        episodes = begun(env_id, 4, **options)
        task, rule = episodes.task, episodes.worlds.set_points
        goal = task.goal_layout.get(episodes.goal, "object position")
        assert (goal[..., 2] >= height + task.object_size / 2 - 1e-9).all()
        assert (episodes.set_point[..., 2] > height).all()
        usual = plain.worlds.set_points.workspace.lower
        raised = np.broadcast_to(usual + np.array([0, 0, height]), (4, *usual.shape))
        lower = np.broadcast_to(rule.workspace.lower, raised.shape)
        np.testing.assert_allclose(lower, raised, atol=1e-12)
        down = np.tile([0.0, 0, -1, 1][: episodes.action_size_per_arm], (4, task.n_arms))
        for _ in range(30):
            assert not episodes.step(down).diverged.any()
        lowest = task.held_height or usual[0, 2]
        np.testing.assert_allclose(episodes.set_point[..., 2], lowest + height, atol=1e-12)


def pictures(env_id: str, **options: Any) -> NDArray[np.uint8]:
    env = SaverGoalEnv(env_id, "rgb_array", width=200, height=150, **options)
    env.reset(seed=0)
    picture: NDArray[np.uint8] = env.render()
    env.close()
    return picture


def test_cameras_move_by_what_was_drawn() -> None:
    episodes = begun("JacoPush-v0", 2, randomization={"camera_position": [-0.02, 0.02],
                                                     "camera_rotation": [-0.05, 0.05]})  # fmt: skip
    nominal = episodes.scene.drawing_model()
    renderer = SceneRenderer(episodes.scene, 64, 48)
    shown = []
    for row in range(2):
        renderer.update(episodes, row)
        values, model = values_of(episodes, row), renderer.model
        np.testing.assert_allclose(
            model.cam_pos - nominal.cam_pos,
            np.tile(values["camera_position"], (model.ncam, 1)),
            atol=1e-12,
        )
        for camera in range(model.ncam):
            inverse, turn, rotation = np.zeros(4), np.zeros(4), np.zeros(3)
            mujoco.mju_negQuat(inverse, nominal.cam_quat[camera])
            mujoco.mju_mulQuat(turn, inverse, model.cam_quat[camera])
            mujoco.mju_quat2Vel(rotation, turn, 1.0)
            np.testing.assert_allclose(rotation, values["camera_rotation"], atol=1e-9)
        shown.append(renderer.rgb())
    renderer.close()
    assert (shown[0] != shown[1]).any()
    # The scene's own model, which all share, keeps its cameras.
    assert differing(nominal, make_episodes("JacoPush-v0").scene.drawing_model()) == {}


def test_pictures_show_the_camera_of_the_episode() -> None:
    usual = pictures("JacoPush-v0", randomization={"object_mass": 0.2})
    for name, value in (("camera_position", 0.02), ("camera_rotation", 0.05)):
        moved = pictures("JacoPush-v0", randomization={name: value})
        assert (moved != usual).mean() > 0.05


@pytest.mark.parametrize(("name", "value"), [("object_size", 0.08), ("table_height", 0.03)])
def test_pictures_show_cubes_and_table_of_the_episode(name: str, value: float) -> None:
    """As those of the option show them."""
    by_option, varied = (
        SaverGoalEnv("JacoPush-v0", "rgb_array", width=200, height=150, **options)
        for options in ({name: value}, {"randomization": {name: value}})
    )
    by_option.reset(seed=0)
    varied.reset(seed=0)
    state = by_option.episodes.get_state()
    own = varied.episodes.get_state()
    varied.episodes.set_state(replace(state, worlds=own.worlds))
    shown = [env.render() for env in (by_option, varied)]
    np.testing.assert_array_equal(*shown)
    assert (shown[0] != pictures("JacoPush-v0")).any(axis=-1).mean() > 0.01
    by_option.close()
    varied.close()
