"""Random appearances and postures of people."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from saver_envs.people.manikin import SIDES
from saver_envs.people.surface import Appearance, Colour, Pattern

#: Splits by body: people of these cells of (gender, heaviness), in quarters, belong to the held-out
#: test set or to the validation set; all others belong to the training set.
TEST_CELLS: Final = frozenset({(0, 2), (3, 1), (2, 3)})
VALIDATION_CELLS: Final = frozenset({(1, 0), (3, 3)})
#: Split by texture: only the test set has this pattern of clothes.
TEST_PATTERN: Final[Pattern] = "mottled"
_TRAIN_PATTERNS: Final[tuple[Pattern, ...]] = ("plain", "plain", "stripes", "checks")

_SKINS: Final = np.array(
    [
        (0.93, 0.76, 0.66),
        (0.85, 0.66, 0.54),
        (0.72, 0.52, 0.40),
        (0.55, 0.37, 0.26),
        (0.34, 0.22, 0.16),
    ]
)
_HAIRS: Final = np.array(
    [
        (0.08, 0.06, 0.05),
        (0.20, 0.13, 0.08),
        (0.38, 0.25, 0.13),
        (0.70, 0.57, 0.35),
        (0.62, 0.61, 0.60),
    ]
)


def random_appearance(random: np.random.Generator, split: str = "train") -> Appearance:
    """Draw a person of a split.

    :param random: source.
    :param split: ``train``, ``validation`` or ``test``.
    :raises ValueError: for another split.
    """
    while True:
        gender, heaviness = random.random(), random.random()
        if cell_split(gender, heaviness) == split:
            break
    patterns = (*_TRAIN_PATTERNS, TEST_PATTERN) if split == "test" else _TRAIN_PATTERNS
    stature = float(np.clip(random.normal(1.76 - 0.12 * gender, 0.06), 1.50, 1.95))
    skin = _mixed(random, _SKINS)
    return Appearance(
        gender=gender,
        heaviness=heaviness,
        stature=stature,
        skin=skin,
        hair=_mixed(random, _HAIRS),
        bald=random.random() < 0.15,
        shirt=_cloth(random),
        shirt_pattern=patterns[random.integers(len(patterns))],
        shirt_second=_cloth(random),
        sleeves=("none", "short", "short", "long", "long")[random.integers(5)],
        trousers=_cloth(random),
        trousers_pattern=patterns[random.integers(len(patterns))]
        if random.random() < 0.4
        else "plain",
        trousers_second=_cloth(random),
        trouser_legs="long" if random.random() < 0.7 else "short",
        shoes=None if random.random() < 0.3 else _cloth(random, 0.5),
    )


def cell_split(gender: float, heaviness: float) -> str:
    """Return the split that a body belongs to."""
    cell = (min(int(4 * gender), 3), min(int(4 * heaviness), 3))
    if cell in TEST_CELLS:
        return "test"
    return "validation" if cell in VALIDATION_CELLS else "train"


def _mixed(random: np.random.Generator, palette: NDArray[np.float64]) -> Colour:
    place = random.uniform(0, len(palette) - 1)
    low = min(int(place), len(palette) - 2)
    colour = palette[low] + (place - low) * (palette[low + 1] - palette[low])
    return _colour(np.clip(colour * random.uniform(0.92, 1.08, 3), 0, 1))


def _cloth(random: np.random.Generator, brightest: float = 0.95) -> Colour:
    """Return a colour, grey ones as often as bright ones."""
    value = random.uniform(0.05, brightest)
    saturation = random.uniform(0, 0.9) * (random.random() < 0.7)
    hue = random.random() * 6
    wheel = np.clip(np.abs((hue + np.array([0.0, 4.0, 2.0])) % 6 - 3) - 1, 0, 1)
    return _colour(value * (1 - saturation * (1 - wheel)))


def _colour(values: NDArray[np.float64]) -> Colour:
    red, green, blue = (float(value) for value in values)
    return red, green, blue


def _about(
    axis: tuple[float, float, float] | NDArray[np.float64], angle: float
) -> NDArray[np.float64]:
    quaternion = np.empty(4)
    mujoco.mju_axisAngle2Quat(quaternion, np.asarray(axis, dtype=np.float64), angle)
    return quaternion


def _then(*turns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compose rotations in the parent's frame, in this order."""
    total = np.array([1.0, 0.0, 0.0, 0.0])
    for turn in turns:
        product = np.empty(4)
        mujoco.mju_mulQuat(product, turn, total)
        total = product
    return total


