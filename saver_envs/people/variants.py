"""Gives each of n simulations the model of one of a scene's variants, such as another body."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS
from numpy.typing import NDArray

from saver_envs.simulation import Simulation


class SceneVariants:
    """Fields of the models in which a scene's variants differ, in every simulation.

    :param simulation: of the scene.
    :param varied: further fields that a user of this object writes.
    """

    def __init__(self, simulation: Simulation, varied: Sequence[str] = ()) -> None:
        #: Field -> (variants, ...) values of the models.
        self.values = _differing_fields(simulation.scene.models)
        names = (*self.values, *varied)
        #: Field -> (n, ...) values of the simulations, live.
        self.fields = {name: simulation.per_simulation(name) for name in names}
        self._sites = simulation.per_simulation("site_pos")
        self._tools = simulation.scene.tool_site

    def write(self, rows: NDArray[np.intp], variant: NDArray[np.intp]) -> None:
        """Give simulations ``rows`` (k,) the models ``variant`` (k,)."""
        # Variants have other sites; the tools of the arms stay where they are.
        tools = self._sites[rows[:, None], self._tools]
        for name, values in self.values.items():
            self.fields[name][rows] = values[variant]
        self._sites[rows[:, None], self._tools] = tools


@lru_cache(maxsize=4)
def _differing_fields(models: tuple[mujoco.MjModel, ...]) -> dict[str, NDArray[Any]]:
    """Return the fields in which models differ, (models, ...) each."""
    fields = {}
    for name in sorted(one for one in MODEL_FIELDS if "." not in one):
        values = np.stack([np.asarray(getattr(model, name)) for model in models])
        if (values != values[0]).any():
            fields[name] = values
    return fields
