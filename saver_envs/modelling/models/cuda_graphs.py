"""Training updates from rows of the data, replayed as a CUDA graph on a GPU."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Final

import torch
from torch import Tensor

#: One update, from a batch of inputs and outputs.
Update = Callable[[Tensor, Tensor], None]

#: Updates before the graph is recorded: it needs what the first ones allocate (the optimiser's
#: state, workspaces of matrix products).
_WARM_UP: Final = 3


def own_stream(device: torch.device) -> AbstractContextManager[object]:
    """Return a context in which a GPU works on its own stream, as recording a graph requires."""
    if device.type != "cuda":
        return nullcontext()
    stream = torch.cuda.Stream(device)
    stream.wait_stream(torch.cuda.current_stream(device))
    return torch.cuda.stream(stream)


def updates_from(
    update: Update, inputs: Tensor, outputs: Tensor, batch_size: int
) -> Callable[[Tensor], None]:
    """Return a function that updates from given rows of the data.

    :param update: one update, from a batch.
    :param inputs: (n, inputs), on the training device.
    :param outputs: (n, outputs), on the training device.
    :param batch_size: rows of all updates but the last of an epoch.
    :return: function of row indices (batch,).
    """
    if inputs.is_cuda:
        return CudaGraphUpdate(update, inputs, outputs, batch_size)
    return lambda rows: update(inputs[rows], outputs[rows])


class CudaGraphUpdate:
    """An update that a CUDA graph replays.

    An update of these networks is a hundred kernels of a few microseconds each: launched one by
    one from Python, they would leave the GPU idle most of the time. The first updates, and those of
    other batch sizes, are launched that way; each update runs exactly once.

    :param update: one update, from a batch; it must not synchronise with the GPU.
    :param inputs: (n, inputs), on the GPU.
    :param outputs: (n, outputs), on the GPU.
    :param batch_size: rows of an update that the graph replays.
    """

    def __init__(self, update: Update, inputs: Tensor, outputs: Tensor, batch_size: int) -> None:
        self._update, self._inputs, self._outputs = update, inputs, outputs
        self._rows = torch.zeros(batch_size, dtype=torch.int64, device=inputs.device)
        self._graph: torch.cuda.CUDAGraph | None = None
        self._warm_up = _WARM_UP

    def __call__(self, rows: Tensor) -> None:
        """Update from rows of the data, indices (batch,)."""
        if len(rows) != len(self._rows):
            self._learn(rows)
        elif self._warm_up:
            self._warm_up -= 1
            self._learn(rows)
        else:
            self._rows.copy_(rows)
            if self._graph is None:
                self._graph = self._recorded()
            self._graph.replay()

    def _learn(self, rows: Tensor) -> None:
        self._update(self._inputs[rows], self._outputs[rows])

    def _recorded(self) -> torch.cuda.CUDAGraph:
        """Record the graph, which runs at its first replay."""
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph, stream=torch.cuda.current_stream()):
            self._learn(self._rows)
        return graph
