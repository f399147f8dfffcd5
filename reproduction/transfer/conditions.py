"""What is different where a policy is tried from where it was trained: every figure, with why."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

from saver_envs.wrappers.sensor_noise import SensorNoise

OBJECT_SIZE: Final = 0.09
"""Edge of the cube in the dissertation's physical push runs (m); 5.6 cm in training."""
FRICTION: Final = 0.35
"""Of a smooth box on a smooth table; 0.5 in training. Less of it makes things slide on."""
MASS: Final = 0.4
"""Kilograms, twice that of training: a filled box instead of an empty one."""
DAMPING: Final = 1.0
"""N s/m; 0 in training. At the hand's top speed of 0.5 m/s it drags half as much as the friction of
a cube of the training, a third as much as that of one with the two figures above.
"""

TRAINED_ON: Final = "jaco"
"""The robot whose hand the policies know."""


@dataclass(frozen=True)
class Condition:
    """One setting in which policies are tried.

    :param name: what tables and the command line call it
    :param words: what differs
    :param robot: name of the arm
    :param options: keyword arguments of the environment
    :param noise: of the sensors, or None
    :param translated: finger readings are told in the angles of the hand of the training
    :param expert: whether the scripted expert, which is slow, is tried here too
    """

    name: str
    words: str
    robot: str = "mico"
    options: dict[str, Any] = field(default_factory=dict)
    noise: SensorNoise | None = None
    translated: bool = True
    expert: bool = False


_CHANGES: Final[dict[str, Any]] = {
    "object_friction": FRICTION,
    "object_mass": MASS,
    "object_damping": DAMPING,
}
_SIZE: Final[dict[str, Any]] = {"object_size": OBJECT_SIZE}


def conditions(task: str) -> tuple[Condition, ...]:
    """The settings of a task, from where it was trained to where everything differs.

    :param task: ``push`` or ``pick``
    :return: the last is the one that stands beside the dissertation's table
    """
    noise = SensorNoise()
    size = f"{100 * OBJECT_SIZE:g} cm cubes"
    one_at_a_time = (
        Condition("friction", f"friction {FRICTION:g}", options={"object_friction": FRICTION}),
        Condition("mass", f"mass {MASS:g} kg", options={"object_mass": MASS}),
        Condition("damping", f"damping {DAMPING:g} N s/m", options={"object_damping": DAMPING}),
        Condition("noise", "sensor noise", noise=noise),
    )
    start = (
        Condition("home", "two Jacos, as trained", robot=TRAINED_ON),
        Condition("raw", "two MICOs, finger readings untranslated", translated=False),
        Condition("mico", "two MICOs", expert=True),
    )
    changed = f"friction {FRICTION:g}, mass {MASS:g} kg, damping {DAMPING:g} N s/m, sensor noise"
    if task == "pick":
        everything = Condition("all", changed, options=_CHANGES, noise=noise, expert=True)
        return (*start, *one_at_a_time, everything)
    return (
        *start,
        Condition("size", size, options=_SIZE),
        *one_at_a_time,
        Condition("all-but-size", changed, options=_CHANGES, noise=noise, expert=True),
        Condition("all", f"{size}, {changed}", options=_CHANGES | _SIZE, noise=noise, expert=True),
    )
