"""A network that predicts, for every action, how probable each return is.

Shapes: `N` cars or transitions, `K` atoms, the returns whose probabilities are predicted.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torchrl.modules import MLP

from carrl.algorithms.common.network import QNetwork, check_hidden_sizes, initialise, on_powers
from carrl.errors import ConfigError


class ReturnDistribution(nn.Module):
    """Layers whose outputs are the logits of the returns' probabilities; called, it gives the expected returns.

    Args:
        layers: from observations to logits, [N, 3 K].
        support: the returns, evenly spaced and rising, [K].
    """

    support: Tensor

    def __init__(self, layers: nn.Module, support: Tensor) -> None:
        super().__init__()
        self.layers = layers
        self.register_buffer("support", support)

    def log_probabilities(self, observation: Tensor) -> Tensor:
        """Of every action's returns, [N, 3, K]: observations [N, ...]."""
        return self.layers(observation).unflatten(-1, (-1, len(self.support))).log_softmax(-1)

    def forward(self, observation: Tensor) -> Tensor:
        """The value of every action, [N, 3]."""
        return self.log_probabilities(observation).exp() @ self.support


def make_distributional_network(
    hidden_sizes: Sequence[int],
    atoms: int,
    least_return: float,
    greatest_return: float,
    input_exponent: float = 1.0,
    *,
    observation_size: int,
    action_count: int,
    generator: torch.Generator,
) -> QNetwork:
    """A network of `ReturnDistribution`; beside the values it reads and writes what `make_q_network` does.

    Raises:
        ConfigError: as `make_q_network`, and for fewer than 2 atoms, or returns in no range.
    """
    if atoms < 2:
        raise ConfigError(f"network.atoms is {atoms}; it must be at least 2")
    check_hidden_sizes(hidden_sizes, observation_size, action_count * atoms)
    if not -math.inf < least_return < greatest_return < math.inf:
        raise ConfigError(
            f"network.least_return is {least_return} and greatest_return is {greatest_return}; "
            "they must be numbers, and the first one less than the second"
        )
    mlp = MLP(
        in_features=observation_size,
        out_features=action_count * atoms,
        num_cells=list(hidden_sizes),
        activation_class=nn.ReLU,
    )
    initialise(mlp, generator)
    support = torch.linspace(least_return, greatest_return, atoms)
    distribution = ReturnDistribution(on_powers(mlp, input_exponent), support)
    return QNetwork(distribution)


def predicts_distribution(network: QNetwork) -> bool:
    """Whether the network is one of these."""
    return isinstance(network.layers, ReturnDistribution)
