"""Render the figures of ``saver benchmark speed`` as a page of Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from saver_advisors.benchmark.speed.randomized_steps import MUST
from saver_advisors.reporting.provenance import measured_at
from saver_advisors.reporting.tables import (
    Column,
    join_parts,
    markdown,
    optional,
    row_cells,
    rows_table,
)

INTRODUCTION: Final = """\
Rendered from the JSON file of `saver benchmark speed`, never typed. A step is one action of one
environment: 0.04 s, 20 sub-steps of the physics. What is compared was measured in turn, round by
round, on the same cores; rates are medians over the rounds, ratios medians of the rounds' ratios.
"""

STEPS: Final = """\
*Raw* is MuJoCo's `Batch.step` alone, called as the environments call it: the same model, sub-steps
and stages, from the same starts and with the same controls, so that it does the same physics.
*Gymnasium* is the vector environment, *core* what all adapters stand on, *SB3* the vector
environment of Stable-Baselines3; no reset is in the time that was measured. The ratios are to raw.
*Threads' gain* is Gymnasium's rate over that of the fewest threads; the memory is what each further
environment takes.
"""

RANDOMIZED: Final = """\
Each environment in its default world, in one whose every parameter is drawn but always has its
nominal value, and under the preset `wide`; in processor time, on one core. An episode of random
actions is timed without its reset. *Nominal* and *wide* are rates in proportion to that of the
default world; *identical* says whether the nominal world's episodes are the default world's, bit
for bit. *Raw* is MuJoCo alone on the models of `wide` with the same controls. Resets and memory are
those of `wide` in proportion to the default world's. The bars are in brackets.
"""

PEERS: Final = """\
Whole episodes with their resets, on one core. The peers run in virtual environments of their own,
in one process each, as their users have them; the faster mode counts. EnvPool has the FetchPush of
gymnasium-robotics in C++. TwoArmLift's resets, half a second each, are left out.
"""


#: Columns of the table of steps: heading, and the format of a row's figure.
_STEPS: Final[Sequence[tuple[str, Column]]] = (
    ("environment", "{env}"),
    ("n_envs", "{n_envs}"),
    ("threads", "{threads}"),
    ("raw", "{raw_steps_per_second:,.0f}"),
    ("Gymnasium", "{steps_per_second:,.0f}"),
    ("ratio", "{ratio_to_raw:.2f}"),
    ("core", "{core_steps_per_second:,.0f}"),
    ("ratio", "{core_ratio_to_raw:.2f}"),
    ("SB3", "{sb3_steps_per_second:,.0f}"),
    ("ratio", "{sb3_ratio_to_raw:.2f}"),
    ("threads' gain", "{speed_up_of_threads:.2f}x"),
    ("MB an environment", optional("memory_per_env_mb")),
)
_RATIOS: Final[Mapping[str, Column]] = {
    "environment": "{env}",
    "peer": "{peer}",
    "times as fast": "{ratio:.1f}x",
    "must": lambda row: _bar(row["must"]),
    "aim": lambda row: _bar(row["aim"]),
}
_RATES: Final[Mapping[str, Column]] = {
    "environment": "{env}",
    "suite": "{suite}",
    "mode": "{mode}",
    "n_envs": "{n_envs}",
    "steps per second": "{steps_per_second:,.0f}",
    "versions": lambda row: ", ".join(f"{name} {one}" for name, one in row["versions"].items()),
}
_ADVICE: Final = {
    "strategy": "{strategy}",
    "environment": "{env}",
    "advised at once": "{n_envs} x {arms} arms",
    "ms": "{milliseconds:.2f}",
    "share of the step's time": "{share_of_step:.1%}",
}


def render(figures: Mapping[str, Any]) -> str:
    """Render the figures as a page.

    :param figures: what ``saver benchmark speed`` measured, or its JSON file's content
    :return: Markdown
    """
    parts = ["# Speed", INTRODUCTION]
    if peers := figures.get("peers"):
        ours = {"suite": "SAVER", "mode": "gymnasium vector", "versions": {}}
        rates = [*({**ours, **one} for one in peers["ours"]), *peers["peers"]]
        parts += ["## Beside other suites", PEERS]
        parts += [rows_table(peers["ratios"], _RATIOS), rows_table(rates, _RATES)]
    headings, columns = zip(*_STEPS, strict=True)
    parts += ["## Steps per second", STEPS, markdown(headings, row_cells(figures["rows"], columns))]
    if randomized := figures.get("randomized"):
        parts += ["## Worlds that vary", RANDOMIZED, _randomized(randomized)]
    parts += ["## Starting episodes", _resets(figures["resets"])]
    parts += ["## Replay and advice", _replay(figures["replay"])]
    parts += [rows_table(figures["advice"], _ADVICE), _origin(figures)]
    return join_parts(parts)


def _bar(times: float | None) -> str:
    return "-" if times is None else f"{times:g}x"


def _randomized(rows: Sequence[Mapping[str, Any]]) -> str:
    def memory(row: Mapping[str, Any]) -> str:
        default, wide = (row["memory_per_env_mb"][name] for name in ("default", "wide"))
        return f"{wide / default:.2f}x" if default and wide else "-"

    columns: dict[str, Column] = {
        "environment": "{env}",
        "n_envs": "{n_envs}",
        "default": "{steps_per_second:,.0f}",
        f"nominal (at least {MUST['nominal']:g})": "{nominal:.2f}",
        "identical": lambda row: "yes" if row["identical"] else "no",
        f"wide (at least {MUST['wide']:g})": "{wide:.2f}",
        "raw": "{raw_steps_per_second:,.0f}",
        f"wide of raw (at least {MUST['wide_to_raw']:g})": "{wide_to_raw:.2f}",
        f"reset (at most {MUST['reset']:g}x)": "{reset:.2f}x",
        f"memory (at most {MUST['memory']:g}x)": memory,
    }
    return rows_table(rows, columns)


def _resets(resets: Sequence[Mapping[str, Any]]) -> str:
    counts = list(resets[0]["milliseconds_per_episode"]) if resets else []
    columns = ["environment", *(f"ms an episode, {count} at once" for count in counts)]
    rows = [
        [one["env"], *(f"{one['milliseconds_per_episode'][count]:.2f}" for count in counts)]
        for one in resets
    ]
    return markdown(columns, rows)


def _replay(row: Mapping[str, Any]) -> str:
    return (
        f"Drawing {row['batch']} transitions, relabelled, from a buffer of {row['rows']:,} takes "
        f"{row['milliseconds']:.2f} ms.\n"
    )


def _origin(figures: Mapping[str, Any]) -> str:
    lines = [f"Medians over {figures['rounds']} rounds."]
    if load := figures.get("load_average"):
        told = [f"{when} {one[0]:g}" for when, one in load.items() if one]
        if told:
            lines.append(f"The system's load average over a minute: {', '.join(told)}.")
    lines.append(measured_at(figures, {"Python": "python", "MuJoCo": "mujoco"}))
    return " ".join(lines).rstrip()
