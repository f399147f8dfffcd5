"""A robot from any MuJoCo model of an arm, from which limits and postures are derived."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.robots.description import COLLISION_GROUP, VISUAL_GROUP, Fingers, Robot
from saver_envs.robots.drives import add_servo, lock_joint, product

#: Name of the added site that set-points refer to.
TOOL_SITE = "saver_tool"
#: Limits of joints without limits in the model: N m, rad/s.
TORQUE_LIMIT, SPEED_LIMIT = 50.0, 1.5
#: Stiffness of our servos by torque limit: a joint that is 1/80 rad off gets all of its torque.
_STIFFNESS = 80.0
_FINGER_FORCE = 20.0  # N, N m
#: Where the tool is in the home posture (m), in the middle of the workspace.
_HOME_POINT = np.array([0.45, 0.0, 0.20])
_STARTS, _ITERATIONS, _DAMPING, _LONGEST_STEP = 60, 100, 1e-3, 0.3

Source = str | Path | Callable[[], mujoco.MjSpec]


@dataclass(frozen=True)
class ModelArm:
    """Builds an arm from a model, with our servos, gravity compensation and tool site.

    :param source: path of an MJCF file, or a function of a module that returns a specification.
    :param base_body: name of the arm's root body.
    :param tool: name of the site or body that the tool point belongs to.
    :param tool_offset: (3,) of the tool point in that frame, metres.
    :param arm_joints: from base to wrist.
    :param finger_joints: of the hand.
    :param finger_closed: where locked fingers are held, rad or m.
    :param torque_limits: one per joint, N m.
    :param tool_quaternion: (4,) of the tool's axes in that frame, w first.
    """

    source: Source
    base_body: str
    tool: str
    tool_offset: tuple[float, ...]
    arm_joints: tuple[str, ...]
    finger_joints: tuple[str, ...]
    finger_closed: float
    torque_limits: tuple[float, ...]
    tool_quaternion: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)

    def __call__(self, fingers: Fingers) -> mujoco.MjSpec:
        """Return a fresh specification of the arm."""
        spec = read_model(self.source)
        spec.nuser_actuator = -1  # as our world has it: its actuators go
        base = spec.body(self.base_body)
        base.pos, base.quat = (0, 0, 0), (1, 0, 0, 0)
        for actuator in list(spec.actuators):
            spec.delete(actuator)
        for index, geom in enumerate(spec.geoms):
            geom.name = geom.name or f"{self.base_body}_geom{index}"
            collides = bool(geom.contype or geom.conaffinity)
            geom.group = COLLISION_GROUP if collides else VISUAL_GROUP
        for body in spec.bodies:
            body.gravcomp = 1
        parent, position, quaternion = _frame(spec, self.tool)
        offset = np.zeros(3)
        mujoco.mju_rotVecQuat(offset, np.array(self.tool_offset), quaternion)
        parent.add_site(
            name=TOOL_SITE,
            pos=position + offset,
            quat=product(quaternion, np.array(self.tool_quaternion)),
            size=(0.005, 0, 0),
            group=4,
        )
        for joint, limit in zip(self.arm_joints, self.torque_limits, strict=True):
            add_servo(spec, joint, limit, _STIFFNESS * limit)
        for joint in self.finger_joints:
            if fingers is Fingers.LOCKED:
                lock_joint(spec, joint, self.finger_closed)
            else:
                add_servo(spec, joint, _FINGER_FORCE, 50 * _FINGER_FORCE)
        return spec


def robot_from_model(
    name: str,
    source: Source,
    *,
    base_body: str,
    tool: str,
    arm_joints: Sequence[str],
    finger_joints: Sequence[str] = (),
    finger_open: float = 0.0,
    finger_closed: float = 0.0,
    tool_offset: Sequence[float] = (0.0, 0.0, 0.0),
    approach: Sequence[float] = (0.0, 0.0, 1.0),
    home: Sequence[float] | None = None,
    joint_torque_limits: Sequence[float] | None = None,
    joint_speed_limits: Sequence[float] | None = None,
) -> Robot:
    """Describe an arm from its model; give the result to :func:`saver_envs.register_robot`.

    Joint limits and torque limits are the model's. Our position servos replace its actuators.
    Collision geoms are kept. The home posture has the hand pointing down over the middle of the
    workspace; the tool's axes are those of the base there.

    :param name: lower-case name of the robot.
    :param source: path of an MJCF file, or a function of a module that returns a specification.
    :param base_body: name of the arm's root body; it is put at the origin.
    :param tool: name of a site or a body of the hand.
    :param arm_joints: hinges and slides from base to wrist.
    :param finger_joints: of the hand, driven together by one gripper command.
    :param finger_open: finger joint position of an open hand, rad or m.
    :param finger_closed: finger joint position of a closed hand, rad or m.
    :param tool_offset: (3,) point between the fingertips in the frame of ``tool``, metres.
    :param approach: (3,) direction in that frame in which the hand points.
    :param home: joint positions of the home posture, rad or m; found by search if ``None``.
    :param joint_torque_limits: N m; the model's where ``None``, or 50.
    :param joint_speed_limits: rad/s; 1.5 where ``None``.
    :return: the robot.
    :raises ValueError: where the model has no such body, site or joint, limits are not as many as
        the joints, or the hand cannot point down over the workspace; the message says what is
        wrong.
    """
    spec = read_model(source)
    _require(spec, base_body, tool, (*arm_joints, *finger_joints))
    model = spec.compile()
    joints = tuple(arm_joints)
    torques = _limits("joint_torque_limits", joint_torque_limits, _torques(model, joints))
    speeds = _limits("joint_speed_limits", joint_speed_limits, (SPEED_LIMIT,) * len(joints))
    arm = ModelArm(
        source=source,
        base_body=base_body,
        tool=tool,
        tool_offset=tuple(float(one) for one in tool_offset),
        arm_joints=joints,
        finger_joints=tuple(finger_joints),
        finger_closed=finger_closed,
        torque_limits=torques,
    )
    posture = _Posture(arm(Fingers.LOCKED).compile(), joints, np.asarray(approach, dtype=float))
    holds = len(joints) >= 6
    found = np.asarray(home, dtype=float) if home is not None else posture.home(holds)
    lower, upper = _bounds(model, joints, math.inf)
    if found.shape != (len(joints),) or not ((lower <= found) & (found <= upper)).all():
        raise ValueError(
            f"home={home!r}: must have a position for each of {len(joints)} joints, within their "
            f"limits {np.round(lower, 3).tolist()} to {np.round(upper, 3).tolist()}"
        )
    return Robot(
        name=name,
        build=replace(arm, tool_quaternion=posture.tool_quaternion(found)),
        base_body=base_body,
        tool_site=TOOL_SITE,
        arm_joints=joints,
        finger_joints=arm.finger_joints,
        home=tuple(found.tolist()),
        joint_lower=tuple(lower.tolist()),
        joint_upper=tuple(upper.tolist()),
        joint_speed_limits=speeds,
        joint_torque_limits=torques,
        finger_open=finger_open,
        finger_closed=finger_closed,
        holds_orientation=holds,
        reach=posture.reach(),
        off_table_geoms=posture.on_table(found),
    )


def read_model(source: Source) -> mujoco.MjSpec:
    """Return a fresh specification.

    :param source: path of an MJCF file, or a function that returns a specification.
    :raises ValueError: for a file that is not there.
    """
    if callable(source):
        return source()
    if not Path(source).is_file():
        raise ValueError(f"source={str(source)!r}: there is no such file")
    return mujoco.MjSpec.from_file(str(source))


class _Posture:
    """Kinematics of the arm by itself, which find a home posture and derive data from it."""

    def __init__(
        self, model: mujoco.MjModel, joints: Sequence[str], approach: NDArray[np.float64]
    ) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        ids = [model.joint(joint).id for joint in joints]
        self._qpos, self._dof = model.jnt_qposadr[ids], model.jnt_dofadr[ids]
        self._lower, self._upper = _bounds(model, joints, np.pi)
        self._site = model.site(TOOL_SITE).id
        self._approach = approach / np.linalg.norm(approach)

    def _set(self, joints: NDArray[np.float64]) -> None:
        self._data.qpos[self._qpos] = joints
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)

    def tool_quaternion(self, joints: NDArray[np.float64]) -> tuple[float, ...]:
        """Return the quaternion that aligns the tool's axes with the base's in a posture."""
        self._set(joints)
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, self._data.site_xmat[self._site].reshape(3, 3).T.flatten())
        return tuple(quaternion.tolist())

    def home(self, points_down: bool) -> NDArray[np.float64]:
        """Find joints that put the tool over the workspace, links above the table.

        Of several solutions, the one nearest to the middle of the joints' ranges is returned.

        :param points_down: whether the hand has to point down there.
        :raises ValueError: where none are found.
        """
        generator = np.random.default_rng(0)
        middle, width = (self._lower + self._upper) / 2, self._upper - self._lower
        found = []
        for _ in range(_STARTS):
            joints = self._solved(generator.uniform(self._lower, self._upper), points_down)
            if joints is not None and self._data.xpos[2:, 2].min() > 0:
                found.append((float(np.square((joints - middle) / width).sum()), joints))
        if not found:
            raise ValueError(
                f"the tool cannot point down at {_HOME_POINT} m from the base: check base_body, "
                "tool and approach, or give home"
            )
        return min(found, key=lambda one: one[0])[1]

    def _solved(self, joints: NDArray[np.float64], points_down: bool) -> NDArray[np.float64] | None:
        """Iterate damped least squares from a guess; ``None`` if it does not converge."""
        jacobian = np.zeros((6, self._model.nv))
        for _ in range(_ITERATIONS):
            self._set(joints)
            way = self._data.site_xmat[self._site].reshape(3, 3) @ self._approach
            turn = np.cross(way, (0.0, 0.0, -1.0))
            if way[2] > 0.99:  # upside down, where the cross product says nothing
                turn = np.array([1.0, 0.0, 0.0])
            error = np.concatenate([_HOME_POINT - self._data.site_xpos[self._site], turn])
            rows = slice(0, 6 if points_down else 3)
            if np.abs(error[rows]).max() < 1e-4 and (way[2] < 0 or not points_down):
                return joints
            mujoco.mj_jacSite(self._model, self._data, jacobian[:3], jacobian[3:], self._site)
            part = jacobian[rows, self._dof]
            gram = part @ part.T + _DAMPING * np.eye(len(part))
            step = part.T @ np.linalg.solve(gram, error[rows])
            joints = np.clip(
                joints + np.clip(step, -_LONGEST_STEP, _LONGEST_STEP), self._lower, self._upper
            )
        return None

    def reach(self) -> float:
        """Return how far the tool gets from the base's axis, metres."""
        generator = np.random.default_rng(0)
        farthest = 0.0
        for joints in generator.uniform(self._lower, self._upper, (500, len(self._lower))):
            self._set(joints)
            farthest = max(farthest, float(np.hypot(*self._data.site_xpos[self._site, :2])))
        return farthest

    def on_table(self, joints: NDArray[np.float64]) -> tuple[str, ...]:
        """Return the geoms that reach down to the table in a posture: those that stand on it."""
        self._set(joints)
        model = self._model
        standing = []
        for index in range(model.ngeom):
            low = self._data.geom_xpos[index, 2] - model.geom_rbound[index]
            near_axis = np.hypot(*self._data.geom_xpos[index, :2]) < 0.2
            if model.geom(index).group[0] == COLLISION_GROUP and near_axis and low < 0.05:
                standing.append(model.geom(index).name)
        return tuple(standing)


