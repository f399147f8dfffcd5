"""Write a network that arms share as one multi-layer perceptron of all arms.

The weights of a shared actor appear once for every arm, in blocks: weight files, inference and
everything else that reads a policy know only perceptrons. The first layer passes every input on,
as x = relu(x) - relu(-x), and encodes each pair of arms; each later layer computes the arms'
layers side by side.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import torch
from torch import Tensor

from saver_advisors.learner.arms import ArmBlocks

Layers = list[tuple[Tensor, Tensor]]


def single_arm_layers(state: Mapping[str, Tensor], outputs: int | None = None) -> Layers:
    """Return the layers of a shared network for one arm, which has no neighbours.

    :param state: of an `ArmNetwork`.
    :param outputs: of the last layer, the first ones; None for all.
    :return: weight and bias of each layer, LayerNorm included.
    """
    numbers = sorted({int(name.split(".")[1]) for name in state if name.startswith("tail.")})
    layers = [(state["own.weight"], state["own.bias"])]
    layers += [(state[f"tail.{one}.weight"], state[f"tail.{one}.bias"]) for one in numbers]
    weight, bias = layers[-1]
    layers[-1] = weight[:outputs], bias[:outputs]
    return layers


def joint_layers(state: Mapping[str, Tensor], arms: ArmBlocks, inputs: tuple[str, ...]) -> Layers:
    """Return the layers of a perceptron that computes the shared network for every arm.

    :param state: of an `ArmNetwork` without LayerNorm, with relu.
    :param arms: the arms.
    :param inputs: observation entries of an arm, in their order.
    :return: weight and bias of each layer; inputs are the entries of all arms in that order,
        outputs those of arm 0, of arm 1, ...
    """
    single = single_arm_layers(state)
    if arms.n_arms == 1:
        return single
    columns = [torch.tensor(own) for own in arms.columns(inputs)]
    first, second = _pair_layer(state, arms, columns), _first_arm_layer(state, arms, columns)
    rest = [
        (torch.block_diag(*[weight] * arms.n_arms), bias.repeat(arms.n_arms))
        for weight, bias in single[1:]
    ]
    return [first, second, *rest]


def joint_columns(arms: ArmBlocks, inputs: tuple[str, ...]) -> Tensor:
    """Return the input of an arm that each input of all arms is.

    :param arms: the arms.
    :param inputs: observation entries of an arm, in their order.
    """
    columns = [torch.tensor(own) for own in arms.columns(inputs)]
    found = torch.zeros(int(torch.cat(columns).max()) + 1, dtype=torch.long)
    for own in columns:
        found[own] = torch.arange(len(own))
    return found


def _pair_layer(
    state: Mapping[str, Tensor], arms: ArmBlocks, columns: list[Tensor]
) -> tuple[Tensor, Tensor]:
    """Pass every input on, positive and negative part, and encode each pair of arms."""
    size, total = len(columns[0]), int(torch.cat(columns).max()) + 1
    of_own, of_other, of_pose = state["pair.weight"].split(
        [size, size, state["pair.weight"].shape[1] - 2 * size], dim=1
    )
    weights, biases = [torch.eye(total), -torch.eye(total)], [torch.zeros(2 * total)]
    for arm, others in enumerate(arms.neighbours()):
        for other, pose in zip(others, arms.poses()[arm], strict=True):
            weight = torch.zeros(len(of_own), total)
            # Added: an input that all arms share is one of both.
            weight[:, columns[arm]] += of_own
            weight[:, columns[other]] += of_other
            weights.append(weight)
            biases.append(state["pair.bias"] + of_pose @ pose)
    return torch.cat(weights), torch.cat(biases)


def _first_arm_layer(
    state: Mapping[str, Tensor], arms: ArmBlocks, columns: list[Tensor]
) -> tuple[Tensor, Tensor]:
    """Compute each arm's first layer from the outputs of `_pair_layer`."""
    own, pool, total = state["own.weight"], state["pool.weight"], int(torch.cat(columns).max()) + 1
    units, encoding = pool.shape
    pairs = arms.n_arms * (arms.n_arms - 1) * encoding
    weight = torch.zeros(arms.n_arms * units, 2 * total + pairs)
    ends = range(2 * total, 2 * total + pairs + 1, encoding * (arms.n_arms - 1))
    for arm, (start, end) in enumerate(pairwise(ends)):
        rows = slice(arm * units, (arm + 1) * units)
        weight[rows, columns[arm]] = own
        weight[rows, columns[arm] + total] = -own
        weight[rows, start:end] = pool.repeat(1, arms.n_arms - 1)
    return weight, state["own.bias"].repeat(arms.n_arms)
