"""Define the conditions of the trials, and how they differ from those of training."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

from saver_envs.wrappers.sensor_noise import SensorNoise

OBJECT_SIZE: Final = 0.09
"""Edge of the cube in the dissertation's physical push runs (m); 5.6 cm in training."""
FRICTION: Final = 0.35
"""Friction of a smooth box on a smooth table; 0.5 in training. With less, objects slide further."""
MASS: Final = 0.4
"""Kilograms, twice that of training: a filled box instead of an empty one."""
DAMPING: Final = 1.0
"""N s/m; 0 in training. At the hand's top speed of 0.5 m/s the drag is half the friction of a
training cube, and a third of that of a cube with the two figures above.
"""

TRAINED_ON: Final = "jaco"
"""The robot that the policies were trained with."""


@dataclass(frozen=True)
class Condition:
    """One condition in which policies are tried.

    :param name: its name in tables and on the command line.
    :param words: the differences in words.
    :param robot: name of the arm.
    :param options: keyword arguments of the environment.
    :param noise: sensor noise, or None.
    :param translated: whether finger readings are translated to those of the trained hand.
    :param expert: whether to try the scripted expert, which is slow, as well.
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
    """List the conditions of a task, from those of training to all differences together.

    :param task: ``push`` or ``pick``.
    :return: the conditions; the last one is compared with the dissertation's table.
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
