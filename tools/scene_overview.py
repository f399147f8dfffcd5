"""Draw the overview of the tasks: ``python -m tools.scene_overview`` from the repository's root.

Writes ``docs/images/scenes.png``, one panel a task, each some steps into an episode. The same
seeds and steps give the same scenes.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from saver_envs.cameras.rendering import SceneRenderer
from saver_envs.registration import make_episodes

OUTPUT = Path("docs/images/scenes.png")
PANEL = (600, 450)  # width, height in pixels
COLUMNS = 3
STANDOFF, STEP = 0.06, 0.02  # m: of a hand behind its cube, and of an action
#: Title, id, options, seed, steps, camera.
PANELS: tuple[tuple[str, str, dict[str, Any], int, int, str], ...] = (
    ("JacoPush", "JacoPush-v0", {}, 3, 9, "three_quarter"),
    (
        "JacoPickAndPlace",
        "JacoPickAndPlace-v0",
        {"in_hand_probability": 1.0},
        8,
        6,
        "three_quarter",
    ),
    ("MicoPush", "MicoPush-v0", {}, 6, 9, "three_quarter"),
    ("DualJacoPush", "DualJacoPush-v0", {}, 5, 9, "front"),
    (
        "DualJacoDistance",
        "DualJacoDistance-v0",
        {"in_hand_probability": 1.0},
        2,
        4,
        "three_quarter",
    ),
    (
        "JacoPush, four arms round the table",
        "JacoPush-v0",
        {"n_arms": 4, "layout": "ring"},
        1,
        6,
        "three_quarter",
    ),
)


def panel(
    env_id: str, options: dict[str, Any], seed: int, steps: int, camera: str
) -> NDArray[np.uint8]:
    """Return the picture of one task, ``steps`` actions into the episode of ``seed``."""
    episodes = make_episodes(env_id, **options)
    episodes.set_generator(0, np.random.default_rng(seed))
    episodes.reset()
    has_gripper = episodes.action_size_per_arm == 4
    for _ in range(steps):
        seen, task = episodes.observation(), episodes.task
        cube = task.goal_layout.get(seen.achieved_goal, "object position")
        target = task.goal_layout.get(seen.desired_goal, "object position")
        if has_gripper:  # carry what is in the hand
            move = target - cube
        else:  # to the far side of the cube
            way = target - cube
            behind = cube - STANDOFF * way / np.linalg.norm(way, axis=-1, keepdims=True)
            move = behind - episodes.simulation.arm_state().tool_position
        actions = np.clip(move / STEP, -1, 1)
        if has_gripper:
            closed = np.full((*actions.shape[:-1], 1), -1.0)
            actions = np.concatenate([actions, closed], axis=-1)
        episodes.step(actions.reshape(1, -1))
    renderer = SceneRenderer(episodes.scene, *PANEL, camera)
    renderer.update(episodes, 0)
    picture = renderer.rgb()
    renderer.close()
    return picture


def overview() -> Image.Image:
    """Return all panels, titled, as one picture."""
    width, height = PANEL
    rows = -(-len(PANELS) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * width, rows * height))
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(size=22)
    for index, (title, env_id, options, seed, steps, camera) in enumerate(PANELS):
        corner = (index % COLUMNS * width, index // COLUMNS * height)
        sheet.paste(Image.fromarray(panel(env_id, options, seed, steps, camera)), corner)
        draw.text((corner[0] + 12, corner[1] + 8), title, fill=(20, 20, 24), font=font)
    # 255 colours are enough for scenes of few materials, and make the file small.
    return sheet.quantize(255)


def main() -> None:
    """Write the picture and say how large it is."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--output", type=Path, default=OUTPUT)
    output: Path = parser.parse_args().output
    output.parent.mkdir(parents=True, exist_ok=True)
    overview().save(output, optimize=True)
    print(f"{output}: {output.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
