"""What the page of wrist push says where it differs from those of the tasks with cubes."""

from __future__ import annotations

import math
from typing import Final

from saver_envs.people.bodies import BODIES
from saver_envs.tasks.sampling import HAND_TO_OBJECT
from saver_envs.tasks.wrist_push import DISPLACEMENT_LIMIT, FORCE_LIMIT, STANDOFF
from saver_envs.tasks.wrist_starts import (
    FRICTION,
    HIPS_SPREAD,
    MOST_BENT,
    MOST_BENT_OUTWARDS,
    STIFFNESS,
    WRIST_TO_TARGET,
    YAW,
)

_FORCE, _DISPLACEMENT = f"{FORCE_LIMIT:g} N", f"{1000 * DISPLACEMENT_LIMIT:g} mm"

COST_MEANINGS: Final = {
    "collision": (
        "1 on a step with contact between arms, or of an arm with the table or with anything of "
        "the person but the arm at its side"
    ),
    "torso_force": f"1 on a step with more than {_FORCE} on the torso",
    "torso_displacement": f"1 on a step on which the torso is more than {_DISPLACEMENT} away",
}

SUCCEEDS: Final = (
    f"every wrist is within {{}} of its target; and the torso was never pressed with more than "
    f"{_FORCE} nor moved by more than {_DISPLACEMENT}"
)

READINGS: Final = (
    "`info` also has `torso_force` (N), the sum of the normal forces on torso and pelvis, of the "
    "robots' arms and of the person's own forearms and hands, the highest of four samples a step; "
    "and `torso_displacement` (m), how far hips or neck are from where they were at the reset."
)


def facts() -> tuple[str, str]:
    """The row that stands for the cubes' size and mass."""
    statures = [body.stature for body in BODIES]
    span = f"{min(statures):.2f} to {max(statures):.2f} m"
    return "people", f"{len(BODIES)} bodies, {span}, slim to heavy"


def start() -> list[str]:
    """What the sampler guarantees, each with its figure."""
    x, y = (f"{100 * one:g} cm" for one in HIPS_SPREAD)
    inwards, outwards = math.degrees(MOST_BENT), math.degrees(MOST_BENT_OUTWARDS)
    return [
        f"The person lies on the back, the head towards -x, turned by up to {YAW:g} rad; the middle"
        f" between the hip joints at (0.35 +- {x}, +- {y}).",
        f"A wrist's target is {100 * STANDOFF:g} cm beside its hip joint, at the height of a wrist "
        "that lies on the stretcher.",
        f"A wrist {100 * WRIST_TO_TARGET[0]:g} to {100 * WRIST_TO_TARGET[1]:g} cm from its target, "
        "on the outer side, within reach of its arm and in the camera's picture.",
        f"Elbows bent by up to {outwards:.0f} degrees where they point outwards and "
        f"{inwards:.0f} where they point inwards, and no forearm so near the trunk that the swing "
        "to the target would squeeze it.",
        f"A hand {100 * HAND_TO_OBJECT[0]:g} to {100 * HAND_TO_OBJECT[1]:g} cm from its wrist, on "
        "the outer side, closed, with room behind the wrist.",
        f"Friction of the person's arms {FRICTION[0]:g} to {FRICTION[1]:g}; friction and damping "
        f"in their joints times {STIFFNESS[0]:g} to {STIFFNESS[1]:g}.",
        "Nothing touches but the person's arms the stretcher.",
    ]
