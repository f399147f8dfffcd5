"""Figures printed in the dissertation: one file per table, with its source."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any, Final

NO_ADVICE: Final = "none"
#: Ids with one arm, by the paper's tasks.
ONE_ARM: Final = {"push": "JacoPush-v0", "pick-and-place": "JacoPickAndPlace-v0"}


PaperFigures = Mapping[str, float | None]
"""Figures of one strategy in one task of Table 5.2 by the paper's abbreviations: IE, RT, MSR and
ELR, in its epochs; None for its NaN.
"""


@dataclass(frozen=True)
class PaperTable:
    """Table 5.2.

    :param tasks: our environment id for each of its tasks.
    :param rows: our names of its rows, in the table's order.
    :param figures: figures by task, then by our name of the row.
    :param from_scratch: epochs to a success rate of 0.9 without advice, by task, then by number of
        arms in words; None if it was not reached.
    """

    tasks: Mapping[str, str]
    rows: Sequence[str]
    figures: Mapping[str, Mapping[str, PaperFigures]]
    from_scratch: Mapping[str, Mapping[str, float | None]]


@cache
def table_5_2() -> PaperTable:
    """Read Table 5.2 from its file in this package."""
    import yaml

    text = files(__name__).joinpath("table_5_2.yaml").read_text(encoding="utf-8")
    content: dict[str, Any] = yaml.safe_load(text)
    rows = content["rows"]
    return PaperTable(
        tasks=content["tasks"],
        rows=list(rows),
        figures={
            task: {name: row[task] for name, row in rows.items()} for task in content["tasks"]
        },
        from_scratch=content["from_scratch"],
    )
