"""The commands of `python -m reproduction`."""

from __future__ import annotations

from typing import Final

from saver_advisors.cli.program import Program

REPRODUCTION: Final = Program(
    name="python -m reproduction",
    description="Regenerate the figures and pages of the dissertation, next to its own.",
    commands={
        name: (f"reproduction.{module}", summary)
        for name, module, summary in (
            ("advising", "advising.advising_command", "chapter 5: Table 5.2 and its findings"),
            ("transfer", "transfer.transfer_command", "chapter 5: Jaco policies on the MICO"),
            ("constraints", "constraints.constraints_command", "chapter 6: rates and findings"),
            ("safe", "constraints.safe_command", "CPO and Lagrangians with a known optimum"),
            ("ik", "modelling.grid_command", "chapter 7: inverse kinematics"),
            ("id", "modelling.grid_command", "chapter 7: inverse dynamics"),
            ("modelling", "modelling.training_time", "training time of the models of chapter 7"),
            ("kinematics", "modelling.kinematics", "learned inverse kinematics in use"),
            ("tracking", "modelling.tracking", "feed-forward torques on the twins"),
            ("wrist-push", "wrist_push.wrist_push_command", "chapter 8: the whole robot"),
            ("joint-speeds", "joint_speeds", "steps in which joints exceed the makers' speeds"),
            ("learning", "learning.training_speed", "training time by part, and that of SB3"),
            ("ecosystem", "ecosystem.ecosystem_command", "third-party libraries, each tried"),
            ("warp", "warp_models", "which models MuJoCo Warp accepts, and how steps agree"),
            ("pages", "pages.write_pages", "the documentation pages that come from code"),
        )
    },
)

main = REPRODUCTION.main
