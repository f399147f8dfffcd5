"""Updates from rows of the data, and how a GPU does many small ones quickly."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Final

import torch
from torch import Tensor

#: One update, from a batch of inputs and outputs.
Update = Callable[[Tensor, Tensor], None]

#: Updates before a graph is captured of them: what is set up once (an optimiser's state, the
#: workspaces of matrix products) must be there before.
_WARM_UP: Final = 3


def own_stream(device: torch.device) -> AbstractContextManager[object]:
    """Return a context in which a GPU's work is on a stream of its own, as a capture needs it."""
    if device.type != "cuda":
        return nullcontext()
    stream = torch.cuda.Stream(device)
    stream.wait_stream(torch.cuda.current_stream(device))
    return torch.cuda.stream(stream)


def updates_from(
    update: Update, inputs: Tensor, outputs: Tensor, batch_size: int
) -> Callable[[Tensor], None]:
    """Return what learns from given rows of the data.

    :param update: what learns from a batch.
    :param inputs: (n, inputs), on the device that trains.
    :param outputs: (n, outputs), there too.
    :param batch_size: rows of nearly every update.
    """
    if inputs.is_cuda:
        return CapturedUpdate(update, inputs, outputs, batch_size)
    return lambda rows: update(inputs[rows], outputs[rows])


class CapturedUpdate:
    """An update that a CUDA graph replays.

    An update of these networks is a hundred kernels of a few microseconds each: launched one by
    one from Python, the GPU would wait most of the time. The first updates and those of other batch
    sizes are launched so all the same; none is done twice, and none is left out.

    :param update: what learns from a batch; it may not wait for the GPU.
    :param inputs: (n, inputs), on the GPU.
    :param outputs: (n, outputs), there too.
    :param batch_size: rows of an update that is captured.
    """

    def __init__(self, update: Update, inputs: Tensor, outputs: Tensor, batch_size: int) -> None:
        self._update, self._inputs, self._outputs = update, inputs, outputs
        self._rows = torch.zeros(batch_size, dtype=torch.int64, device=inputs.device)
        self._graph: torch.cuda.CUDAGraph | None = None
        self._warm_up = _WARM_UP

    def __call__(self, rows: Tensor) -> None:
        """Learn from rows of the data, (batch,) indices."""
        if len(rows) != len(self._rows):
            self._learn(rows)
        elif self._warm_up:
            self._warm_up -= 1
            self._learn(rows)
        else:
            self._rows.copy_(rows)
            if self._graph is None:
                self._graph = self._captured()
            self._graph.replay()

    def _learn(self, rows: Tensor) -> None:
        self._update(self._inputs[rows], self._outputs[rows])

    def _captured(self) -> torch.cuda.CUDAGraph:
        """What is captured is not done: the first replay does it."""
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph, stream=torch.cuda.current_stream()):
            self._learn(self._rows)
        return graph
