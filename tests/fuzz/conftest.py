"""Ends a run with the number of cases that were tried."""

from __future__ import annotations

import pytest
from fuzzing import TRIED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if TRIED:
        told = ", ".join(f"{name} {count:,}" for name, count in sorted(TRIED.items()))
        terminalreporter.write_line(f"{TRIED.total():,} fuzzed cases: {told}")
