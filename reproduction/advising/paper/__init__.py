"""Figures that the dissertation prints, one file a table, each with its source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any, Final

NO_ADVICE: Final = "none"
#: Ids with one arm, by the paper's tasks.
ONE_ARM: Final = {"push": "JacoPush-v0", "pick-and-place": "JacoPickAndPlace-v0"}


@dataclass(frozen=True)
class PaperFigures:
    """A cell group of Table 5.2: one strategy in one task, in the paper's epochs.

    :param inspired_epoch: IE, None for the paper's NaN
    :param rise_time: RT
    :param maximum_success_rate: MSR
    :param effective_learning_rate: ELR, None for NaN
    """

    inspired_epoch: float | None
    rise_time: float | None
    maximum_success_rate: float
    effective_learning_rate: float | None


@dataclass(frozen=True)
class PaperTable:
    """Table 5.2.

    :param source: where it is printed
    :param tasks: our environment for each of its tasks
    :param labels: what it calls each of our rows, in its order
    :param figures: by task, then by our name of the row
    :param from_scratch: epochs to 0.9 without advice, by task, then by number of arms in words;
        None where it was not reached
    """

    source: str
    tasks: Mapping[str, str]
    labels: Mapping[str, str]
    figures: Mapping[str, Mapping[str, PaperFigures]]
    from_scratch: Mapping[str, Mapping[str, float | None]]

    def of_environment(self, env_id: str) -> Mapping[str, PaperFigures]:
        """The paper's rows for one of our environments, none where it has no such task."""
        return next((self.figures[name] for name, env in self.tasks.items() if env == env_id), {})


@cache
def table_5_2() -> PaperTable:
    """:return: Table 5.2, from its file beside this module"""
    import yaml

    text = files(__name__).joinpath("table_5_2.yaml").read_text(encoding="utf-8")
    content: dict[str, Any] = yaml.safe_load(text)
    rows = content["rows"]
    return PaperTable(
        source=content["source"],
        tasks=content["tasks"],
        labels={name: row["label"] for name, row in rows.items()},
        figures={
            task: {
                name: PaperFigures(*(row[task][key] for key in ("IE", "RT", "MSR", "ELR")))
                for name, row in rows.items()
            }
            for task in content["tasks"]
        },
        from_scratch=content["from_scratch"],
    )
