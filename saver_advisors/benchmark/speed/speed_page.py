"""The figures of ``saver benchmark speed`` as a page of Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from saver_advisors.reporting.provenance import machine_in_words
from saver_advisors.reporting.tables import markdown

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

PEERS: Final = """\
Whole episodes with their resets, on one core. The peers run in virtual environments of their own,
in one process each, as their users have them; the faster mode counts. TwoArmLift's resets, half a
second each, are left out.
"""


def render(figures: Mapping[str, Any]) -> str:
    """The figures as a page.

    :param figures: what ``saver benchmark speed`` measured, or its JSON file's content
    :return: Markdown
    """
    parts = ["# Speed", INTRODUCTION]
    if peers := figures.get("peers"):
        parts += ["## Beside other suites", PEERS, _ratios(peers), _rates(peers)]
    parts += ["## Steps per second", STEPS, _steps(figures["rows"])]
    parts += ["## Starting episodes", _resets(figures["resets"])]
    parts += ["## Replay and advice", _replay(figures["replay"]), _advice(figures["advice"])]
    parts.append(_origin(figures))
    return "\n".join(part.rstrip("\n") + "\n" for part in parts if part)


def _ratios(peers: Mapping[str, Any]) -> str:
    rows = [
        [
            one["env"],
            one["peer"],
            f"{one['ratio']:.1f}x",
            f"{one['must']:g}x",
            f"{one['aim']:g}x",
        ]
        for one in peers["ratios"]
    ]
    return markdown(["environment", "peer", "times as fast", "must", "aim"], rows)


def _rates(peers: Mapping[str, Any]) -> str:
    rows = [
        [one["env"], "SAVER", "gymnasium vector", str(one["n_envs"]), _rate(one), ""]
        for one in peers["ours"]
    ]
    for one in peers["peers"]:
        versions = ", ".join(f"{name} {version}" for name, version in one["versions"].items())
        count = str(one["n_envs"])
        rows.append([one["env"], one["suite"], one["mode"], count, _rate(one), versions])
    columns = ["environment", "suite", "mode", "n_envs", "steps per second", "versions"]
    return markdown(columns, rows)


def _rate(row: Mapping[str, Any], key: str = "steps_per_second") -> str:
    return f"{row[key]:,.0f}"


def _steps(rows: Sequence[Mapping[str, Any]]) -> str:
    columns = [
        "environment",
        "n_envs",
        "threads",
        "raw",
        "Gymnasium",
        "ratio",
        "core",
        "ratio",
        "SB3",
        "ratio",
        "threads' gain",
        "MB an environment",
    ]
    cells = []
    for row in rows:
        memory = row.get("memory_per_env_mb")
        cells.append(
            [
                row["env"],
                str(row["n_envs"]),
                str(row["threads"]),
                _rate(row, "raw_steps_per_second"),
                _rate(row),
                f"{row['ratio_to_raw']:.2f}",
                _rate(row, "core_steps_per_second"),
                f"{row['core_ratio_to_raw']:.2f}",
                _rate(row, "sb3_steps_per_second"),
                f"{row['sb3_ratio_to_raw']:.2f}",
                f"{row['speed_up_of_threads']:.2f}x",
                "-" if memory is None else f"{memory:.2f}",
            ]
        )
    return markdown(columns, cells)


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


def _advice(rows: Sequence[Mapping[str, Any]]) -> str:
    cells = [
        [
            one["strategy"],
            one["env"],
            f"{one['n_envs']} x {one['arms']} arms",
            f"{one['milliseconds']:.2f}",
            f"{one['share_of_step']:.1%}",
        ]
        for one in rows
    ]
    columns = ["strategy", "environment", "advised at once", "ms", "share of the step's time"]
    return markdown(columns, cells)


def _origin(figures: Mapping[str, Any]) -> str:
    lines = [f"Medians over {figures['rounds']} rounds."]
    if load := figures.get("load_average"):
        told = [f"{when} {one[0]:g}" for when, one in load.items() if one]
        if told:
            lines.append(f"The system's load average over a minute: {', '.join(told)}.")
    origin = figures.get("provenance")
    if origin:
        versions = origin["versions"]
        lines.append(
            f"Measured {origin['time']} at commit `{origin['commit']}` with "
            f"`{origin['command']}` on {machine_in_words(origin['machine'])}, Python "
            f"{versions['python']}, MuJoCo {versions['mujoco']}."
        )
    return " ".join(lines)
