"""Record an arm's data set, train an inverse model, or search hyper-parameters (chapter 7).

Data sets of the simulated twins are recorded at first use and kept in the user's cache folder.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from saver_advisors.cli import arguments
from saver_advisors.reporting import tables
from saver_advisors.reporting.errors import UsageError, unknown, user_mistakes
from saver_advisors.reporting.templates import rendered
from saver_advisors.training.threads import one_thread_of_algebra

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from saver_envs.modelling.datasets import DataSet, Recording

EXAMPLES = """\
examples:
  saver model data --robot mico --figure mico.png           the twin's data set, and a plot
  saver model train --robot mico --model mlp --data workspace --output mico-ik.safetensors
  saver model train --robot mico --task id --model cgan --set sigma=0.2 --output id.safetensors
  saver model search --robot mico --trials 50 --json search.json    the paper's Table 7.3"""

MODEL_CARD: Final = "model_card.md.j2"
"""Template of the readable card of a model."""
_QUANTITIES: Final = (
    ("position", "position (rad)"),
    ("velocity", "velocity (rad/s)"),
    ("acceleration", "acceleration (rad/s²)"),
    ("torque", "torque (N m)"),
)
_SHOWN: Final = 1200
"""Number of plotted samples; more would hide the curves' shapes."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    steps = parser.add_subparsers(dest="step", metavar="WHAT", required=True)
    data = steps.add_parser("data", help="record an arm's data set, and plot the first samples")
    arguments.add_count(data, "--seed", 0, "", least=0)
    arguments.add_figure(data, "--figure", "plot the samples in this file")
    data.set_defaults(work=_data)

    train = steps.add_parser("train", help="train an inverse model and write its weights")
    _add_model_arguments(train)
    text = "twin (data of chapter 7), workspace (tool targets in the environments' workspace, "
    text += "inverse kinematics only), or a data file"
    arguments.add(train, "--data", text, "twin", metavar="WHERE")
    arguments.add_count(train, "--data-seed", 0, "", least=0)
    arguments.add_file(train, "--output", "file of the weights", ".safetensors", required=True)
    train.set_defaults(work=_train)

    search = steps.add_parser(
        "search", help="search the architectures of Table 7.3, or the loop weight, with Optuna"
    )
    _add_model_arguments(search)
    arguments.add_count(search, "--trials", 50, "")
    text = "bigan and dualgan: compare these loop weights instead of architectures, each with "
    text += "as many seeds as the trials allow"
    arguments.add(search, "--loop-weights", text, [], nargs="+", type=float, metavar="W")
    arguments.add_json(search)
    search.set_defaults(work=_search, data="twin", data_seed=0)
    for step in (data, train, search):
        arguments.add(step, "--robot", "name of the arm", type=arguments.arm, required=True)


def _add_model_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the model and its training."""
    arguments.add(parser, "--model", "", "mlp", metavar="NAME")
    arguments.add_count(parser, "--samples", 60_000, "", least=100)
    text = "inverse kinematics or inverse dynamics"
    arguments.add(parser, "--task", text, "ik", choices=("ik", "id"))
    text = "settings of the training and the architecture: epochs, batch_size, learning_rate, "
    text += (
        "sigma, supervised_weight, loop_weight, precision, seed, layers, width, activation, leak"
    )
    arguments.add_settings(parser, "--set", text)


@one_thread_of_algebra()
def run(args: argparse.Namespace) -> int:
    """Run the chosen step.

    :param args: see :func:`add_arguments`
    :return: exit status
    """
    import numba  # noqa: F401  (the measurement at the end needs it: say so before the training)

    return int(args.work(args))


def _data(args: argparse.Namespace) -> int:
    data = prepare_data(args.robot, args.seed)
    print(f"{args.robot}: {len(data.train):,} training samples, {len(data.test):,} test samples")
    if args.figure is not None:
        draw_recording(data.test, args.robot).savefig(args.figure)
        print(f"wrote {args.figure}")
    return 0


def prepare_data(robot: str, seed: int = 0) -> DataSet:
    """Return an arm's data set; record it with a progress bar if it is missing.

    :param robot: the arm's name
    :param seed: seed of the data set
    :raises UsageError: for an arm without a twin
    """
    from tqdm import tqdm

    from saver_envs.modelling.datasets import simulated_steps, twin_data_set

    with user_mistakes("argument --robot"):
        total = simulated_steps(robot)
    with tqdm(total=total, desc=f"{robot}: data", unit="step", delay=2.0, leave=False) as bar:
        return twin_data_set(robot, seed, progress=bar.update)


def draw_recording(recording: Recording, robot: str) -> Figure:
    """Plot the first samples of a recording, one column per joint.

    :param recording: the samples
    :param robot: the arm's name
    :return: the figure
    """
    from matplotlib.figure import Figure

    from saver_envs.modelling.arms import arm_named

    slides = arm_named(robot).chain.prismatic
    joints = len(slides)
    figure = Figure(figsize=(2.6 * joints, 8.0), layout="constrained")
    axes = figure.subplots(len(_QUANTITIES), joints, sharex=True, squeeze=False)
    for row, (name, label) in enumerate(_QUANTITIES):
        values = getattr(recording, name)[:_SHOWN]
        for joint in range(joints):
            axis = axes[row, joint]
            axis.plot(values[:, joint], linewidth=0.7, color=f"C{row}")
            axis.tick_params(labelsize=7)
            axis.grid(alpha=0.3)
            if row == 0:
                hinges = joint + 1 - sum(slides[: joint + 1])
                title = "lift (m, N)" if slides[joint] else f"joint {hinges}"
                axis.set_title(title, fontsize=9)
            if joint == 0:
                axis.set_ylabel(label, fontsize=9)
            if row == len(_QUANTITIES) - 1:
                axis.set_xlabel("sample", fontsize=8)
    return figure


