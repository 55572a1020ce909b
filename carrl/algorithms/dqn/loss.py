"""What the network learns from: TorchRL's DQN loss, its Double DQN variant, and two losses built on it.

Shapes: `N` transitions.
"""

import math
from typing import Any, Literal, TypeVar

from tensordict import TensorDictBase, TensorDictParams
from torch import Tensor
from torchrl.objectives import DQNLoss

from carrl.algorithms.common.network import QNetwork, is_dueling
from carrl.algorithms.dqn.return_distribution import predicts_distribution
from carrl.errors import ConfigError

_Loss = TypeVar("_Loss", bound=DQNLoss)


def make_dqn_loss(
    gamma: float,
    loss_function: Literal["l2", "smooth_l1"],
    double_dqn: bool,
    *,
    network: QNetwork,
) -> DQNLoss:
    """The squared (or smooth L1) TD error against a target network of its own.

    A terminated transition has the target r; every other one, truncated or not, has r + gamma * Q(s', a'), where the
    target network picks a' in DQN and the trained network picks it in Double DQN.

    Source: Mnih et al. 2015, "Human-level control through deep reinforcement learning"; van Hasselt et al. 2016,
    "Deep Reinforcement Learning with Double Q-learning".

    Raises:
        ConfigError: gamma lies outside 0..1, or the network predicts a distribution.
    """
    return _make(DQNLoss, network, gamma, loss_function, double_dqn)


def make_dueling_loss(
    gamma: float,
    loss_function: Literal["l2", "smooth_l1"],
    double_dqn: bool,
    *,
    network: QNetwork,
) -> DQNLoss:
    """The loss of `make_dqn_loss` for a dueling network, and for no other.

    Raises:
        ConfigError: gamma lies outside 0..1, or the network is another one.
    """
    if not is_dueling(network):
        raise ConfigError("loss is dueling, and the network is not; set network=dueling, or another loss")
    return make_dqn_loss(gamma, loss_function, double_dqn, network=network)


def make_cql_loss(
    gamma: float,
    loss_function: Literal["l2", "smooth_l1"],
    double_dqn: bool,
    alpha: float,
    *,
    network: QNetwork,
) -> "ConservativeDQNLoss":
    """The loss of `make_dqn_loss` plus `alpha` times how far the actions in all are valued above the one taken.

    Source: Kumar et al. 2020, "Conservative Q-Learning for Offline Reinforcement Learning", eq. 4, whose TD error is
    halved, so that the paper's alpha is half of this one.

    Raises:
        ConfigError: gamma lies outside 0..1, alpha is negative, or the network predicts a distribution.
    """
    if not 0 <= alpha < math.inf:
        raise ConfigError(f"loss.alpha is {alpha}; it must be a number of at least 0")
    return _make(ConservativeDQNLoss, network, gamma, loss_function, double_dqn, alpha=alpha)


class ConservativeDQNLoss(DQNLoss):
    """TorchRL's DQN loss and, with a weight, the conservative term of discrete CQL: log sum exp Q(s, .) - Q(s, a).

    TorchRL 0.14 has a `DiscreteCQLLoss` with the same two terms, but it never reads its target network and knows no
    Double DQN; `test_torchrls_own_cql_loss_does_not_read_its_target_network` pins it.

    Args:
        network: that is trained.
        alpha: weight of the conservative term.
        options: of `DQNLoss`.
    """

    def __init__(self, network: QNetwork, *, alpha: float, **options: Any) -> None:
        super().__init__(network, **options)
        self.alpha = alpha

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The sum of both terms under `loss`, []: transitions [N] as `DQNLoss` takes them."""
        losses = super().forward(tensordict)
        losses["loss"] = losses["loss"] + self.alpha * self._excess(tensordict).mean()
        return losses

    def _excess(self, tensordict: TensorDictBase) -> Tensor:
        """How far the actions' values in all exceed that of the action taken, [N]."""
        values, taken = _action_values(self, self.value_network_params, tensordict)
        return values.logsumexp(dim=-1) - taken


def make_advantage_learning_loss(
    gamma: float,
    loss_function: Literal["l2", "smooth_l1"],
    double_dqn: bool,
    alpha: float,
    *,
    network: QNetwork,
) -> "AdvantageLearningLoss":
    """The loss of `make_dqn_loss`, in which an action that the target network values below the best one earns less.

    The reward falls by `alpha` times the gap max Q(s, .) - Q(s, a). Gaps so grow to 1 / (1 - alpha) times what they
    are, and the network's error hides them less, which matters where one short step changes little. Which action is the
    best stays the same, and so does its value.

    Source: Baird 1999, "Reinforcement Learning Through Gradient Descent"; Bellemare et al. 2016, "Increasing the Action
    Gap: New Operators for Reinforcement Learning", the advantage learning operator.

    Raises:
        ConfigError: gamma lies outside 0..1, alpha is not at least 0 and less than 1, or the network predicts a
            distribution.
    """
    if not 0 <= alpha < 1:
        raise ConfigError(f"loss.alpha is {alpha}; it must be at least 0 and less than 1")
    return _make(AdvantageLearningLoss, network, gamma, loss_function, double_dqn, alpha=alpha)


class AdvantageLearningLoss(DQNLoss):
    """TorchRL's DQN loss on rewards lowered by how far the action falls behind the best one.

    Args:
        network: that is trained.
        alpha: share of the gap that the reward falls by.
        options: of `DQNLoss`.
    """

    def __init__(self, network: QNetwork, *, alpha: float, **options: Any) -> None:
        super().__init__(network, **options)
        self.alpha = alpha

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The loss, [], under `loss`: transitions [N] as `DQNLoss` takes them; writes their `td_error`, too."""
        values, taken = _action_values(self, self.target_value_network_params, tensordict)
        reward_key = ("next", self.tensor_keys.reward)
        reward = tensordict[reward_key]
        lowered = tensordict.copy()
        lowered[reward_key] = reward - self.alpha * (values.amax(dim=-1) - taken).detach().view_as(reward)
        losses = super().forward(lowered)
        tensordict[self.tensor_keys.priority] = lowered[self.tensor_keys.priority]
        return losses


def _action_values(loss: DQNLoss, parameters: TensorDictParams, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
    """The values of all actions before a transition, [N, 3], and of the one taken, [N], by the loss's network."""
    read = tensordict.select(*loss.value_network.in_keys)
    with parameters.to_module(loss.value_network, preserve_module_state=False):
        values = loss.value_network(read)[loss.tensor_keys.action_value]
    taken = values.gather(-1, tensordict[loss.tensor_keys.action].unsqueeze(-1)).squeeze(-1)
    return values, taken


def _make(
    kind: type[_Loss], network: QNetwork, gamma: float, loss_function: str, double_dqn: bool, **own: float
) -> _Loss:
    """A loss of this kind on values that are points; `own` are the kind's own weights."""
    if predicts_distribution(network):
        raise ConfigError(
            "network is distributional, which loss=distributional alone can train; set it, or another network"
        )
    loss = kind(
        network,
        **own,
        loss_function=loss_function,
        delay_value=True,
        double_dqn=double_dqn,
        action_space="categorical",
    )
    set_discount(loss, gamma)
    return loss


def set_discount(loss: DQNLoss, gamma: float) -> None:
    """Raises ConfigError if the discount lies outside 0..1."""
    if not 0 <= gamma <= 1:
        raise ConfigError(f"loss.gamma is {gamma}; it must lie in 0..1")
    loss.make_value_estimator(gamma=gamma)  # DQNLoss(gamma=...) raises since torchrl 0.3