def _require(spec: mujoco.MjSpec, base_body: str, tool: str, joints: Sequence[str]) -> None:
    if spec.body(base_body) is None:
        names = [body.name for body in spec.bodies]
        raise ValueError(f"base_body={base_body!r}: the model has the bodies {names}")
    if spec.site(tool) is None and spec.body(tool) is None:
        raise ValueError(f"tool={tool!r}: the model has no site and no body of that name")
    names = [joint.name for joint in spec.joints]
    for joint in joints:
        if joint not in names:
            raise ValueError(f"joint {joint!r}: the model has the joints {names}")


def _limits(
    name: str, given: Sequence[float] | None, derived: tuple[float, ...]
) -> tuple[float, ...]:
    if given is None:
        return derived
    if len(given) != len(derived) or not all(0 < one < math.inf for one in given):
        raise ValueError(
            f"{name}={given!r}: must have a positive number for each of {len(derived)} joints"
        )
    return tuple(float(one) for one in given)


def _torques(model: mujoco.MjModel, joints: Sequence[str]) -> tuple[float, ...]:
    """Torque limits as the model's actuators or joints have them, N m."""
    found = []
    for joint in joints:
        index = model.joint(joint).id
        limit = TORQUE_LIMIT
        if model.jnt_actfrclimited[index]:
            limit = float(np.abs(model.jnt_actfrcrange[index]).max())
        for actuator in range(model.nu):
            if model.actuator_trnid[actuator, 0] == index and model.actuator_forcelimited[actuator]:
                limit = float(np.abs(model.actuator_forcerange[actuator]).max())
        found.append(limit)
    return tuple(found)


def _bounds(
    model: mujoco.MjModel, joints: Sequence[str], unlimited: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return lower and upper joint limits; those of continuous joints are -/+ ``unlimited``."""
    ids = [model.joint(joint).id for joint in joints]
    limited = model.jnt_limited[ids].astype(bool)[:, None]
    lower, upper = np.where(limited, model.jnt_range[ids], (-unlimited, unlimited)).T
    return lower, upper


def _frame(
    spec: mujoco.MjSpec, name: str
) -> tuple[mujoco.MjsBody, NDArray[np.float64], NDArray[np.float64]]:
    """Return a body and where a site or the body itself lies in it."""
    site = spec.site(name)
    if site is None:
        return spec.body(name), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    # Sites may be given by Euler angles, which the compiler resolves.
    model = spec.copy().compile()
    index = model.site(name).id
    return site.parent, model.site_pos[index].copy(), model.site_quat[index].copy()
