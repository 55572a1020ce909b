"""An actor, which says what to do, and critics, which value it.

Shapes: `N` cars or transitions, `O` values of an observation, `C` controls.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import torch
from tensordict.nn import NormalParamExtractor
from torch import Tensor, nn
from torchrl.modules import MLP

from carrl.algorithms.common.network import Power, check_hidden_sizes, initialise, on_powers, power_of

Activation = Literal["relu", "tanh", "elu"]
_ACTIVATIONS = {"relu": nn.ReLU, "tanh": nn.Tanh, "elu": nn.ELU}
_LAST_BOUND = 3e-3


class Actor(nn.Module):
    """Layers from observations to an action, or to a normal distribution that tanh squashes.

    Args:
        layers: with an output for each control; of a stochastic actor with a second one for each, after those.
        is_stochastic: whether actions are drawn.
    """

    def __init__(self, layers: nn.Module, is_stochastic: bool) -> None:
        super().__init__()
        self.layers, self.is_stochastic = layers, is_stochastic
        self.distribution = NormalParamExtractor()

    def forward(self, observation: Tensor) -> Tensor | tuple[Tensor, Tensor]:
        """The action [N, C] within -1 and 1, or mean and standard deviation before tanh, [N, C] each."""
        outputs = self.layers(observation)
        return self.distribution(outputs) if self.is_stochastic else outputs.tanh()


class Critic(nn.Module):
    """Layers that value an action.

    Args:
        layers: from an observation, followed by an action, to one value.
        power: which the observation is raised to first; None for none.
    """

    def __init__(self, layers: nn.Module, power: Power | None = None) -> None:
        super().__init__()
        self.layers, self.power = layers, power

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        """The discounted return that is expected after it, [N, 1]: observations [N, O], actions [N, C]."""
        seen = observation if self.power is None else self.power(observation)
        value: Tensor = self.layers(torch.cat([seen, action], dim=-1))
        return value


class ActorCritic(NamedTuple):
    """What a replicate learns: checkpoints keep the actor alone."""

    actor: Actor
    critics: Sequence[Critic]


def make_actor_critic(
    actor_sizes: Sequence[int],
    critic_sizes: Sequence[int],
    activation: Activation,
    input_exponent: float = 1.0,
    *,
    observation_size: int,
    controls: int,
    is_stochastic: bool,
    critics: int,
    generator: torch.Generator,
) -> ActorCritic:
    """An actor and critics without any layers in common.

    Hidden layers are He-initialised as DQN's are; the last ones are drawn so small that the first actions are near the
    middle, and the first values near zero.

    Source: Lillicrap et al. 2016, "Continuous control with deep reinforcement learning", section 7, for the last layer.

    Args:
        actor_sizes: units of each of the actor's hidden layers.
        critic_sizes: units of each of a critic's hidden layers.
        activation: of the hidden layers: relu, tanh or elu.
        input_exponent: that the sizes of observations are raised to first; less than 1 spreads the short distances of a
            long range, as in `make_q_network`.
        observation_size: how many values an observation has.
        controls: how many numbers an action has.
        is_stochastic: whether actions are drawn.
        critics: how many critics there are.
        generator: draws the weights.

    Raises:
        ConfigError: a hidden layer without units, too many layers or weights, or an exponent that is not positive.
    """
    outputs = 2 * controls if is_stochastic else controls
    check_hidden_sizes(actor_sizes, observation_size, outputs, "actor_sizes")
    check_hidden_sizes(critic_sizes, observation_size + controls, 1, "critic_sizes")
    actor = on_powers(_layers(observation_size, actor_sizes, outputs, activation, generator), input_exponent)
    valuing = [_layers(observation_size + controls, critic_sizes, 1, activation, generator) for _ in range(critics)]
    power = power_of(input_exponent)
    return ActorCritic(Actor(actor, is_stochastic), [Critic(layers, power) for layers in valuing])


def _layers(
    inputs: int, hidden_sizes: Sequence[int], outputs: int, activation: Activation, generator: torch.Generator
) -> nn.Sequential:
    layers = MLP(
        in_features=inputs,
        out_features=outputs,
        num_cells=list(hidden_sizes),
        activation_class=_ACTIVATIONS[activation],
    )
    initialise(layers, generator)
    nn.init.uniform_(layers[-1].weight, -_LAST_BOUND, _LAST_BOUND, generator=generator)
    return layers
