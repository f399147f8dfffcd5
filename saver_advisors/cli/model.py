"""Model an arm (chapter 7): make its data set, train an inverse model, search hyper-parameters.

Data sets of the simulated twins are made at the first use and kept in the user's cache folder.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from saver_advisors.cli.arguments import (
    add_count,
    add_figure,
    add_json,
    new_file,
    settings,
    write_json,
)

EXAMPLES = """\
examples:
  saver model data --robot mico --figure mico.png           the twin's data set, and a look at it
  saver model train --robot mico --model mlp --data workspace --output mico-ik.safetensors
  saver model train --robot mico --task id --model cgan --set sigma=0.2 --output id.safetensors
  saver model search --robot mico --trials 50 --json search.json    the paper's Table 7.3"""

_TWINS = ("mico", "fetch")
_ARMS = ("mico", "fetch", "jaco")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    steps = parser.add_subparsers(dest="step", metavar="WHAT", required=True)
    data = steps.add_parser("data", help="make an arm's data set, and draw a part of it")
    data.add_argument("--robot", choices=_TWINS, required=True, help="which arm")
    add_count(data, "--seed", 0, "", least=0)
    add_figure(data, "--figure", "draw it there")
    data.set_defaults(work=_data)

    train = steps.add_parser("train", help="train an inverse model and write its weights")
    train.add_argument("--robot", choices=_ARMS, required=True, help="which arm")
    _add_task(train)
    train.add_argument("--model", default="mlp", metavar="NAME", help="(default: mlp)")
    train.add_argument(
        "--data",
        default="twin",
        metavar="WHERE",
        help="twin (chapter 7's), workspace (tool targets over the workspace of the environments, "
        "inverse kinematics alone), or a data file (default: twin)",
    )
    add_count(train, "--samples", 60_000, "", least=100)
    add_count(train, "--data-seed", 0, "", least=0)
    _add_settings(train)
    train.add_argument(
        "--output",
        type=new_file(".safetensors"),
        required=True,
        metavar="FILE",
        help="where the weights go",
    )
    train.set_defaults(work=_train)

    search = steps.add_parser(
        "search", help="search Table 7.3 for an architecture, or a loop's weight, with Optuna"
    )
    search.add_argument("--robot", choices=_TWINS, required=True, help="which arm")
    _add_task(search)
    search.add_argument("--model", default="mlp", metavar="NAME", help="(default: mlp)")
    add_count(search, "--samples", 60_000, "", least=100)
    add_count(search, "--trials", 50, "")
    search.add_argument(
        "--loop-weights",
        nargs="+",
        type=float,
        default=[],
        metavar="W",
        help="of bigan and dualgan: try each of these in place of architectures, with as many "
        "seeds as the trials allow",
    )
    _add_settings(search)
    add_json(search)
    search.set_defaults(work=_search)


def _add_task(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--task",
        choices=("ik", "id"),
        default="ik",
        help="inverse kinematics or inverse dynamics (default: ik)",
    )


def _add_settings(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--set",
        nargs="+",
        action="extend",
        metavar="NAME=VALUE",
        help="settings of the training and the architecture: epochs, batch_size, learning_rate, "
        "sigma, supervised_weight, loop_weight, precision, seed, layers, width, activation, leak",
    )


def run(args: argparse.Namespace) -> int:
    """Do the step that was asked for.

    :param args: see :func:`add_arguments`
    :return: exit status
    """
    from saver_advisors.training.threads import one_thread_of_algebra

    with one_thread_of_algebra():
        return int(args.work(args))


def _data(args: argparse.Namespace) -> int:
    from saver_advisors.cli.model_data import prepare_data
    from saver_advisors.cli.model_figure import draw_recording
    from saver_envs.modelling.datasets import twin_data_set

    prepare_data(args.robot, args.seed)
    data = twin_data_set(args.robot, args.seed)
    print(f"{args.robot}: {len(data.train):,} samples to train on, {len(data.test):,} to test on")
    if args.figure is not None:
        draw_recording(data.test, args.robot).savefig(args.figure)
        print(f"wrote {args.figure}")
    return 0


def _options(args: argparse.Namespace) -> tuple[dict[str, Any], dict[str, Any]]:
    """Settings of the training, and of the architecture."""
    from dataclasses import fields

    from saver_advisors.reporting.errors import UsageError, unknown
    from saver_envs.modelling.models import Training
    from saver_envs.modelling.networks import MLPArchitecture

    values = settings(args.set, "--set")
    training = {field.name for field in fields(Training)}
    architecture = {field.name for field in fields(MLPArchitecture)}
    for name in values:
        if name not in training | architecture:
            valid = sorted(training | architecture)
            raise UsageError(f"argument --set: {unknown('setting', name, valid)}")
    return (
        {name: value for name, value in values.items() if name in training},
        {name: value for name, value in values.items() if name in architecture},
    )


