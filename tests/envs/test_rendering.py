"""Pictures: skipped only where there is no off-screen graphics at all."""

from __future__ import annotations

import copy
import os
import subprocess
import sys
from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest
from rollouts import FEW_IDS

from saver_envs.cameras import off_screen
from saver_envs.envs.parallel_env import parallel_env
from saver_envs.envs.sb3_vec_env import SaverVecEnv


def graphics() -> bool:
    try:
        context = mujoco.GLContext(8, 8)
        context.make_current()
    except Exception:  # each backend raises its own
        return False
    context.free()
    return True


pytestmark = pytest.mark.skipif(not graphics(), reason="no OpenGL context to be had")

SIZE = {"width": 160, "height": 120}


@pytest.mark.parametrize("env_id", FEW_IDS)
def test_colour(env_id: str) -> None:
    env = gymnasium.make(env_id, render_mode="rgb_array", **SIZE)
    env.reset(seed=0)
    first = env.render()
    assert first.shape == (120, 160, 3)
    assert first.dtype == np.uint8
    assert first.std() > 10  # there is something to be seen
    kept = first.copy()
    for _ in range(10):
        env.step(env.action_space.sample())
    second = env.render()
    np.testing.assert_array_equal(first, kept)
    assert (first != second).any()
    env.close()


def test_depth() -> None:
    env = gymnasium.make("JacoPush-v0", render_mode="depth_array", camera_name="overhead", **SIZE)
    env.reset(seed=0)
    depth = env.render()
    assert depth.shape == (120, 160)
    assert depth.dtype == np.float32
    assert np.isfinite(depth).all()
    height = env.unwrapped.episodes.scene.model.camera("overhead").pos[2]
    table = np.median(depth)
    assert table == pytest.approx(height, abs=0.05)  # most of the picture is table
    assert depth.min() < table - 0.2  # and the arm stands above it
    env.close()


def test_without_a_render_mode_nothing_is_drawn() -> None:
    env = gymnasium.make("JacoPush-v0").unwrapped
    env.reset()
    assert env.render() is None


@pytest.mark.parametrize("camera", ["front", "three_quarter", "side", "overhead"])
def test_cameras_differ_and_show_the_targets(camera: str) -> None:
    env = gymnasium.make("JacoPush-v0", render_mode="rgb_array", camera_name=camera, **SIZE)
    env.reset(seed=0)
    before = env.render()
    env.unwrapped.episodes.goal[0, 2] += 0.15
    assert (env.render() != before).any()
    env.close()


def test_vector_pictures() -> None:
    env = gymnasium.make_vec("JacoPush-v0", num_envs=2, render_mode="rgb_array", **SIZE)
    env.reset(seed=0)
    pictures = env.render()
    assert isinstance(pictures, tuple)
    assert [picture.shape for picture in pictures] == [(120, 160, 3)] * 2
    assert (pictures[0] != pictures[1]).any()
    single = gymnasium.make("JacoPush-v0", render_mode="rgb_array", **SIZE)
    single.reset(seed=1)
    np.testing.assert_array_equal(single.render(), pictures[1])
    env.close()
    single.close()
    with pytest.raises(ValueError, match="rgb_array, depth_array"):
        gymnasium.make_vec("JacoPush-v0", num_envs=2, render_mode="human")


def test_copies_draw_on_their_own() -> None:
    env = gymnasium.make("JacoPush-v0", render_mode="rgb_array", **SIZE)
    env.reset(seed=0)
    picture = env.render()
    twin = copy.deepcopy(env)
    np.testing.assert_array_equal(twin.render(), picture)
    twin.close()
    np.testing.assert_array_equal(env.render(), picture)
    env.close()


def test_the_other_adapters() -> None:
    shared = parallel_env(env_id="DualJacoPush-v0", render_mode="rgb_array", **SIZE)
    shared.reset(seed=0)
    assert shared.render().shape == (120, 160, 3)
    shared.close()
    vector = SaverVecEnv("JacoPush-v0", 2, seed=0)
    vector.reset()
    views = [vector.picture(1, camera) for camera in ("front", "side")]
    assert views[0].shape == (480, 640, 3)
    assert (views[0] != views[1]).any()
    assert vector.render("rgb_array").ndim == 3  # tiled by SB3
    vector.close()


@pytest.mark.parametrize("name", ["width", "height"])
@pytest.mark.parametrize("value", [0, -1, 1.5, True, "64", 10**6])
def test_sizes_are_checked_before_anything_is_drawn(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"{name}={value!r}: must be"):
        gymnasium.make("JacoPush-v0", **{name: value})


HEADLESS = {"MUJOCO_GL": "", "DISPLAY": "", "WAYLAND_DISPLAY": "", "PYOPENGL_PLATFORM": ""}


def python(code: str, **environment: str) -> str:
    """Run code in a fresh interpreter on Linux without a display; return what it prints."""
    environment = {**os.environ, **HEADLESS, **environment}
    words = [sys.executable, "-c", f"import gymnasium, saver_envs\n{code}"]
    done = subprocess.run(words, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


on_linux = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is a display")
RENDER = """
env = gymnasium.make("JacoPush-v0", render_mode="rgb_array", width=64, height=48)
env.reset(seed=0)
print(env.render().std() > 10)
"""


@on_linux
def test_without_a_display_and_a_choice_pictures_work() -> None:
    assert python(RENDER) == "True"


@on_linux
def test_so_they_do_behind_a_display_that_does_not_answer() -> None:
    assert python(RENDER, DISPLAY=":12345") == "True"


@on_linux
@pytest.mark.parametrize("display", ["", ":12345"])
def test_a_window_without_a_display_is_an_error_and_not_the_end(display: str) -> None:
    code = """
for name in ("JacoPush-v0", "WristPushPixels-v0"):
    try:
        gymnasium.make(name, render_mode="human")
    except RuntimeError as error:
        print(error)
"""
    printed = python(code, DISPLAY=display)
    assert printed.count("there is no display to open a window on; use render_mode='rgb_arr") == 2


@on_linux
def test_gymnasiums_checker_draws_what_can_be_drawn() -> None:
    code = """
from gymnasium.utils.env_checker import check_env
env = gymnasium.make("JacoPush-v0").unwrapped
check_env(env)
print(env.metadata["render_modes"])
"""
    assert python(code) == "['rgb_array', 'depth_array']"


def test_where_nothing_draws_the_error_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried: list[str] = []
    for display in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(display, raising=False)
    monkeypatch.setattr(off_screen.gl_context.GLContext, "__module__", "mujoco.glfw")
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(off_screen, "_draws", tried.append)
    env = gymnasium.make("JacoPush-v0", render_mode="rgb_array", **SIZE)
    env.reset(seed=0)
    with pytest.raises(RuntimeError, match=r"none of them works here: install one.*libosmesa6"):
        env.render()
    assert tried == ["egl", "osmesa"]
    env.close()


@on_linux
def test_a_backend_that_is_not_there_does_not_draw() -> None:
    assert not off_screen._draws("nonsense")


def test_no_other_package_speaks_when_an_environment_is_made() -> None:
    code = "import gymnasium; gymnasium.make('saver_envs:JacoPush-v0').reset(seed=0)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert (done.stdout, done.stderr) == (b"", b"")
