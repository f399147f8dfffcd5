"""Straightening limbs: what laying arms or legs of a limp person straight has in common."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.control import Workspace, length
from saver_envs.people.contact_forces import FORCE_COSTS, TORQUE_COSTS
from saver_envs.people.limp_limbs import LimpLimbs
from saver_envs.people.manikin import SIDES
from saver_envs.scenes import Arms, Scene, add_target
from saver_envs.simulation import ArmState, Simulation
from saver_envs.tasks.arm_and_object import HAND_PARTS, OBJECT_PARTS, hand_parts, object_parts
from saver_envs.tasks.care import CareTask
from saver_envs.tasks.care_starts import CareStart
from saver_envs.tasks.contract import Bools, FloatArray, Memory, Seen
from saver_envs.tasks.hand_force import FORCE, HandForces, add_force_sensors
from saver_envs.tasks.layout import Part
from saver_envs.validation import require
from saver_envs.world import draw_box

#: What a radian of a limb's bend weighs in the dense reward (m).
BEND_WEIGHT: Final = 0.1
#: Further entries of ``info``.
READINGS: Final = (
    "`info` also has `force_<part>` (N) and `torque_<joint>` (N m), the greatest of four samples a "
    "step; [A limp person](../limp-person.md) explains them."
)
#: Colour of what the bases stand on.
_STEEL: Final = (0.55, 0.57, 0.60)
_END: Final = OBJECT_PARTS[0]


@dataclass(frozen=True)
class StraightenStart(CareStart):
    """A start of one episode.

    :param target: (arms, 3) where the limbs' ends are to be, in the base frames, metres.
    """

    target: NDArray[np.float64]


@dataclass(frozen=True)
class StraightenTask(CareTask):
    """Base of tasks in which two arms lay two limbs of a person straight.

    A subclass says which limbs, how straight, and where hands and set-points may be. Its starts
    are :class:`StraightenStart`.
    """

    summed: ClassVar[tuple[str, ...]] = (*FORCE_COSTS, *TORQUE_COSTS)
    hard: ClassVar[tuple[str, ...]] = (*FORCE_COSTS, *TORQUE_COSTS)
    table_height = -0.45  # on which the bed stands

    #: Which limbs.
    limbs: ClassVar[type[LimpLimbs]]
    #: Greatest bend of a straight limb (rad).
    straight: ClassVar[float]
    #: Set-points, in the frames of the bases (m).
    lower: ClassVar[tuple[float, float, float]]
    upper: ClassVar[tuple[float, float, float]]
    #: Distance of the posts under the arms from the middle of the scene (m).
    posts: ClassVar[float]

    def __post_init__(self) -> None:
        super().__post_init__()
        one = f"exactly 2, one for each {self.limbs.limb}"
        require("n_arms", self.n_arms, self.n_arms == 2, one)

    @property
    def bend(self) -> Part:
        """How bent a limb is."""
        return Part(f"{self.limbs.joints[1]} bend", 1, "rad")

    @property
    def observation(self) -> tuple[Part, ...]:
        """Each arm's hand, its force, and the limb at its side; the object is the limb's end."""
        inner = (Part(f"{name} position", 3, "m") for name in self.limbs.joints[:2])
        return (*HAND_PARTS, *OBJECT_PARTS, *inner, self.bend, FORCE)

    @property
    def goal(self) -> tuple[Part, ...]:
        """Where the limb's end is, and how bent the limb is."""
        return _END, self.bend

    @property
    def sides(self) -> tuple[str, str]:
        """Sides of the limbs at the robot's arms."""
        return self.limbs.sides

    @property
    def joint_parts(self) -> Mapping[str, tuple[str, ...]]:
        """Which parts are positions of joints, and the bend; see the base class."""
        inner, middle, end = self.limbs.joints
        places = {_END.name: end, f"{inner} position": inner, f"{middle} position": middle}
        return {**{part: (one,) for part, one in places.items()}, self.bend.name: self.limbs.joints}

    # ---------------------------------------------------------------- the scene

    def build(self, spec: mujoco.MjSpec, arms: Arms, variant: int, decorated: bool) -> None:
        """Add bed and person, what measures them, targets, and what the arms stand on."""
        super().build(spec, arms, variant, decorated)
        self.limbs.add_sensors(spec)
        add_force_sensors(spec, arms)
        for index in range(arms.n):
            add_target(spec, index, 0.03, (0.5, 0.1 * index, 0.0))
        if decorated:
            self._add_stands(spec, float(arms.position[-1, 1]))

    def _add_stands(self, spec: mujoco.MjSpec, base: float) -> None:
        """Draw a post for each arm, with a plate under its base.

        :param base: distance of the bases from the middle of the scene, metres.
        """
        inner = base - 0.06
        middle, half = (self.posts + inner) / 2, (self.posts - inner) / 2 + 0.03
        height = -self.table_height / 2
        for side in (-1, 1):
            plate, post = (0.0, side * middle, -0.011), (0.0, side * self.posts, -height)
            draw_box(spec.worldbody, plate, (0.06, half, 0.01), _STEEL)
            draw_box(spec.worldbody, post, (0.03, 0.03, height), _STEEL)

    def workspace(self, arms: Arms) -> Workspace:
        """Return where set-points may be."""
        lower, upper = (np.tile(one, (arms.n, 1)) for one in (self.lower, self.upper))
        return Workspace(lower, upper)

    # ---------------------------------------------------------------- episodes

    def observe(self, simulation: Simulation, memory: Memory, arms: ArmState) -> Seen:
        """Return hands, and the joints of the person's limbs."""
        limbs = simulation.keep(self.limbs)
        seen = hand_parts(simulation, arms) | object_parts(arms, limbs.ends())
        places = {f"{name} position": limbs.places(name) for name in limbs.joints[:2]}
        forces = simulation.keep(HandForces).observed()
        return seen | places | forces | {self.bend.name: limbs.bends()}

    def achieved(self, simulation: Simulation, memory: Memory, seen: Seen) -> NDArray[np.float64]:
        """Return ends of limbs, each in its arm's base frame, metres, and bends, radians."""
        parts = [seen[_END.name], seen[self.bend.name]]
        return np.concatenate(parts, axis=-1).reshape(simulation.n, -1)

    def desired(self, starts: Sequence[StraightenStart]) -> NDArray[np.float64]:
        """Return where the ends are to be; limbs are to be straight."""
        return _goals(np.stack([start.target for start in starts]))

    def targets_from(self, joints: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        """Return where the limbs' ends are to be (arms, 3), world frame, metres.

        :param joints: of :func:`joint_places` -> (3,) where they are, world frame, metres.
        """
        raise NotImplementedError

    def goal_from(
        self, joints: Mapping[str, NDArray[np.float64]], scene: Scene
    ) -> NDArray[np.float64]:
        """Return where ends are to be, and straight limbs; see the base class."""
        count = len(next(iter(joints.values())))
        rows = ({name: at[row] for name, at in joints.items()} for row in range(count))
        return _goals(scene.to_bases(np.stack([self.targets_from(row) for row in rows])))

    # ---------------------------------------------------------------- reward

    def distances(self, achieved: FloatArray, desired: FloatArray) -> FloatArray:
        """Return each end's distance to its target (..., arms), metres."""
        return length(self.goal_layout.get(achieved - desired, _END.name))

    def reward_and_reached(
        self, achieved: FloatArray, desired: FloatArray
    ) -> tuple[NDArray[np.float32], Bools]:
        """Return rewards and where the goal is reached; see the base class."""
        distances = self.distances(achieved, desired)
        bends = np.abs(self.goal_layout.get(achieved - desired, self.bend.name)[..., 0])
        laid = (distances <= self.success_threshold) & (bends <= self.straight)
        reached: Bools = np.logical_and.reduce(laid, axis=-1)
        if self.reward_type == "sparse":
            return reached.astype(np.float32) - np.float32(1), reached
        return -(distances + BEND_WEIGHT * bends).sum(axis=-1).astype(np.float32), reached

    # ---------------------------------------------------------------- pictures and the page

    def targets(self, scene: Scene, goal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where the ends are to be (n, arms, 3), world frame."""
        return scene.to_world(self.goal_layout.get(goal, _END.name))

    def success_text(self) -> str:
        """Return when an episode succeeds, a clause."""
        _, middle, end = self.limbs.joints
        return (
            f"each {end} is within {100 * self.success_threshold:g} cm of its target, each "
            f"{middle} is bent by at most {math.degrees(self.straight):.0f} degrees, and no part "
            "of the person was ever pressed, and no joint ever pushed against the end of its "
            "range, beyond its limit"
        )

    def dense_text(self) -> str:
        """Return what the dense reward is, a clause."""
        _, middle, end = self.limbs.joints
        return (
            f"minus the sum of the {end}s' distances to their targets, in metres, and of a "
            f"{1 / BEND_WEIGHT:.0f}th of the {middle}s' bends, in radians."
        )

    def goal_text(self) -> dict[str, str]:
        """Return what the parts of the goal mean."""
        _, middle, end = self.limbs.joints
        return {
            _END.name: f"centre of the {end} (achieved), its target (desired)",
            self.bend.name: f"angle of the {middle} (achieved), 0 (desired)",
        }


def _goals(targets: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return goals (k, goal size) of ends (k, arms, 3) of straight limbs."""
    straight = np.zeros((*targets.shape[:-1], 1))
    return np.concatenate([targets, straight], axis=-1).reshape(len(targets), -1)


def joint_places(data: mujoco.MjData, limbs: type[LimpLimbs]) -> dict[str, NDArray[np.float64]]:
    """Return name -> (3,) of the joints from which targets follow, world frame, metres.

    :param data: of a person in a pose.
    :param limbs: that are to be straight.
    """
    names = [f"{side}_{joint}" for side in SIDES for joint in {*limbs.joints, "hip"}]
    return {name: np.asarray(data.site(f"joint_{name}").xpos) for name in names}


def end_target(
    joints: Mapping[str, NDArray[np.float64]],
    limbs: type[LimpLimbs],
    side: str,
    aside: float,
    slack: float,
    height: float,
) -> NDArray[np.float64]:
    """Return where the end of a limb is to be (3,), world frame, metres.

    It is as far down the body as the nearly straight limb reaches.

    :param joints: see :func:`joint_places`.
    :param limbs: whose end it is.
    :param side: ``left`` or ``right``.
    :param aside: distance of the target from the person's middle line, metres.
    :param slack: bend of the limb with which its end is at its target, radians.
    :param height: of the target, metres.
    """
    chain = [joints[f"{side}_{name}"] for name in limbs.joints]
    lengths = [math.dist(*ends) for ends in pairwise(chain)]
    reach = math.cos(slack / 2) * sum(lengths)
    hips = [joints[f"{one}_hip"][:2] for one in SIDES]
    leftwards = (hips[0] - hips[1]) / math.dist(*hips)
    footwards = np.array([leftwards[1], -leftwards[0]])
    outwards = leftwards if side == "left" else -leftwards
    inner = chain[0][:2] - (hips[0] + hips[1]) / 2
    across, drop = aside - inner @ outwards, chain[0][2] - height
    along = inner @ footwards + math.sqrt(max(reach**2 - across**2 - drop**2, 0.0))
    level = (hips[0] + hips[1]) / 2 + aside * outwards + along * footwards
    return np.array([*level, height])
