"""What the network learns from: TorchRL's DQN loss and its Double DQN variant."""

from typing import Literal

from torchrl.modules import QValueActor
from torchrl.objectives import DQNLoss

from carrl.errors import ConfigError


def make_dqn_loss(
    gamma: float,
    loss_function: Literal["l2", "smooth_l1"],
    double_dqn: bool,
    *,
    network: QValueActor,
) -> DQNLoss:
    """The squared (or smooth L1) TD error against a target network of its own.

    A terminated transition has the target r; every other one, truncated or not, has r + gamma * Q(s', a'), where the
    target network picks a' in DQN and the trained network picks it in Double DQN.

    Source: Mnih et al. 2015, "Human-level control through deep reinforcement learning"; van Hasselt et al. 2016,
    "Deep Reinforcement Learning with Double Q-learning".

    Raises:
        ConfigError: gamma lies outside 0..1.
    """
    if not 0 <= gamma <= 1:
        raise ConfigError(f"loss.gamma is {gamma}; it must lie in 0..1")
    loss = DQNLoss(
        network, loss_function=loss_function, delay_value=True, double_dqn=double_dqn, action_space="categorical"
    )
    loss.make_value_estimator(gamma=gamma)  # DQNLoss(gamma=...) raises since torchrl 0.3
    return loss