def random_posture(
    random: np.random.Generator,
    model: mujoco.MjModel,
    qpos: NDArray[np.float64],
    prefix: str = "",
) -> None:
    """Write random joint angles of a person on the back into ``qpos``; limbs may float.

    :param random: source.
    :param model: with a manikin.
    :param qpos: of the whole model; its part that is the manikin's is written.
    :param prefix: of that person's names.
    """

    def put(name: str, value: NDArray[np.float64] | float) -> None:
        joint = model.joint(prefix + name)
        address = int(joint.qposadr[0])
        if np.ndim(value):
            qpos[address : address + 4] = value
            return
        low, high = joint.range
        qpos[address] = low + float(value) * (high - low)

    put("torso", float(np.clip(random.normal(0.5, 0.1), 0, 1)))
    turn = random.uniform(-50, 50) if random.random() < 0.5 else random.normal(0, 12)
    nod = math.radians(random.normal(0, 6))
    put("head", _then(_about((0, 1, 0), nod), _about((1, 0, 0), math.radians(turn))))
    for side in SIDES:
        sign = 1.0 if side == "left" else -1.0
        _random_arm(random, model, prefix, side, sign, put)
        _random_leg(random, side, sign, put)


#: Writes a ball joint's quaternion, or a hinge's share of its range, by the joint's name.
_Put = Callable[[str, NDArray[np.float64] | float], None]


def _random_arm(
    random: np.random.Generator,
    model: mujoco.MjModel,
    prefix: str,
    side: str,
    sign: float,
    put: _Put,
) -> None:
    offset = model.body(f"{prefix}{side}_forearm").pos
    along = offset / np.linalg.norm(offset)
    at_rest = math.degrees(math.atan2(abs(along[1]), along[0]))
    kind = random.random()
    if kind < 0.65:  # beside the body, or spread
        from_feet, lift = random.uniform(8, 85), random.uniform(-5, 10)
    elif kind < 0.85:  # off the stretcher: over the body, or lifted
        from_feet, lift = random.uniform(-5, 70), random.uniform(10, 80)
    else:  # beside the head
        from_feet, lift = random.uniform(85, 150), random.uniform(-5, 25)
    swing = _about((0, 0, 1), sign * math.radians(from_feet - at_rest))
    # Raising is a rotation about the level axis across the arm.
    raised = _about(np.cross(along, (0, 0, 1.0)), math.radians(lift))
    twist = _about(along, math.radians(random.normal(0, 45)))
    put(f"{side}_upper_arm", _then(twist, raised, swing))
    bent = random.uniform(0, 0.25) if random.random() < 0.6 else random.uniform(0.2, 0.9)
    put(f"{side}_forearm", bent)
    put(f"{side}_hand", float(np.clip(random.normal(0.5, 0.15), 0, 1)))


def _random_leg(random: np.random.Generator, side: str, sign: float, put: _Put) -> None:
    spread = sign * math.radians(random.uniform(-14, 16))
    outwards = sign * math.radians(random.uniform(-10, 45))
    bent, knee = random.uniform(0, 6), random.uniform(0, 0.10)
    if random.random() < 0.25:
        bent = random.uniform(10, 60)
        knee = min(2 * bent, 130) / 140 * random.uniform(0.7, 1.0)
        outwards *= 0.4
    put(
        f"{side}_thigh",
        _then(
            _about((1, 0, 0), -outwards),
            _about((0, 1, 0), -math.radians(bent)),
            _about((0, 0, 1), spread),
        ),
    )
    put(f"{side}_shank", knee)
    put(f"{side}_foot", float(np.clip(random.normal(0.4, 0.2), 0, 1)))
