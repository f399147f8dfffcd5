"""The JACO: a chain read from its MuJoCo model; no twin and no inertia in Appendix A."""

from __future__ import annotations

from saver_envs.modelling.arms.description import KinematicArm, Region, within_one_turn
from saver_envs.modelling.mujoco_chain import chain_of_model
from saver_envs.robots.description import Fingers
from saver_envs.robots.jaco import JACO


def arm() -> KinematicArm:
    """Return the JACO."""
    model = JACO.build(Fingers.LOCKED).compile()
    chain = chain_of_model(model, JACO.base_body, JACO.arm_joints, JACO.tool_site)
    return KinematicArm(
        JACO, chain, chain, *within_one_turn(JACO), region=Region(JACO.grid_lower, JACO.grid_upper)
    )
