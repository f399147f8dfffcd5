"""Check which environments' models MuJoCo Warp accepts, and compare one step of it with MuJoCo's.

MuJoCo Warp simulates many worlds on a GPU, in single precision. Here it runs on the CPU: the steps
agree or not wherever it runs, but how long they take says nothing about a GPU. The first call
compiles Warp's kernels, which takes minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from importlib import metadata
from typing import Any, Final

import mujoco
import numpy as np

from reproduction.command_parts import add_choices
from saver_advisors.cli.arguments import add_count, add_page
from saver_advisors.cli.catalogue import sparse_ids
from saver_advisors.cli.measured import measure_and_render
from saver_advisors.reporting.provenance import measured_at
from saver_advisors.reporting.tables import Column, rows_table

EXAMPLES: Final = """\
examples:
  python -m reproduction warp --json docs/results/mujoco-warp.json
  python -m reproduction warp --only JacoPush-v0"""

KIND: Final = "mujoco-warp"
PACKAGES: Final = ("mujoco-warp", "warp-lang")
DEVICE: Final = "cpu"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_choices(parser, "--only", sparse_ids(), "environments")
    add_count(parser, "--actions", 20, "actions of the expert before the second compared step")
    add_page(parser)


def run(args: argparse.Namespace) -> int:
    """Check and compare, print the table, and write the requested files.

    :param args: see :func:`add_arguments`.
    :return: exit status.
    """

    def figures() -> dict[str, Any]:
        import mujoco_warp  # noqa: F401  (needed for every row: say so before the first)
        from tqdm import tqdm

        rows = [row_of(env_id, args.actions) for env_id in tqdm(args.only, unit="environment")]
        return {
            "title": "Models in MuJoCo Warp",
            "kind": KIND,
            "device": DEVICE,
            "versions": {name: metadata.version(name) for name in PACKAGES},
            "rows": rows,
        }

    return measure_and_render(args, KIND, figures, render)


def row_of(env_id: str, actions: int) -> dict[str, Any]:
    """Check an environment's model, and compare a step at the start and one of the expert.

    :param env_id: its id.
    :param actions: of the expert before the second step.
    :return: ``accepted``, ``unsupported`` (what MuJoCo Warp says), and ``steps``, empty for a model
        that is not accepted.
    """
    import mujoco_warp

    from saver_advisors.cli.policies import resolve
    from saver_envs.registration import make_episodes

    episodes = make_episodes(env_id)
    episodes.set_generator(0, np.random.default_rng(0))
    episodes.reset()
    model = episodes.simulation.model_of(0)
    row: dict[str, Any] = {"env": env_id, "accepted": True, "unsupported": None, "steps": []}
    try:
        mujoco_warp.put_model(model)
    except (NotImplementedError, ValueError) as error:
        return {**row, "accepted": False, "unsupported": " ".join(str(error).split())}
    row["steps"].append({"actions": 0, **compared_step(model, state_of(episodes, model))})
    expert = resolve("expert", env_id, {})
    for _ in range(actions):
        episodes.step(expert(episodes.observation().as_dict()))
    row["steps"].append({"actions": actions, **compared_step(model, state_of(episodes, model))})
    return row


def state_of(episodes: Any, model: mujoco.MjModel) -> mujoco.MjData:
    """Copy the state of the only episode."""
    data = mujoco.MjData(model)
    episodes.simulation.copy_into(0, data)
    return data


def compared_step(model: mujoco.MjModel, data: mujoco.MjData) -> dict[str, Any]:
    """Do one step of the simulation from the same state in MuJoCo Warp and in MuJoCo.

    :param model: of the environment.
    :param data: the state, which MuJoCo advances.
    :return: ``contacts`` of MuJoCo's step; the largest differences between the two in positions
        (m, rad) and velocities (m/s, rad/s); and the largest changes of both in the step.
    """
    import mujoco_warp
    import warp

    with warp.ScopedDevice(DEVICE):
        there_model = mujoco_warp.put_model(model)
        there = mujoco_warp.put_data(model, data)
        mujoco_warp.step(there_model, there)
        theirs = {name: getattr(there, name).numpy()[0] for name in ("qpos", "qvel")}
    before = {name: getattr(data, name).copy() for name in theirs}
    mujoco.mj_step(model, data)
    found: dict[str, Any] = {"contacts": int(data.ncon)}
    for name, values in theirs.items():
        ours = getattr(data, name)
        found[f"{name}_difference"] = float(np.abs(values - ours).max())
        found[f"{name}_change"] = float(np.abs(ours - before[name]).max())
    return found


COLUMNS: Final[Mapping[str, Column]] = {
    "environment": "{env}",
    "accepted": lambda row: "yes" if row["accepted"] else f"no: {row['unsupported']}",
    "step": lambda row: _of_step(row, "at the start", "after {actions} actions"),
    "contacts": lambda row: _of_step(row, "{contacts}"),
    "largest difference of a position (m, rad)": lambda row: _of_step(row, "{qpos_difference:.1e}"),
    "of a velocity (m/s, rad/s)": lambda row: _of_step(row, "{qvel_difference:.1e}"),
    "largest change of a velocity": lambda row: _of_step(row, "{qvel_change:.1e}"),
}


def _of_step(row: Mapping[str, Any], form: str, later: str | None = None) -> str:
    """Format a figure of a compared step; a dash for a model that is not accepted."""
    if "actions" not in row:
        return "-"
    return (later if later and row["actions"] else form).format_map(row)


def table_of(figures: Mapping[str, Any]) -> str:
    """Render one row per compared step, and one per model that is not accepted."""
    rows = [{**row, **step} for row in figures["rows"] for step in row["steps"] or [{}]]
    return rows_table(rows, COLUMNS)


def render(figures: Mapping[str, Any]) -> str:
    """Render the table and its origin."""
    versions = ", ".join(f"{name} {one}" for name, one in figures["versions"].items())
    return f"{table_of(figures)}\n{measured_at(figures)} With {versions}.\n"
