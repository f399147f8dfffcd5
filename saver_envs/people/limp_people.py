"""The limp person in n simulations: who it is, what it is like, how it lies."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from saver_envs.people.limp_person import LIMITS, LimpPerson
from saver_envs.people.lying import PersonLayout
from saver_envs.people.variants import SceneVariants
from saver_envs.randomization import Choice, LogUniform, Parameter, Uniform
from saver_envs.simulation import Simulation

PEOPLE: Final = (
    LimpPerson("male", 1.76, 24.0),
    LimpPerson("female", 1.64, 23.0),
    LimpPerson("male", 1.90, 27.0),
    LimpPerson("female", 1.55, 20.0),
    LimpPerson("male", 1.67, 19.5),
    LimpPerson("female", 1.72, 29.5),
    LimpPerson("male", 1.82, 33.0),
    LimpPerson("female", 1.60, 34.0),
)
"""Whose bodies are compiled, one a variant: as many women as men, of the whole range of sizes and
builds. Friction and stiffness are written for each episode."""

#: What may differ between limp persons; a task has options of these names.
LIMP_PERSON_PARAMETERS: Final = (
    Parameter(
        *("person_body", "", "which of the persons lies there", None, (0, len(PEOPLE) - 1)),
        wide=Choice(tuple(range(len(PEOPLE)))),
        whole=True,
    ),
    Parameter(
        *("person_friction", "", "sliding friction of the person's clothes and skin", None),
        limits=LIMITS["friction"][:2],
        wide=Uniform(0.25, 0.6),
        held_out=Uniform(0.6, 0.9),
    ),
    Parameter(
        *("person_stiffness", "", "factor of stiffness and damping of the person's joints", None),
        limits=LIMITS["stiffness"][:2],
        wide=LogUniform(0.5, 2.0),
        held_out=LogUniform(2.0, 3.0),
    ),
)


class LimpPeople:
    """The person of every simulation.

    :param simulation: of a scene whose variants are persons.
    :param prefix: of the person's names.
    """

    def __init__(self, simulation: Simulation, prefix: str = "") -> None:
        model = simulation.scene.model
        #: Where the person's numbers are.
        self.layout = PersonLayout(model, prefix)
        self._simulation = simulation
        varied = ("geom_friction", "dof_damping", "jnt_stiffness", "jnt_stiffnesspoly")
        self._variants = SceneVariants(simulation, varied)
        joints = self.layout.joints
        self._dofs = np.flatnonzero(np.isin(model.dof_jntid, joints))
        self._damping = model.dof_damping[self._dofs]
        self._stiffness = model.jnt_stiffness[joints]
        self._stiffness_more = model.jnt_stiffnesspoly[joints]

    def give(
        self,
        rows: NDArray[np.intp],
        who: NDArray[np.intp],
        stiffness: NDArray[np.float64],
        friction: NDArray[np.float64],
    ) -> None:
        """Give the models of simulations ``rows`` (k,) their persons.

        :param rows: which simulations.
        :param who: (k,) variants of the scene.
        :param stiffness: (k,) factors of the joints' stiffness and damping.
        :param friction: (k,) sliding friction of clothes and skin.
        """
        fields, every, joints = self._variants.fields, rows[:, None], self.layout.joints
        self._variants.write(rows, who)
        factor = stiffness[:, None]
        fields["dof_damping"][every, self._dofs] = self._damping * factor
        fields["jnt_stiffness"][every, joints] = self._stiffness * factor
        more = self._stiffness_more * factor[..., None]
        fields["jnt_stiffnesspoly"][every, joints] = more
        fields["geom_friction"][every, self.layout.geoms, 0] = friction[:, None]

    def lay(self, rows: NDArray[np.intp], poses: NDArray[np.float64]) -> None:
        """Lay the persons of simulations ``rows`` down; derived quantities are not updated.

        :param rows: (k,) which simulations.
        :param poses: (k, 35) numbers of :meth:`saver_envs.people.lying.LyingWorld.laid`.
        """
        self._simulation.qpos[rows[:, None], self.layout.qpos] = poses

    def angles(self, *names: str) -> NDArray[np.float64]:
        """Return angles (n, names) of hinges, radians.

        :param names: of hinges, such as ``spine_twist`` or ``left_knee``.
        """
        addresses = [int(self.layout.joint_qpos[name][0]) for name in names]
        return self._simulation.qpos.take(addresses, 1)