def _new_model(args: argparse.Namespace, architecture: dict[str, Any]) -> Any:
    from saver_advisors.reporting.errors import user_mistakes
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
    """Inputs and outputs to train on."""
    from saver_advisors.cli.model_data import prepare_data
    from saver_advisors.reporting.errors import UsageError, user_mistakes
    from saver_envs.modelling.datasets import load_recordings, samples_of, twin_data_set
    from saver_envs.modelling.recordings import Recording
    from saver_envs.modelling.workspace import workspace_samples

    if args.data == "workspace":
        if args.task != "ik":
            raise UsageError("argument --data: workspace holds inverse kinematics alone")
        found = workspace_samples(args.robot, args.samples, args.data_seed)
        return found.targets, found.joints
    with user_mistakes("argument --data"):
        if args.data == "twin":
            if args.robot in _TWINS:
                prepare_data(args.robot, args.data_seed)
            recording = twin_data_set(args.robot, args.data_seed).train
        else:
            recording = Recording.joined(load_recordings(Path(args.data), args.robot))
        return samples_of(recording.first(min(args.samples, len(recording))), args.task)


def _train(args: argparse.Namespace) -> int:
    from dataclasses import asdict

    from tqdm import tqdm

    from saver_advisors.reporting.errors import user_mistakes
    from saver_advisors.reporting.provenance import provenance
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
        "robot": args.robot,
        "task": args.task,
        "model": args.model,
        "data": args.data,
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
        card["unseen_trajectory_rmse"] = _unseen_torque_error(args, model)
    model.save(args.output, card)
    _write_card(args.output, card)
    print(f"validation RMSE {min(history.validation_rmse):.4g} after {seconds:.0f} s")
    print(f"wrote {args.output}")
    return 0


def _unseen_torque_error(args: argparse.Namespace, model: Any) -> float:
    """Root mean square error of a model's torques on the twin's unseen trajectory, N m."""
    import numpy as np

    from saver_envs.modelling.datasets import samples_of, twin_data_set

    inputs, outputs = samples_of(twin_data_set(args.robot, args.data_seed).test, args.task)
    return float(np.sqrt(np.square(model.predict(inputs) - outputs).mean()))


def _write_card(path: Path, card: dict[str, Any]) -> None:
    """The card of a weight file as Markdown, beside it."""
    from saver_advisors.reporting.tables import markdown

    names = ("robot", "task", "model", "data", "samples", "data_seed", "cpu_seconds")
    rows = [[name.replace("_", " "), str(card[name])] for name in names]
    rows += [["validation RMSE", f"{card['validation_rmse']:.4g}"]]
    if "unseen_trajectory_rmse" in card:
        rows += [["RMSE on the unseen trajectory", f"{card['unseen_trajectory_rmse']:.4g} N m"]]
    rows += [["architecture", str(card["architecture"])]]
    rows += [[name.replace("_", " "), str(value)] for name, value in card["training"].items()]
    rows += [["commit", f"`{card['provenance']['commit']}`"]]
    for kind, error in card.get("unseen_targets_mm", {}).items():
        name = f"unseen targets, {kind.replace('_', ' ')}"
        rows += [[name, f"{error['median']:.3g} mm median, {error['p99']:.3g} mm 99th percentile"]]
    text = (
        f"# {path.stem}\n\nGenerated from the weight file's header; do not edit.\n\n"
        f"{markdown(['', ''], rows)}\nTrained by:\n\n"
        f"```\n{card['provenance']['command']}\n```\n"
    )
    path.with_suffix(".md").write_text(text, encoding="utf-8")


def _search(args: argparse.Namespace) -> int:
    from saver_advisors.cli.model_data import prepare_data
    from saver_advisors.reporting import tables
    from saver_advisors.reporting.errors import user_mistakes
    from saver_envs.modelling.datasets import samples_of, twin_data_set
    from saver_envs.modelling.models import Training
    from saver_envs.modelling.search import ARCHITECTURES, loop_space, search

    options, _ = _options(args)
    _new_model(args, {})
    prepare_data(args.robot, 0)
    recording = twin_data_set(args.robot).train
    samples = samples_of(recording.first(min(args.samples, len(recording))), args.task)
    with user_mistakes("argument --loop-weights"):
        space = loop_space(args.model, args.loop_weights, args.trials) or ARCHITECTURES
    training = Training(**options)
    trials = search(args.model, args.robot, args.task, samples, training, args.trials, space)
    columns = [*trials[0]["settings"], "epochs", "validation RMSE", "minutes"]
    best = sorted(trials, key=lambda one: one["validation_rmse"])[:10]
    rows = [
        [
            *(str(value) for value in one["settings"].values()),
            str(one["epochs"]),
            f"{one['validation_rmse']:.4g}",
            f"{one['cpu_seconds'] / 60:.1f}",
        ]
        for one in best
    ]
    tables.show(columns, rows, f"best of {len(trials)}")
    write_json(
        args.json,
        {
            "kind": "modelling-search",
            "robot": args.robot,
            "task": args.task,
            "model": args.model,
            "samples": len(samples[0]),
            "trials": trials,
        },
    )
    return 0
