"""Where the parts of an observation or a goal lie, as the task declares them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

#: Greatest absolute values by unit, for bounded observations: well beyond what arms of this size
#: reach (1 m) and what they give to an object.
LIMITS = {"m": 5.0, "m/s": 20.0, "rad": 2 * math.pi, "rad/s": 250.0, "1": 1.0}


@dataclass(frozen=True)
class Part:
    """A named piece of an observation or a goal.

    :param name: in tables, such as ``object position``.
    :param size: how many numbers.
    :param unit: of the numbers before scaling, such as ``m`` or ``m/s``.
    :param scale: the numbers are multiplied by it, which brings them to the order of positions in
        metres.
    :param shared: there is one for all arms; otherwise each arm has its own.
    :param limit: greatest absolute value before scaling, for bounded observations; that of the unit
        in :data:`LIMITS` by default.
    """

    name: str
    size: int
    unit: str
    scale: float = 1.0
    shared: bool = False
    limit: float | None = None


@dataclass(frozen=True)
class Layout:
    """A vector made of parts: the block of arm 0, of arm 1, ..., then the shared parts.

    :param parts: their order within a block is the order in the vector.
    :param n_arms: number of blocks.
    """

    parts: tuple[Part, ...]
    n_arms: int

    @cached_property
    def block(self) -> int:
        """Size of an arm's block."""
        return sum(part.size for part in self.parts if not part.shared)

    @cached_property
    def shared(self) -> int:
        """Size of the shared parts."""
        return sum(part.size for part in self.parts if part.shared)

    @cached_property
    def size(self) -> int:
        """Size of the whole vector."""
        return self.block * self.n_arms + self.shared

    @cached_property
    def _slices(self) -> dict[str, slice]:
        """Slices of the parts within an arm's block, or within the shared parts."""
        found = {}
        end = {False: 0, True: 0}
        for part in self.parts:
            start = end[part.shared]
            end[part.shared] += part.size
            found[part.name] = slice(start, end[part.shared])
        return found

    @cached_property
    def limits(self) -> Array:
        """Greatest absolute value (size,) of each number, scaled.

        :raises ValueError: for a part whose limit is unknown.
        """
        limits = {}
        for part in self.parts:
            limit = LIMITS.get(part.unit) if part.limit is None else part.limit
            if limit is None:
                raise ValueError(
                    f"bounded_observations: the part {part.name!r} needs a limit, as its unit "
                    f"{part.unit!r} is none of {', '.join(LIMITS)}"
                )
            shape = (1, part.size) if part.shared else (1, self.n_arms, part.size)
            limits[part.name] = np.full(shape, limit)
        return self.join(limits)[0]

    def part(self, name: str) -> Part:
        """Return a part.

        :raises KeyError: for an unknown name.
        """
        for part in self.parts:
            if part.name == name:
                return part
        raise KeyError(f"no part {name!r}; the parts are {[part.name for part in self.parts]}")

    def blocks(self, vector: Array) -> Array:
        """Return each arm's block of vectors (..., size) as a view (..., n_arms, block)."""
        own = vector[..., : self.block * self.n_arms]
        return own.reshape(*vector.shape[:-1], self.n_arms, self.block)

    def tail(self, vector: Array) -> Array:
        """Return the shared parts of vectors (..., size) as a view (..., shared)."""
        return vector[..., self.block * self.n_arms :]

    def get(self, vector: Array, name: str) -> Array:
        """Return a part of vectors (..., size) as a view, in scaled units.

        :return: (..., n_arms, size of the part), or (..., size of the part) for a shared one.
        """
        if self.part(name).shared:
            return self.tail(vector)[..., self._slices[name]]
        return self.blocks(vector)[..., self._slices[name]]

    def join(self, values: Mapping[str, Array]) -> Array:
        """Scale parts and put them in order.

        :param values: part -> (n, n_arms, size), or (n, size) for a shared one.
        :return: (n, size of the layout).
        :raises KeyError: where a part is missing.
        """
        scaled = [
            values[part.name] if part.scale == 1 else values[part.name] * part.scale
            for part in self.parts
        ]
        own = [value for part, value in zip(self.parts, scaled, strict=True) if not part.shared]
        common = [value for part, value in zip(self.parts, scaled, strict=True) if part.shared]
        if not own:
            return np.concatenate(common, axis=-1)
        blocks = np.concatenate(own, axis=-1)
        flat = blocks.reshape(len(blocks), -1)
        return np.concatenate([flat, *common], axis=-1) if common else flat

    def of_agent(self, vector: Array, arm: int) -> Array:
        """Return what one arm sees of vectors (..., size): its block, then the shared parts."""
        return np.concatenate([self.blocks(vector)[..., arm, :], self.tail(vector)], axis=-1)
