"""Send the curve of a run to TensorBoard and to Weights & Biases while the run trains."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final

from saver_advisors.reporting.errors import UsageError

TENSORBOARD_FOLDER: Final = "tensorboard"
WANDB_ID_FILE: Final = "wandb-id.txt"

Point = Mapping[str, Any]
AddPoint = Callable[[Point], None]


@contextmanager
def tensorboard_log(folder: Path) -> Iterator[AddPoint]:
    """Write a curve as TensorBoard's events to a folder of the run.

    :param folder: the run's folder.
    :return: a context with a function that writes a point.
    """
    from torch.utils.tensorboard.writer import SummaryWriter

    # Hides events of earlier sessions: a session writes the curve from its first point on.
    writer: Any = SummaryWriter(str(folder / TENSORBOARD_FOLDER), purge_step=0)

    def add(point: Point) -> None:
        for name, value in _figures(point).items():
            writer.add_scalar(f"evaluation/{name}", value, point["steps"])
        writer.flush()

    yield add
    writer.close()


@contextmanager
def wandb_log(folder: Path, project: str, config: Mapping[str, Any]) -> Iterator[AddPoint]:
    """Send a curve to a run of Weights & Biases; a resumed run continues there.

    :param folder: the run's folder, which keeps the id of the run and, offline, its data.
    :param project: name of the project.
    :param config: settings of the run.
    :return: a context with a function that sends a point, unless an earlier session has.
    :raises UsageError: if nobody is logged in, or the server does not answer.
    """
    import wandb

    file = folder / WANDB_ID_FILE
    if not file.is_file():
        file.write_text(secrets.token_hex(8), encoding="utf-8")
    place: dict[str, Any] = {
        "project": project,
        "id": file.read_text(encoding="utf-8"),
        "dir": str(folder),
    }
    name = folder.resolve().name
    try:
        run: Any = wandb.init(**place, name=name, config=dict(config), resume="allow")
    except wandb.Error as error:
        message = " ".join(str(error).split())
        raise UsageError(f"argument --wandb: {message}; or set WANDB_MODE=offline") from error

    def add(point: Point) -> None:
        if point["steps"] >= run.starting_step:
            run.log(_figures(point), step=point["steps"])

    yield add
    run.finish()


@contextmanager
def curve_logs(
    destinations: Sequence[AbstractContextManager[AddPoint]],
) -> Iterator[Callable[[Sequence[Point]], None]]:
    """Send the points of a growing curve to several destinations, each point once.

    :param destinations: contexts, entered at the first update.
    :return: a context with a function that receives all points of the run so far.
    """
    adders: list[AddPoint] = []
    sent = 0
    with ExitStack() as stack:

        def update(curve: Sequence[Point]) -> None:
            nonlocal sent
            if not adders:
                adders.extend(map(stack.enter_context, destinations))
            for point in curve[sent:]:
                for add in adders:
                    add(point)
            sent = len(curve)

        yield update


def _figures(point: Point) -> dict[str, float]:
    """Return the numbers of a point, without its steps."""
    return {k: v for k, v in point.items() if isinstance(v, (int, float)) and k != "steps"}
