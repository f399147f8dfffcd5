"""The commands of `python -m reproduction`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from saver_advisors.cli.program import Program

_MODULES: Final = {
    "advising": (
        "advising.advising_command",
        "chapter 5: Table 5.2, and its findings",
    ),
    "transfer": (
        "transfer.transfer_command",
        "chapter 5: policies of the Jaco on the MICO",
    ),
    "constraints": (
        "constraints.constraints_command",
        "chapter 6: rates and findings",
    ),
    "safe": (
        "constraints.safe_command",
        "CPO and Lagrangians where the optimum is known",
    ),
    "ik": (
        "modelling.grid_command",
        "chapter 7: inverse kinematics, beside its tables",
    ),
    "id": ("modelling.grid_command", "chapter 7: inverse dynamics, beside its tables"),
    "modelling": ("modelling.training_time", "minutes to train chapter 7's models"),
    "kinematics": ("modelling.kinematics", "learned inverse kinematics in use"),
    "tracking": ("modelling.tracking", "feed-forward torques on the twins"),
    "wrist-push": ("wrist_push.wrist_push_command", "chapter 8: the whole robot"),
    "learning": ("learning.training_speed", "where training's time goes, beside SB3"),
    "pages": ("pages.write_pages", "the documentation pages that come from code"),
}

REPRODUCTION: Final = Program(
    name="python -m reproduction",
    description="Regenerate the figures and pages of the dissertation, beside its own.",
    commands={
        name: (f"reproduction.{module}", summary) for name, (module, summary) in _MODULES.items()
    },
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run `python -m reproduction`; see :meth:`Program.main`."""
    return REPRODUCTION.main(argv)
