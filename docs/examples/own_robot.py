"""An arm that is not ours, driven through push: the Franka of the gymnasium-robotics wheel.

saver evaluate --env own_robot:FrankaPush-v0 --policy expert
"""

from pathlib import Path

import gymnasium_robotics
import mujoco

from saver_envs import register_robot, register_task
from saver_envs.robots.from_model import robot_from_model
from saver_envs.tasks.push import Push

FOLDER = Path(gymnasium_robotics.__file__).parent / "envs/assets/kitchen_franka/franka_assets"
MODEL = """
<mujoco>
  <include file="assets.xml"/>
  <worldbody><include file="chain.xml"/></worldbody>
</mujoco>"""


def franka() -> mujoco.MjSpec:
    """Read the arm's model; the meshes lie where its includes do not look for them."""
    meshes = FOLDER / "meshes"
    return mujoco.MjSpec.from_string(
        MODEL,
        include={name: (FOLDER / name).read_bytes() for name in ("assets.xml", "chain.xml")},
        assets={str(path.relative_to(meshes)): path.read_bytes() for path in meshes.rglob("*.stl")},
    )


FRANKA = register_robot(
    robot_from_model(
        "franka",
        franka,
        base_body="panda0_link0",
        tool="end_effector",
        tool_offset=(0.0, 0.0, 0.04),  # between the fingertips
        arm_joints=[f"robot:panda0_joint{index}" for index in range(1, 8)],
        finger_joints=[f"robot:panda0_finger_joint{index}" for index in (1, 2)],
        finger_open=0.04,
        finger_closed=0.0,
        # The maker's limits, which this model does not have.
        joint_torque_limits=[87.0] * 4 + [12.0] * 3,
        joint_speed_limits=[2.175] * 4 + [2.61] * 3,
    )
)
register_task(Push, "FrankaPush", robot=FRANKA.name, n_arms=1)
