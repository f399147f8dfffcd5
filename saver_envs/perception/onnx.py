"""Export a pose network as ONNX and run it with onnxruntime."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from saver_envs.perception.estimator import NETWORK_SIZE
from saver_envs.perception.network import PoseNetwork


class _LastStage(nn.Module):
    def __init__(self, network: PoseNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, pictures: Tensor) -> Tensor:
        return self.network(pictures)[1]


def export_onnx(network: PoseNetwork, path: Path, size: tuple[int, int] = NETWORK_SIZE) -> None:
    """Write a network as ONNX.

    The input is ``pictures`` (1, 3, h, w), the output ``fields`` (1, limbs, 3, h/8, w/8).

    :param network: with trained weights.
    :param path: ending in ``.onnx``.
    :param size: fixed height and width of the pictures.
    """
    # The exporter warns about every missing optional package.
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    example = torch.zeros(1, 3, *size)
    program = torch.onnx.export(
        _LastStage(network).eval(),
        (example,),
        input_names=["pictures"],
        output_names=["fields"],
        dynamo=True,
        verbose=False,
    )
    assert program is not None  # as with every export by dynamo
    program.model.metadata_props["limbs"] = json.dumps(network.limbs)
    program.save(path, external_data=False)


class OnnxNetwork:
    """Runs an exported network; the argument ``run`` of :class:`~.estimator.PoseEstimator`.

    :param path: file from :func:`export_onnx`.
    :param threads: number of processor threads.
    """

    def __init__(self, path: Path, threads: int = 1) -> None:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.inter_op_num_threads = 1
        self._session: Any = onnxruntime.InferenceSession(
            str(path), options, providers=["CPUExecutionProvider"]
        )
        self.limbs = tuple(json.loads(self._session.get_modelmeta().custom_metadata_map["limbs"]))

    def __call__(self, pictures: NDArray[np.float32]) -> NDArray[np.float32]:
        """Compute the last stage's fields (1, limbs, 3, h/8, w/8) of a picture (1, 3, h, w)."""
        return self._session.run(None, {"pictures": pictures})[0]
