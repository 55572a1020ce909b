"""The action-value network.

Shapes: `N` cars or transitions, `R` rays.
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import nn
from torchrl.modules import MLP, QValueActor

from carrl.errors import ConfigError, shown

MOST_LAYERS = 64
MOST_WEIGHTS = 2**26
"""Of a network, all layers together: 256 MiB; the paper's has 400."""


def make_q_network(
    hidden_sizes: Sequence[int], *, observation_size: int, action_count: int, generator: torch.Generator
) -> QValueActor:
    """A ReLU network with a linear output that picks the action of the highest value.

    Reads `observation` [N, R]; writes `action_value` [N, 3], `chosen_action_value` [N, 1] and the greedy `action`
    [N], int64. Weights are He-initialised
    (uniform, gain of ReLU) and biases start at zero: with torch's default fewer runs learn to lap (docs/paper.md).

    Source: He et al. 2015, "Delving Deep into Rectifiers", eq. 10; layer sizes from the paper's Table I.

    Raises:
        ConfigError: a hidden layer without units, or too many layers or weights.
    """
    if any(size < 1 for size in hidden_sizes):
        raise ConfigError(f"network.hidden_sizes is {shown(list(hidden_sizes))}; every layer needs at least 1 unit")
    sizes = [observation_size, *hidden_sizes, action_count]
    weights = sum(before * after for before, after in pairwise(sizes))
    if len(hidden_sizes) > MOST_LAYERS or weights > MOST_WEIGHTS:
        raise ConfigError(
            f"network.hidden_sizes has {len(hidden_sizes)} layers with {weights} weights; "
            f"it may have at most {MOST_LAYERS} layers and {MOST_WEIGHTS} weights"
        )
    mlp = MLP(
        in_features=observation_size,
        out_features=action_count,
        num_cells=list(hidden_sizes),
        activation_class=nn.ReLU,
    )
    for layer in mlp:
        if isinstance(layer, nn.Linear):
            nn.init.kaiming_uniform_(layer.weight, nonlinearity="relu", generator=generator)
            nn.init.zeros_(layer.bias)
    return QValueActor(mlp, in_keys=["observation"], action_space="categorical")