def _options(args: argparse.Namespace) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the settings of the training and of the architecture."""
    from saver_envs.modelling.models import Training
    from saver_envs.modelling.networks import MLPArchitecture

    values = arguments.settings(args.set, "--set")
    names = [[field.name for field in fields(kind)] for kind in (Training, MLPArchitecture)]
    valid = sorted({*names[0], *names[1]})
    for name in values:
        if name not in valid:
            raise UsageError(f"argument --set: {unknown('setting', name, valid)}")
    training, architecture = ({one: values[one] for one in values if one in own} for own in names)
    return training, architecture


def _new_model(args: argparse.Namespace, architecture: dict[str, Any]) -> Any:
    from saver_envs.modelling.models import new_model
    from saver_envs.modelling.models.network_model import PAPER_LAYERS
    from saver_envs.modelling.networks import MLPArchitecture

    with user_mistakes("argument --model"):
        if not architecture:
            return new_model(args.model, args.robot, args.task)
        layers = {"layers": PAPER_LAYERS[args.task]}
        shape = MLPArchitecture(**{**layers, **architecture})
        return new_model(args.model, args.robot, args.task, architecture=shape)


def _samples(args: argparse.Namespace) -> tuple[Any, Any]:
    """Return inputs and outputs of the training samples."""
    from saver_envs.modelling.datasets import Recording, load_recordings, samples_of
    from saver_envs.modelling.workspace import workspace_samples

    if args.data == "workspace":
        if args.task != "ik":
            raise UsageError("argument --data: workspace is for --task ik only")
        found = workspace_samples(args.robot, args.samples, args.data_seed)
        return found.targets, found.joints
    with user_mistakes("argument --data"):
        if args.data == "twin":
            recording = prepare_data(args.robot, args.data_seed).train
        else:
            recording = Recording.joined(load_recordings(Path(args.data), args.robot))
        return samples_of(recording.first(min(args.samples, len(recording))), args.task)


def _train(args: argparse.Namespace) -> int:
    import numpy as np
    from tqdm import tqdm

    from saver_advisors.reporting.provenance import provenance
    from saver_envs.modelling.datasets import samples_of
    from saver_envs.modelling.models import Training

    options, architecture = _options(args)
    with user_mistakes("argument --set"):
        training = Training(**options)
    model = _new_model(args, architecture)
    inputs, outputs = _samples(args)
    began = time.process_time()
    with tqdm(total=training.epochs, unit="epoch", dynamic_ncols=True) as bar:

        def progress(_: int, error: float) -> None:
            bar.set_postfix(validation=f"{error:.4g}")
            bar.update()

        history = model.fit(inputs, outputs, training, progress)
    seconds = time.process_time() - began
    card = {
        **{name: getattr(args, name) for name in ("robot", "task", "model", "data")},
        "samples": len(inputs),
        "data_seed": args.data_seed,
        "architecture": architecture or "the paper's",
        "training": asdict(training),
        "validation_rmse": min(history.validation_rmse),
        "cpu_seconds": round(seconds, 1),
        "provenance": provenance(),
    }
    if args.data == "workspace":
        from saver_envs.modelling.accuracy import accuracy

        card["unseen_targets_mm"] = accuracy(args.robot, args.model, model)["millimetres"]
    if args.data == "twin" and args.task == "id":
        inputs, torques = samples_of(prepare_data(args.robot, args.data_seed).test, args.task)
        errors = model.predict(inputs) - torques
        card["unseen_trajectory_rmse"] = float(np.sqrt(np.square(errors).mean()))
    model.save(args.output, card)
    # The card, as Markdown next to the weights.
    text = rendered("saver_advisors.cli", MODEL_CARD, stem=args.output.stem, card=card)
    args.output.with_suffix(".md").write_text(text, encoding="utf-8")
    print(f"validation RMSE {min(history.validation_rmse):.4g} after {seconds:.0f} s")
    print(f"wrote {args.output}")
    return 0


def _search(args: argparse.Namespace) -> int:
    from saver_envs.modelling.models import Training
    from saver_envs.modelling.search import ARCHITECTURES, loop_space, search

    options, _ = _options(args)
    _new_model(args, {})
    samples = _samples(args)
    with user_mistakes("argument --loop-weights"):
        space = loop_space(args.model, args.loop_weights, args.trials) or ARCHITECTURES
    training = Training(**options)
    trials = search(args.model, args.robot, args.task, samples, training, args.trials, space)
    columns: dict[str, tables.Column] = {
        **{name: f"{{settings[{name}]}}" for name in trials[0]["settings"]},
        "epochs": "{epochs}",
        "validation RMSE": "{validation_rmse:.4g}",
        "minutes": lambda one: f"{one['cpu_seconds'] / 60:.1f}",
    }
    best = sorted(trials, key=lambda one: one["validation_rmse"])[:10]
    tables.show_rows(best, columns, f"best of {len(trials)}")
    arguments.write_json(
        args.json,
        {
            "kind": "modelling-search",
            **{name: getattr(args, name) for name in ("robot", "task", "model")},
            "samples": len(samples[0]),
            "trials": trials,
        },
    )
    return 0
