"""What may differ between episodes: names, units, limits and ranges."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from saver_envs.randomization.distributions import (
    Choice,
    Distribution,
    LogUniform,
    Uniform,
    parse_distribution,
)
from saver_envs.validation import require


@dataclass(frozen=True)
class Parameter:
    """A number or a vector that may differ between episodes.

    :param name: as in the mapping of ``randomization``; a task's own are named like the options
        whose place they take.
    :param unit: of the number.
    :param text: what it is, a clause.
    :param nominal: value of the default world; ``None`` where that draws it as well.
    :param limits: least and greatest value that the simulation can do.
    :param wide: distribution of the preset ``wide``; ``None`` where it leaves the nominal value.
    :param held_out: distribution of ``held-out:NAME``, outside ``wide``; ``None`` where there is
        none.
    :param size: how many numbers.
    :param per_arm: whether every arm has its own.
    :param whole: whether values are whole numbers.
    :param names: of values that are not numbers but indices of these.
    """

    name: str
    unit: str
    text: str
    nominal: float | None
    limits: tuple[float, float]
    wide: Distribution | None = None
    held_out: Distribution | None = None
    size: int = 1
    per_arm: bool = False
    whole: bool = False
    names: tuple[str, ...] = ()

    @property
    def usual(self) -> float | str | None:
        """The nominal value, by its name if values have names."""
        if self.names and self.nominal is not None:
            return self.names[int(self.nominal)]
        return self.nominal

    @property
    def valid(self) -> str:
        """The limits in words."""
        if self.names:
            return f"one of {', '.join(self.names)}"
        least, greatest = self.limits
        return f"{least:g} to {greatest:g} {self.unit}".rstrip()

    def parse(self, value: Any) -> Distribution:
        """Read a distribution from what YAML and JSON can hold; names stand for their indices.

        :raises ValueError: for one that is not valid, or values that the simulation cannot do.
        """
        subject = f"randomization: {self.name}"
        if self.names:
            chooses = isinstance(value, Mapping) and "choice" in value
            several = value["choice"] if chooses else [value]
            known = all(one in self.names for one in several)
            require(subject, value, known, f"{self.valid}, or a choice of them")
            return Choice(tuple(self.names.index(one) for one in several))
        distribution = parse_distribution(self.name, value)
        allowed = all(self.allows(end) for end in distribution.ends)
        require(subject, distribution, allowed, f"within {self.valid}")
        if self.whole:
            choices = isinstance(distribution, Choice) and distribution.whole
            require(subject, distribution, choices, "a whole number, or a choice of whole numbers")
        return distribution

    def as_json(self, distribution: Distribution) -> Any:
        """Return what :meth:`parse` reads."""
        if not self.names or not isinstance(distribution, Choice):
            return distribution.as_json()
        chosen = [self.names[int(value)] for value in distribution.values]  # type: ignore[arg-type]
        return chosen[0] if len(chosen) == 1 else {"choice": chosen}

    def allows(self, value: float) -> bool:
        """Return whether the simulation can do a value."""
        return self.limits[0] <= value <= self.limits[1]

    @property
    def mild(self) -> Distribution | None:
        """The third of ``wide`` around the nominal value."""
        wide = self.wide
        if wide is None:
            return None
        if isinstance(wide, Choice):
            centre = wide.ends[0] if self.nominal is None else self.nominal
            reach = max(abs(end - centre) for end in wide.ends) / 3
            near = [one for one in wide.values if abs(float(one) - centre) <= math.ceil(reach)]  # type: ignore[arg-type]
            return Choice(tuple(near)) if self.whole and self.nominal is not None else wide
        low, high = wide.ends
        if isinstance(wide, LogUniform):
            centre = math.sqrt(low * high) if self.nominal is None else self.nominal
            return LogUniform(
                centre * (low / centre) ** (1 / 3), centre * (high / centre) ** (1 / 3)
            )
        centre = (low + high) / 2 if self.nominal is None else self.nominal
        return Uniform(centre + (low - centre) / 3, centre + (high - centre) / 3)


def require_allowed(task: object, parameters: Sequence[Parameter]) -> None:
    """Check the options of a task that are named like its parameters.

    :raises ValueError: for a value that the simulation cannot do.
    """
    for one in parameters:
        value = getattr(task, one.name)
        if value is not None or getattr(type(task), one.name) is not None:
            holds = value in one.names if one.names else one.allows(value)
            require(one.name, value, holds, one.valid)


#: Parameters of every task, besides those of its own.
COMMON = (
    Parameter(
        *("servo_stiffness", "", "factor of the arms' servo stiffness", 1.0, (0.3, 2.0)),
        wide=Uniform(0.75, 1.25),
        held_out=Choice((Uniform(0.60, 0.75), Uniform(1.25, 1.40))),
    ),
    Parameter(
        *("servo_damping", "", "factor of the arms' servo damping", 1.0, (0.3, 3.0)),
        wide=Uniform(0.75, 1.25),
        held_out=Choice((Uniform(0.60, 0.75), Uniform(1.25, 1.40))),
    ),
    Parameter(
        *("joint_friction", "", "dry friction in the arms' joints, share of their greatest torque"),
        *(0.0, (0.0, 0.3)),
        wide=Uniform(0.0, 0.05),
    ),
    Parameter(
        *("tool_offset", "m", "error of the tool point in the hand's frame, along each axis"),
        *(0.0, (-0.03, 0.03)),
        wide=Uniform(-0.005, 0.005),
        size=3,
        per_arm=True,
    ),
    Parameter(
        *("max_speed", "m/s", "top speed of the set-points", 0.5, (0.05, 2.0)),
        wide=Uniform(0.2, 0.5),
    ),
    Parameter(
        *("action_delay", "actions", "actions that pass before one takes effect", 0.0, (0, 10)),
        wide=Choice((0, 1, 2)),
        held_out=Choice((3,)),
        whole=True,
    ),
    Parameter(
        *("observation_delay", "actions", "age of the observation; goals and rewards are current"),
        *(0.0, (0, 10)),
        wide=Choice((0, 1)),
        held_out=Choice((2,)),
        whole=True,
    ),
    Parameter(
        *("sensor_noise", "", "factor of the sensors' errors"),
        *(0.0, (0.0, 10.0)),
        wide=Uniform(0.0, 2.0),
        held_out=Uniform(2.0, 3.0),
    ),
    Parameter(
        *("camera_position", "m", "displacement of the cameras along each axis of the world"),
        *(0.0, (-0.2, 0.2)),
        wide=Uniform(-0.02, 0.02),
        size=3,
    ),
    Parameter(
        *("camera_rotation", "rad", "turn of the cameras about each of their axes"),
        *(0.0, (-0.5, 0.5)),
        wide=Uniform(-math.radians(3), math.radians(3)),
        size=3,
    ),
)
