"""Forces on the parts of a person's body, and torques at the ends of the joints' ranges.

The limits of force are those of ISO/TS 15066:2016, table A.2, for contacts that last half a second;
a shorter one may press twice as hard, except on skull and face. What counts are the forces of what
presses a person: robots, rails, and, on trunk, head and thighs, the person's own arms. What the
person lies on does not count. Forces and torques are sampled at 100 Hz, and an action has the
greatest of its samples.

:func:`add_load_sensors` measures them, :func:`load_memory` is what a task remembers of them, and
:meth:`PersonLoads.readings` returns the entries of ``info``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.people.limp_joints import PASSIVE_JOINTS, joint_names
from saver_envs.people.manikin import SIDES
from saver_envs.simulation import Simulation
from saver_envs.validation import require

Arrays = dict[str, NDArray[Any]]

FORCE_LIMITS: Final = {
    "skull": 130.0,
    "face": 65.0,
    "neck": 150.0,
    "back": 210.0,
    "chest": 140.0,
    "abdomen": 110.0,
    "pelvis": 180.0,
    "upper_arm": 150.0,
    "forearm": 160.0,
    "hand": 140.0,
    "thigh": 220.0,
    "lower_leg": 130.0,
}
"""Part of the body -> greatest force of a lasting contact, N."""
#: A contact lasts from this time on (s); until then it may press so many times as hard.
LASTING, TRANSIENT_FACTOR = 0.5, 2.0
#: Parts on which it may not.
NEVER_MORE: Final = ("skull", "face")
#: Joint of a model, without prefix -> the joint of the body that it belongs to, and the greatest
#: torque against the end of its range, N m.
_TORQUE_LIMITS: Final = {
    name: (joint.group, joint.torque_limit)
    for joint in PASSIVE_JOINTS
    for name in joint_names(joint)
}
#: Names of the costs, without ``cost_``.
FORCE_COSTS: Final = tuple(f"force_{part}" for part in FORCE_LIMITS)
TORQUE_COSTS: Final = tuple(
    dict.fromkeys(f"torque_{group}" for group, _ in _TORQUE_LIMITS.values())
)
#: Capsules of the parts that share a body with others.
_CAPSULES: Final = {
    "skull": ("skull_0",),
    "face": ("face_0",),
    "neck": ("neck_0",),
    "back": ("back_0", "back_1"),
    "chest": ("chest_0", "chest_1"),
    "abdomen": ("abdomen_0",),
}
#: A lower leg is a shank with its foot.
_BODIES: Final = {"lower_leg": "shank"}
#: The strongest contacts between two things whose normal forces are added up.
_CONTACTS: Final = 3
#: Less force than this (N) is no contact; times are equal that differ by less than this (s).
_LEAST_FORCE, _BRIEF = 1.0, 1e-6
#: First parts of the sensors' names.
_FORCE, _TORQUE = "part_force_", "limit_torque_"
_READING: Final = (1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 2, _CONTACTS)
_GEOM, _BODY = mujoco.mjtObj.mjOBJ_GEOM, mujoco.mjtObj.mjOBJ_BODY
_SUBTREE: Final = mujoco.mjtObj.mjOBJ_XBODY


def _places() -> dict[str, tuple[str, mujoco.mjtObj, tuple[str, ...]]]:
    """Return place -> part, and kind and names of what it consists of.

    A place is a part, or a part at one side.
    """
    places: dict[str, tuple[str, mujoco.mjtObj, tuple[str, ...]]] = {}
    for part in FORCE_LIMITS:
        if part in _CAPSULES:
            places[part] = part, _GEOM, _CAPSULES[part]
        elif part == "pelvis":
            places[part] = part, _BODY, (part,)
        else:
            kind = _SUBTREE if part in _BODIES else _BODY
            for side in SIDES:
                places[f"{side}_{part}"] = part, kind, (f"{side}_{_BODIES.get(part, part)}",)
    return places


_PLACES: Final = _places()
_PARTS: Final = tuple(part for part, _, _ in _PLACES.values())
_LASTING_LIMITS: Final = np.array([FORCE_LIMITS[part] for part in _PARTS])
_TRANSIENT_LIMITS: Final = _LASTING_LIMITS * [
    1.0 if part in NEVER_MORE else TRANSIENT_FACTOR for part in _PARTS
]
_LARGEST_TORQUES: Final = np.array([limit for _, limit in _TORQUE_LIMITS.values()])


def _columns(costs: Sequence[str], subjects: Iterable[str]) -> dict[str, list[int]]:
    """Return which of the places or joints a cost is about."""
    names = list(subjects)
    return {
        cost: [index for index, name in enumerate(names) if cost.endswith(f"_{name}")]
        for cost in costs
    }


_COLUMNS_OF_FORCE: Final = _columns(FORCE_COSTS, _PARTS)
_COLUMNS_OF_TORQUE: Final = _columns(TORQUE_COSTS, (group for group, _ in _TORQUE_LIMITS.values()))


def add_load_sensors(spec: mujoco.MjSpec, pressers: Sequence[str], prefix: str = "") -> None:
    """Measure forces on a person's parts, and torques at the ends of the joints' ranges.

    :param spec: with a person; gets the sensors.
    :param pressers: names of bodies, such as a robot's base, that press with all that is below
        them; or of geoms of the world, such as a rail.
    :param prefix: of the person's names.
    """
    bodies = {body.name for body in spec.bodies}
    everywhere = [(name, _SUBTREE if name in bodies else _GEOM) for name in pressers]
    own = [(f"{prefix}{side}_upper_arm", _SUBTREE) for side in SIDES]
    for place, (part, other, names) in _PLACES.items():
        reached = part in _CAPSULES or part in ("pelvis", "thigh")
        for presser, kind in [*everywhere, *(own if reached else ())]:
            for name in names:
                spec.add_sensor(
                    name=f"{_FORCE}{prefix}{place}/{presser}/{name}",
                    type=mujoco.mjtSensor.mjSENS_CONTACT,
                    objtype=kind,
                    objname=presser,
                    reftype=other,
                    refname=prefix + name,
                    intprm=_READING,
                )
    for name in _TORQUE_LIMITS:
        spec.add_sensor(
            name=f"{_TORQUE}{prefix}{name}",
            type=mujoco.mjtSensor.mjSENS_JOINTLIMITFRC,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=prefix + name,
        )


def load_memory(n: int) -> Arrays:
    """Return what has to be remembered of n people between actions.

    :return: ``contact_since`` (n, places), the time before the present contact began, s.
    """
    return {"contact_since": np.zeros((n, len(_PLACES)))}


class PersonLoads:
    """Forces and torques on the person of every simulation.

    :param simulation: of a scene with :func:`add_load_sensors`, that keeps peaks.
    :param prefix: of the person's names.
    """

    def __init__(self, simulation: Simulation, prefix: str = "") -> None:
        self._simulation = simulation
        model = simulation.scene.model
        normals: dict[tuple[str, str], list[int]] = {}
        for index in range(model.nsensor):
            name, address = model.sensor(index).name, int(model.sensor_adr[index])
            if name.startswith(_FORCE + prefix):
                place, presser, _ = name.removeprefix(_FORCE + prefix).split("/")
                if place in _PLACES:  # else of a person with a longer prefix
                    # The normal comes first of three.
                    of_contacts = address + 3 * np.arange(_CONTACTS)
                    normals.setdefault((place, presser), []).extend(of_contacts.tolist())
        require("simulation", simulation, bool(normals), "of a scene with add_load_sensors")
        # Sensors of a pair of place and presser follow one another, and so do pairs of a place.
        counts = [len(normals[pair]) for pair in normals]
        self._normals = np.concatenate(list(normals.values()))
        self._pair_starts = np.cumsum([0, *counts[:-1]])
        places = [place for place, _ in normals]
        self._place_starts = np.array([places.index(place) for place in _PLACES])
        torques = [model.sensor(f"{_TORQUE}{prefix}{name}").adr[0] for name in _TORQUE_LIMITS]
        self._torques = np.array(torques, dtype=np.intp)

    def forces(self) -> NDArray[np.float64]:
        """Return the greatest force on each place, (n, places), N, in the last action.

        It is the greatest of what presses there: the sum of the normal forces of its strongest
        contacts. A grasp presses from two sides, which are both counted.
        """
        normals = self._simulation.peaks.take(self._normals, 1)
        pairs = np.add.reduceat(normals, self._pair_starts, axis=1)
        return np.maximum.reduceat(pairs, self._place_starts, axis=1)

    def readings(self, memory: Arrays) -> dict[str, NDArray[np.float64]]:
        """Return forces (N), torques (N m), and costs, (n,) each.

        ``force_<part>`` is the greatest sample of an action, of either side; ``cost_force_<part>``
        is 1 where it is above the limit: that of a lasting contact once it has lasted so long.
        ``torque_<joint>`` is the greatest torque against the end of a range;
        ``cost_torque_<joint>`` is 1 where one of that joint's torques is above its limit.

        :param memory: see :func:`load_memory`; updated. Calling this twice after an action changes
            nothing.
        """
        force, since = self.forces(), memory["contact_since"]
        now = self._simulation.time[:, None]
        since[:] = np.where(force >= _LEAST_FORCE, since, now)
        lasting = now - since >= LASTING - _BRIEF
        above = force > np.where(lasting, _LASTING_LIMITS, _TRANSIENT_LIMITS)
        torque = self._simulation.peaks.take(self._torques, 1)
        measured: dict[str, NDArray[np.float64]] = {}
        for columns_of, values, excess in (
            (_COLUMNS_OF_FORCE, force, above),
            (_COLUMNS_OF_TORQUE, torque, torque > _LARGEST_TORQUES),
        ):
            for cost, columns in columns_of.items():
                measured[cost] = np.maximum.reduce(values[:, columns], axis=1)
                exceeds = np.logical_or.reduce(excess[:, columns], axis=1)
                measured[f"cost_{cost}"] = exceeds.astype(np.float64)
        return measured
