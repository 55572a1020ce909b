"""The action-value network.

Shapes: `N` cars or transitions, `R` rays.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torchrl.modules import MLP, QValueActor

from carrl.errors import ConfigError


class Power(nn.Module):
    """Raises every value, none of them negative, to one exponent."""

    def __init__(self, exponent: float) -> None:
        super().__init__()
        self.exponent = exponent

    def forward(self, values: Tensor) -> Tensor:
        """Of the same shape."""
        return values**self.exponent


def make_q_network(
    hidden_sizes: Sequence[int],
    input_exponent: float = 1.0,
    *,
    observation_size: int,
    action_count: int,
    generator: torch.Generator,
) -> QValueActor:
    """A ReLU network with a linear output that picks the action of the highest value.

    Reads `observation` [N, R]; writes `action_value` [N, 3], `chosen_action_value` [N, 1] and the greedy `action`
    [N], int64. Weights are He-initialised
    (uniform, gain of ReLU) and biases start at zero: with torch's default fewer runs learn to lap (docs/paper.md).

    Readings of a sensor that sees far are small where it matters, near the walls; an `input_exponent` of less than 1
    spreads them: at 0.5 a hundredth of the range becomes a tenth.

    Source: He et al. 2015, "Delving Deep into Rectifiers", eq. 10; layer sizes from the paper's Table I.

    Raises:
        ConfigError: a hidden layer without units, or an exponent that is not positive.
    """
    if any(size < 1 for size in hidden_sizes):
        raise ConfigError(f"network.hidden_sizes is {list(hidden_sizes)}; every layer needs at least 1 unit")
    if not 0 < input_exponent < math.inf:
        raise ConfigError(f"network.input_exponent is {input_exponent}; it must be a positive number")
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
    layers = mlp if input_exponent == 1 else nn.Sequential(Power(input_exponent), *mlp)
    return QValueActor(layers, in_keys=["observation"], action_space="categorical")
