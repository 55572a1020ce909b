"""The action-value networks.

Shapes: `N` cars or transitions, `O` values of an observation, `K` actions; `Z` atoms, the returns whose probabilities
a distributional network predicts.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torchrl.modules import MLP, NoisyLinear, QValueActor
from torchrl.modules.models import DuelingMlpDQNet

from carrl.errors import ConfigError, shown

MOST_LAYERS = 64
MOST_WEIGHTS = 2**26
"""Of a network, all layers together: 256 MiB; the paper's has 400."""


class Power(nn.Module):
    """Raises the size of every value to one exponent; signs stay."""

    def __init__(self, exponent: float) -> None:
        super().__init__()
        self.exponent = exponent

    def forward(self, values: Tensor) -> Tensor:
        """Of the same shape."""
        return values.sign() * values.abs() ** self.exponent


class QNetwork(QValueActor):
    """Layers that value every action, and the action of the highest value.

    Reads `observation` [N, O]; writes `action_value` [N, K], `chosen_action_value` [N, 1] and the greedy `action` [N],
    int64.
    """

    def __init__(self, layers: nn.Module) -> None:
        super().__init__(layers, in_keys=["observation"], action_space="categorical")

    @property
    def layers(self) -> nn.Module:
        """From observations to values."""
        layers: nn.Module = self.module[0].module
        return layers


class ReturnDistribution(nn.Module):
    """Layers whose outputs are the logits of the returns' probabilities; called, it gives the expected returns.

    Args:
        layers: from observations to logits, [N, K Z].
        support: the returns, evenly spaced and rising, [Z].
    """

    support: Tensor

    def __init__(self, layers: nn.Module, support: Tensor) -> None:
        super().__init__()
        self.layers = layers
        self.register_buffer("support", support)

    def log_probabilities(self, observation: Tensor) -> Tensor:
        """Of every action's returns, [N, K, Z]: observations [N, ...]."""
        return self.layers(observation).unflatten(-1, (-1, len(self.support))).log_softmax(-1)

    def forward(self, observation: Tensor) -> Tensor:
        """The value of every action, [N, K]."""
        return self.log_probabilities(observation).exp() @ self.support


def make_q_network(
    hidden_sizes: Sequence[int],
    input_exponent: float = 1.0,
    *,
    observation_size: int,
    action_count: int,
    generator: torch.Generator,
) -> QNetwork:
    """A ReLU network with a linear output that picks the action of the highest value.

    Weights are He-initialised (uniform, gain of ReLU) and biases start at zero: with torch's default fewer runs learn
    to lap (docs/paper.md).

    Readings of a sensor that sees far are small where it matters, near the walls; an `input_exponent` of less than 1
    spreads them: at 0.5 a hundredth of the range becomes a tenth.

    Source: He et al. 2015, "Delving Deep into Rectifiers", eq. 10; layer sizes from the paper's Table I.

    Args:
        hidden_sizes: ReLU units of each hidden layer.
        input_exponent: that observations are raised to first; less than 1 spreads the short distances of a long range.
        observation_size: how many values an observation has.
        action_count: how many actions there are.
        generator: draws the weights.

    Raises:
        ConfigError: a hidden layer without units, too many layers or weights, or an exponent that is not positive.
    """
    check_hidden_sizes(hidden_sizes, observation_size, action_count)
    mlp = MLP(
        in_features=observation_size,
        out_features=action_count,
        num_cells=list(hidden_sizes),
        activation_class=nn.ReLU,
    )
    initialise(mlp, generator)
    return QNetwork(on_powers(mlp, input_exponent))


def make_dueling_network(
    hidden_sizes: Sequence[int],
    input_exponent: float = 1.0,
    *,
    observation_size: int,
    action_count: int,
    generator: torch.Generator,
) -> QNetwork:
    """A network that values the situation and, beside it, how much better each action is than their mean.

    Both streams have a hidden layer of their own, of the last of the sizes, and share all layers before. What it reads
    and writes, and how it is initialised, is as in `make_q_network`.

    Source: Wang et al. 2016, "Dueling Network Architectures for Deep Reinforcement Learning", eq. 9.

    Args:
        hidden_sizes: ReLU units of each hidden layer; the last one is there twice, once for each of the two streams.
        input_exponent: that observations are raised to first; less than 1 spreads the short distances of a long range.
        observation_size: how many values an observation has.
        action_count: how many actions there are.
        generator: draws the weights.

    Raises:
        ConfigError: as `make_q_network`, and for fewer than two hidden layers.
    """
    check_hidden_sizes(hidden_sizes, observation_size, action_count)
    if len(hidden_sizes) < 2:
        raise ConfigError(
            f"network.hidden_sizes is {list(hidden_sizes)}; a dueling network has at least 2: the last one is that of "
            "its two streams, and the others they share"
        )
    *shared, joint, stream = hidden_sizes
    layers = DuelingMlpDQNet(
        action_count,
        mlp_kwargs_feature={
            "in_features": observation_size,
            "out_features": joint,
            "num_cells": shared,
            "depth": len(shared),
            "activation_class": nn.ReLU,
        },
        mlp_kwargs_output={"in_features": joint, "num_cells": [stream], "activation_class": nn.ReLU},
    )
    initialise(layers, generator)
    return QNetwork(on_powers(layers, input_exponent))


