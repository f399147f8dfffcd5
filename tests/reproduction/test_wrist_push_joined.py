"""Rows of the whole robot's table that were measured apart."""

from __future__ import annotations

from typing import Any

import pytest

from reproduction.wrist_push.wrist_push_command import joined
from saver_advisors.reporting.errors import UsageError


def measured(row: str, policy: str = "wrist-push", **changes: Any) -> dict[str, Any]:
    """A measurement of one row, and its origin."""
    settings = {"policy": policy, "limits": {"max_speed": 0.2}, "filter": {}, "latencies": {}}
    return {
        "seed": 0,
        "settings": {**settings, **changes},
        "rows": [{"row": row, "trials": 3}],
        "faults": [],
        "provenance": {"command": row},
    }


def test_rows_come_in_the_tables_order_and_another_policy_is_told() -> None:
    first = measured("everything-learned")
    found = joined([first, measured("true-state-exact", "jaco"), measured("true-state-exact")])
    assert [(one["row"], one.get("policy")) for one in found["rows"]] == [
        ("true-state-exact", None),
        ("everything-learned", None),
        ("true-state-exact", "jaco"),
    ]
    assert [one["command"] for one in found["sources"]] == [
        *("everything-learned", "true-state-exact", "true-state-exact")
    ]
    assert joined([first]) is first


def test_what_was_measured_otherwise_is_no_row_of_the_table() -> None:
    first = measured("everything-learned")
    with pytest.raises(UsageError, match="differ in limits"):
        joined([first, measured("true-state-exact", limits={"max_speed": 0.5})])
    with pytest.raises(UsageError, match="row 'everything-learned' occurs twice"):
        joined([first, measured("everything-learned")])
    with pytest.raises(UsageError, match="differ in seed"):
        joined([first, {**measured("true-state-exact"), "seed": 7}])
