"""A task of your own: two arms push one beam, which neither could keep straight alone.

saver evaluate --env own_task:DualJacoBeam-v0 --policy expert
saver train --env own_task:DualJacoBeam-v0 --output runs/beam
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from saver_envs import Part, Start, Task, TaskPage, register_task
from saver_envs.control import Workspace
from saver_envs.reachability import reachability_map
from saver_envs.robots.description import Fingers
from saver_envs.scenes import OBJECT_BIT, add_target, free_bodies
from saver_envs.simulation import rotate_by_quaternion
from saver_envs.tasks.arm_and_object import HAND_PARTS, hand_parts
from saver_envs.world import TABLE_BIT

HALF = np.array([0.03, 0.28, 0.03])  # m, of the beam, which lies along y
ENDS = HALF * [[0, -1, 0], [0, 1, 0]]  # (2, 3) from its middle, in its own frame
HAND_HEIGHT, BEHIND = 0.025, 0.08  # m


@dataclass(frozen=True)
class BeamStart(Start):
    """Where the beam starts, and where its ends are to be."""

    beam: np.ndarray  # (7,) position and quaternion, world frame
    ends: np.ndarray  # (2, 3), world frame


@dataclass(frozen=True)
class Beam(Task):
    """Both ends of the beam to their targets, hands closed and held low."""

    name = "beam"
    fingers = Fingers.LOCKED  # the hand is closed, the action has no gripper
    held_height = HAND_HEIGHT  # set-points stay at this height; None: the action sets it
    expert = "own_task:BeamExpert"
    resting = ("beam",)  # geoms that may touch the table at the start
    observation = (
        *HAND_PARTS,
        Part("beam ends", 6, "m", shared=True),
        Part("beam velocity", 6, "m/s, rad/s", scale=0.2, shared=True),
    )
    goal = (Part("beam ends", 6, "m", shared=True),)

    def build(self, spec, arms, variant, decorated):
        beam = spec.worldbody.add_body(name="beam", pos=(0.4, 0, HALF[2]))
        beam.add_freejoint()
        bits = {"contype": OBJECT_BIT, "conaffinity": TABLE_BIT | OBJECT_BIT}
        box = mujoco.mjtGeom.mjGEOM_BOX
        friction = (0.5, 0.02, 0.001)
        beam.add_geom(name="beam", type=box, size=HALF, mass=0.5, friction=friction, **bits)
        for index in range(2):
            add_target(spec, index, HALF[2], (0.5, 0.2 * index, HALF[2]))

    def workspace(self, arms):
        return Workspace(np.tile([0.25, -0.35, 0.02], (2, 1)), np.tile([0.60, 0.35, 0.40], (2, 1)))

    def sample(self, generator, scene):
        middle = generator.uniform([0.36, -0.05, HALF[2]], [0.40, 0.05, HALF[2]])
        goal = middle + generator.uniform([0.10, 0, 0], [0.14, 0, 0])
        yaw = generator.uniform(-0.15, 0.15)
        turned = [[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]
        hand = scene.to_bases(middle + 0.8 * ENDS - [BEHIND, 0, 0])
        hand[:, 2] = HAND_HEIGHT
        return BeamStart(hand, np.array([*middle, 1, 0, 0, 0]), goal + ENDS @ np.transpose(turned))

    def place(self, simulation, memory, rows, starts):
        hands = np.stack([start.hand for start in starts])
        joints = reachability_map(simulation.scene.robot).postures_at(hands.reshape(-1, 3))
        simulation.reset(rows, joints.reshape(len(rows), 2, -1), np.zeros((len(rows), 2, 0)))
        simulation.qpos[rows[:, None], addresses(simulation).qpos[0]] = [one.beam for one in starts]
        simulation.refresh(rows)

    def observe(self, simulation, memory, arms):
        pose = simulation.qpos[:, None, addresses(simulation).qpos[0]]
        ends = pose[..., :3] + rotate_by_quaternion(pose[..., 3:], ENDS)
        velocity = simulation.qvel[:, addresses(simulation).dof[0]]
        beam = {"beam ends": ends.reshape(-1, 6), "beam velocity": velocity}
        return hand_parts(simulation, arms) | beam

    def achieved(self, simulation, memory, seen):
        return seen["beam ends"]

    def desired(self, starts):
        return np.stack([start.ends.ravel() for start in starts])

    def distances(self, achieved, desired):
        gap = (achieved - desired).reshape(*achieved.shape[:-1], 2, 3)
        return np.sqrt((gap * gap).sum(axis=-1))

    def targets(self, scene, goal):
        return goal.reshape(-1, 2, 3)

    def page(self, scene):
        return TaskPage(succeeds="both ends of the beam are within 5 cm of their targets")


def addresses(simulation):
    return free_bodies(simulation.scene, ("beam",))


class BeamExpert:
    """Both hands push the ends ahead of them, the one that is farther from its target faster."""

    def __init__(self, task, settings, coordinated, free_arm):
        self.task, self.step = task, settings.max_speed * 0.04

    def predict(self, observation, deterministic=True):
        left = observation["desired_goal"] - observation["achieved_goal"]
        motion = np.zeros((*left.shape[:-1], 2, 3))
        motion[..., 0] = np.clip(0.3 * left[..., [0, 3]] / self.step, 0, 0.5)
        return motion.reshape(*left.shape).astype(np.float32), None


register_task(Beam, "DualJacoBeam", robot="jaco", n_arms=2)