def make_noisy_network(
    hidden_sizes: Sequence[int],
    initial_noise: float,
    input_exponent: float = 1.0,
    *,
    observation_size: int,
    action_count: int,
    generator: torch.Generator,
) -> QNetwork:
    """A ReLU network whose weights are disturbed by noise of a strength that is learnt, while it explores and learns.

    What it reads and writes is as in `make_q_network`; the noise is drawn by
    `carrl.algorithms.common.weight_noise`. Greedy drives have none.

    Source: Fortunato et al. 2018, "Noisy Networks for Exploration", section 3.2 with factorised noise.

    Args:
        hidden_sizes: ReLU units of each hidden layer.
        initial_noise: standard deviation of the noise at first, times 1 / sqrt(inputs of the layer).
        input_exponent: that observations are raised to first; less than 1 spreads the short distances of a long range.
        observation_size: how many values an observation has.
        action_count: how many actions there are.
        generator: draws the weights.

    Raises:
        ConfigError: as `make_q_network`, and for noise of a strength that is none.
    """
    check_hidden_sizes(hidden_sizes, observation_size, action_count)
    if not 0 <= initial_noise < math.inf:
        raise ConfigError(f"network.initial_noise is {initial_noise}; it must be a number of at least 0")
    mlp = MLP(
        in_features=observation_size,
        out_features=action_count,
        num_cells=list(hidden_sizes),
        activation_class=nn.ReLU,
        layer_class=NoisyLinear,
        layer_kwargs={"std_init": initial_noise},
    )
    for layer in mlp:
        if isinstance(layer, NoisyLinear):
            bound = 1 / math.sqrt(layer.in_features)
            layer.weight_mu.data.uniform_(-bound, bound, generator=generator)
            layer.bias_mu.data.uniform_(-bound, bound, generator=generator)
            layer.weight_epsilon.zero_()  # TorchRL drew them from torch's own generator
            layer.bias_epsilon.zero_()
    return QNetwork(on_powers(mlp, input_exponent))


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

    Args:
        hidden_sizes: ReLU units of each hidden layer.
        atoms: returns whose probabilities are predicted, evenly spaced.
        least_return: the least of them; discounted returns below count as this one.
        greatest_return: the greatest of them.
        input_exponent: that observations are raised to first; less than 1 spreads the short distances of a long range.
        observation_size: how many values an observation has.
        action_count: how many actions there are.
        generator: draws the weights.

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


def on_powers(layers: nn.Module, input_exponent: float) -> nn.Module:
    """The layers, which then read their inputs raised to the exponent.

    Raises:
        ConfigError: the exponent is not positive.
    """
    power = power_of(input_exponent)
    if power is None:
        return layers
    following = layers if isinstance(layers, nn.Sequential) else [layers]
    return nn.Sequential(power, *following)


def power_of(input_exponent: float) -> Power | None:
    """What raises inputs to the exponent; None where they stay as they are.

    Raises:
        ConfigError: the exponent is not positive.
    """
    if not 0 < input_exponent < math.inf:
        raise ConfigError(f"network.input_exponent is {input_exponent}; it must be a positive number")
    return None if input_exponent == 1 else Power(input_exponent)


def is_dueling(network: QNetwork) -> bool:
    """Whether `make_dueling_network` made it."""
    return any(isinstance(module, DuelingMlpDQNet) for module in network.modules())


def predicts_distribution(network: QNetwork) -> bool:
    """Whether the network is one of these."""
    return isinstance(network.layers, ReturnDistribution)


def check_hidden_sizes(hidden_sizes: Sequence[int], inputs: int, outputs: int, key: str = "hidden_sizes") -> None:
    """Raises ConfigError for a hidden layer without units, and for too many layers or weights."""
    if any(size < 1 for size in hidden_sizes):
        raise ConfigError(f"network.{key} is {shown(list(hidden_sizes))}; every layer needs at least 1 unit")
    sizes = [inputs, *hidden_sizes, outputs]
    weights = sum(before * after for before, after in pairwise(sizes))
    if len(hidden_sizes) > MOST_LAYERS or weights > MOST_WEIGHTS:
        raise ConfigError(
            f"network.{key} has {len(hidden_sizes)} layers with {weights} weights; "
            f"it may have at most {MOST_LAYERS} layers and {MOST_WEIGHTS} weights"
        )


def initialise(layers: nn.Module, generator: torch.Generator) -> None:
    """Draws the weights of all linear layers anew, as `make_q_network` says."""
    for layer in layers.modules():
        if isinstance(layer, nn.Linear):
            nn.init.kaiming_uniform_(layer.weight, nonlinearity="relu", generator=generator)
            nn.init.zeros_(layer.bias)
