"""The commands of `python -m reproduction`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from saver_advisors.cli.program import Program

NAMES: Final = {
    "advising": ("reproduction.advising.table_5_2", "chapter 5: Table 5.2, and its findings"),
    "transfer": ("reproduction.transfer.table_5_4", "chapter 5: policies of the Jaco on the MICO"),
    "constraints": ("reproduction.constraints.chapter_6", "chapter 6: rates and findings"),
    "safe": ("reproduction.constraints.safe", "CPO and Lagrangians where the optimum is known"),
    "ik": ("reproduction.modelling.ik", "chapter 7: inverse kinematics, beside its tables"),
    "id": ("reproduction.modelling.id", "chapter 7: inverse dynamics, beside its tables"),
    "modelling": ("reproduction.modelling.training_time", "minutes to train chapter 7's models"),
    "kinematics": ("reproduction.modelling.kinematics", "learned inverse kinematics in use"),
    "tracking": ("reproduction.modelling.tracking", "feed-forward torques on the twins"),
    "wrist-push": ("reproduction.wrist_push.chapter_8", "chapter 8: the whole robot"),
    "learning": ("reproduction.learning.training_speed", "where training's time goes, beside SB3"),
    "pages": ("reproduction.pages.write_pages", "the documentation pages that come from code"),
}

REPRODUCTION: Final = Program(
    name="python -m reproduction",
    description="Regenerate the figures and pages of the dissertation, beside its own.",
    commands=NAMES,
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run `python -m reproduction`; see :meth:`Program.main`."""
    return REPRODUCTION.main(argv)
