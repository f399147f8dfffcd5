"""A limp person: free bodies under gravity that lie, roll and are carried by contact alone.

How tasks use it:

- **Build**: ``add_limp_person(spec, person)`` in a task's ``build``, ``add_bed(spec, bed)`` of
  :mod:`saver_envs.people.bed`, and ``add_load_sensors(spec, pressers)`` of
  :mod:`saver_envs.people.contact_forces`. A task whose ``variants`` are the persons of
  :data:`saver_envs.people.limp_people.PEOPLE` passes ``PEOPLE[variant]``.
- **Draw and settle**: :func:`saver_envs.people.lying_starts.drawn_supine` draws a posture,
  :meth:`saver_envs.people.lying.LyingWorld.laid` lets the person fall into it, on the same bed and
  without the robots, and returns the person's 35 numbers at rest.
- **Place**: ``simulation.keep(LimpPeople)`` of :mod:`saver_envs.people.limp_people`: ``give``
  writes bodies, stiffness and friction into the models, ``lay`` the numbers into ``qpos``,
  ``angles`` reads hinges.
- **Check**: a start is valid where no pair of ``simulation.contacts_of`` has a geom of an arm.
- **Read**: ``simulation.keep(PersonLoads).readings(memory)`` returns forces, torques and their
  costs; the task's memory has :func:`saver_envs.people.contact_forces.load_memory`, and its class
  ``keeps_peaks = True``.

The table of a scene is a plane without end: give it a ``table_height`` below the bed's, or lay the
person on it and leave the bed out. The pelvis has a free joint, so that a task which conveys a
person off the table needs ``keeps_to_table = False``.

Names in the model, each behind ``prefix``:

- bodies ``pelvis`` (with the free joint ``person``), ``torso`` and ``head``; and ``upper_arm``,
  ``forearm``, ``hand``, ``thigh``, ``shank`` and ``foot`` behind ``left_`` or ``right_``. ``torso``
  is thorax and abdomen; it twists and bends against the pelvis.
- joints of :data:`saver_envs.people.limp_joints.PASSIVE_JOINTS`: ``spine_twist``, ``left_knee``.
  Hinges count anatomical angles from the straight posture, radians. Shoulders are balls, whose zero
  is the middle of their range: set them with :class:`saver_envs.people.lying.PersonLayout`.
- capsules of :mod:`saver_envs.people.body_parts`: ``chest_0``, ``chest_1``, ``left_shank_0``.
- sites ``joint_left_wrist`` and so on, as those of the manikin.

The frame is that of :mod:`saver_envs.people.manikin`: x to the feet, y to the person's left, z to
the front, which is up for a person on the back.

What is not modelled: forearms do not turn about their long axis, shoulder blades do not glide,
fingers and toes are stiff, flesh is as hard as contacts are, knees and elbows have one axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.people.anthropometry import SEXES, Inertia, Sex
from saver_envs.people.limp_body import LimpBody, limp_body
from saver_envs.people.limp_frames import shoulder_centre
from saver_envs.people.limp_joints import PassiveJoint, joints_of
from saver_envs.people.manikin import SIDES, add_skeleton_sites, parent_body, segment
from saver_envs.people.physique import heaviness_of
from saver_envs.people.rotations import Rotation, quaternion_of
from saver_envs.people.surface import AVERAGE_MAN, Appearance, add_skins
from saver_envs.robots.description import COLLISION_GROUP
from saver_envs.scenes import OBJECT_BIT
from saver_envs.validation import require, require_kind
from saver_envs.world import TABLE_BIT

#: Name of the free joint.
ROOT_JOINT: Final = "person"
#: Torsional and rolling friction of all capsules, m; ours.
_OTHER_FRICTION: Final = (0.01, 0.001)
#: The person's friction takes precedence over that of robots and tables; a bed's over the person's.
PERSON_PRIORITY: Final = 1
#: Stiffness of friction against that of contacts: with 10, limbs at rest creep by centimetres in a
#: minute.
LEAST_IMPRATIO: Final = 100.0
#: Rotor inertia of all joints, kg m^2: keeps light hands stable, a tenth of a hand's own inertia.
_ARMATURE: Final = 0.0003
#: Bodies that overlap or touch at rest, besides parents and children; ``side`` is either.
_APART: Final = (
    ("head", "side_upper_arm"),
    ("torso", "side_thigh"),
    ("side_hand", "side_upper_arm"),
)
#: Mean and deviation of the stature (m) of women and of men, ours.
_STATURE: Final[dict[Sex, tuple[float, float]]] = {"female": (1.64, 0.065), "male": (1.77, 0.07)}


@dataclass(frozen=True)
class LimpPerson:
    """Who is handled.

    :param sex: ``female`` or ``male``: shape, and shares of mass.
    :param height: 1.55 to 1.90 m.
    :param bmi: body mass index, 18.5 to 35 kg/m^2.
    :param stiffness: factor of the joints' stiffness and damping, 0.3 to 3.
    :param friction: sliding friction of clothes and skin with what they touch, 0.05 to 1.5.
    :raises ValueError: for a value out of its range.
    """

    sex: Sex = "male"
    height: float = 1.75
    bmi: float = 24.0
    stiffness: float = 1.0
    friction: float = 0.5

    def __post_init__(self) -> None:
        require("sex", self.sex, self.sex in SEXES, "'female' or 'male'")
        for name, (least, greatest, unit) in LIMITS.items():
            value = getattr(self, name)
            require_kind(name, value, float)
            within = least <= value <= greatest
            require(name, value, within, f"{least:g} to {greatest:g} {unit}".rstrip())

    @classmethod
    def drawn(cls, generator: np.random.Generator) -> Self:
        """Draw a person.

        :param generator: source of randomness.
        """
        sex = SEXES[generator.integers(2)]
        mean, deviation = _STATURE[sex]
        return cls(
            sex=sex,
            height=_within("height", generator.normal(mean, deviation)),
            bmi=_within("bmi", 25.0 * math.exp(generator.normal(0.0, 0.16))),
            stiffness=math.exp(generator.uniform(math.log(0.5), math.log(2.0))),
            friction=generator.uniform(0.25, 0.6),
        )

    @property
    def mass(self) -> float:
        """Mass, kg."""
        return self.bmi * self.height**2

    @property
    def described(self) -> str:
        """Sex, height and mass in words."""
        return f"{self.sex}, {self.height:.2f} m, {self.mass:.0f} kg"

    @property
    def body(self) -> LimpBody:
        """What the body is made of."""
        return limp_body(self.sex, self.height, self.bmi)

    def dressed(self, look: Appearance = AVERAGE_MAN) -> Appearance:
        """Return what the person looks like.

        :param look: colours and cut of the clothes.
        """
        gender, heaviness = float(self.sex == "female"), heaviness_of(self.bmi)
        return replace(look, gender=gender, heaviness=heaviness, stature=self.height)


#: Least and greatest value, and unit, of the numbers of a person.
LIMITS: Final[dict[str, tuple[float, float, str]]] = {
    "height": (1.55, 1.90, "m"),
    "bmi": (18.5, 35.0, "kg/m^2"),
    "stiffness": (0.3, 3.0, ""),
    "friction": (0.05, 1.5, ""),
}


def _within(name: str, value: float) -> float:
    least, greatest, _ = LIMITS[name]
    return float(np.clip(value, least, greatest))


def add_limp_person(
    spec: mujoco.MjSpec,
    person: LimpPerson,
    position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    prefix: str = "",
    skins: bool = True,
    look: Appearance = AVERAGE_MAN,
) -> None:
    """Add a person to a specification, lying straight on the back with the feet along +x.

    :param spec: gets bodies, joints, capsules, sites and, if wanted, skins; the stiffness of its
        friction is raised to :data:`LEAST_IMPRATIO`.
    :param person: who.
    :param position: of the point between the hip joints, above what the person lies on, metres.
    :param prefix: of all names.
    :param skins: whether to add the skin and the clothes, which are only drawn.
    :param look: colours and cut of the clothes.
    """
    built = person.body
    shape = built.shape
    spec.option.impratio = max(spec.option.impratio, LEAST_IMPRATIO)
    bodies: dict[str, mujoco.MjsBody] = {}
    for name in shape.bodies:
        parent = parent_body(name)
        if parent is None:
            place = np.array(position) + shape.head(name)
            body = spec.worldbody.add_body(name=prefix + name, pos=place)
            body.add_freejoint(name=prefix + ROOT_JOINT)
        else:
            turn = built.zero[parent].T @ built.zero[name]
            if segment(name) == "upper_arm":  # the middle of the ball's range is its zero
                turn = shoulder_centre(name.split("_")[0]) @ built.zero[name]
            offset = shape.head(name) - shape.head(parent)
            body = bodies[parent].add_body(name=prefix + name, pos=offset, quat=quaternion_of(turn))
            for joint in joints_of(segment(name)):
                _add_joint(body, name, joint, built.zero[name], person, prefix)
        bodies[name] = body
        _add_inertia(body, built.inertia[name], shape.head(name))
        _add_capsules(body, name, built, person, prefix)
    add_skeleton_sites(bodies, shape, prefix)
    _exclude(spec, prefix)
    if skins:
        add_skins(spec, shape, person.dressed(look), prefix)


def _add_joint(
    body: mujoco.MjsBody,
    name: str,
    joint: PassiveJoint,
    zero: Rotation,
    person: LimpPerson,
    prefix: str,
) -> None:
    side = name.removesuffix(segment(name))
    ball = not any(joint.axis)
    axis = np.array(joint.axis)
    if side == "right_":  # turns are mirrored like this
        axis = axis * (-1, 1, -1)
    # Angles are in the specification's own unit.
    unit = 1.0 if body.compiler.degree else math.pi / 180
    kind = mujoco.mjtJoint.mjJNT_BALL if ball else mujoco.mjtJoint.mjJNT_HINGE
    body.add_joint(
        name=prefix + side + joint.name,
        type=kind,
        axis=(1, 0, 0) if ball else zero.T @ axis,
        limited=True,
        range=[unit * angle for angle in joint.range],
        springref=unit * joint.rest,
        stiffness=[person.stiffness * part for part in joint.stiffness],
        damping=(person.stiffness * joint.damping, 0, 0),
        armature=_ARMATURE,
    )


def _add_inertia(body: mujoco.MjsBody, inertia: Inertia, head: NDArray[np.float64]) -> None:
    tensor = inertia.tensor
    body.explicitinertial = True
    body.mass, body.ipos = inertia.mass, inertia.centre - head
    rows, columns = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
    body.fullinertia = tensor[rows, columns]


def _add_capsules(
    body: mujoco.MjsBody, name: str, built: LimpBody, person: LimpPerson, prefix: str
) -> None:
    counts: dict[str, int] = {}
    side = name.removesuffix(segment(name))
    start = built.shape.head(name)
    for capsule in built.capsules[name]:
        count = counts.setdefault(capsule.part, 0)
        counts[capsule.part] += 1
        body.add_geom(
            name=f"{prefix}{side}{capsule.part}_{count}",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=(*(capsule.begin - start), *(capsule.end - start)),
            size=(capsule.radius, 0, 0),
            friction=(person.friction, *_OTHER_FRICTION),
            priority=PERSON_PRIORITY,
            condim=4,
            contype=OBJECT_BIT,
            conaffinity=OBJECT_BIT | TABLE_BIT,
            group=COLLISION_GROUP,
            rgba=(0.9, 0.3, 0.2, 0.4),
        )


def _exclude(spec: mujoco.MjSpec, prefix: str) -> None:
    for side in SIDES:
        for pair in _APART:
            first, second = (name.replace("side", side) for name in pair)
            spec.add_exclude(bodyname1=prefix + first, bodyname2=prefix + second)
