"""What the network learns from: TorchRL's DQN loss, its Double DQN variant, two losses built on it, and C51's.

Shapes: `N` transitions, `K` atoms, the returns whose probabilities C51 predicts.
"""

import math
from typing import Any, Literal, TypeVar

import torch
from tensordict import TensorDict, TensorDictBase, TensorDictParams
from torch import Tensor
from torchrl.objectives import DQNLoss

from carrl.algorithms.common.network import QNetwork, is_dueling, predicts_distribution
from carrl.errors import ConfigError


def make_distributional_loss(gamma: float, double_dqn: bool, *, network: QNetwork) -> "DistributionalLoss":
    """The cross entropy between the predicted returns and those that a target network expects after the transition.

    Args:
        gamma: discount factor.
        double_dqn: whether the trained network picks the next action; else the target network does, as in the first
            C51.
        network: that is trained.

    Raises:
        ConfigError: gamma lies outside 0..1, or the network predicts no distribution.
    """
    if not predicts_distribution(network):
        raise ConfigError("loss is distributional, and the network is not; set network=distributional")
    loss = DistributionalLoss(
        network, loss_function="l2", delay_value=True, double_dqn=double_dqn, action_space="categorical"
    )
    set_discount(loss, gamma)
    return loss


class DistributionalLoss(DQNLoss):
    """Categorical distributional Q-learning, with the keys, parameters and discount of TorchRL's `DQNLoss`.

    The numbers are those of TorchRL 0.14's `DistributionalDQNLoss` (a test compares them). That one cannot be traced,
    as it takes numbers out of tensors, always lets the trained network pick the next action, and notes the cross
    entropy as `td_error`, where this one notes the squared error of the expected return, as every loss here does.

    Source: Bellemare et al. 2017, "A Distributional Perspective on Reinforcement Learning", Algorithm 1.
    """

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The mean cross entropy under `loss`, []: transitions [N] as `DQNLoss` takes them."""
        action = tensordict[self.tensor_keys.action]
        logarithms = _of_action(self._log_probabilities(tensordict, self.value_network_params), action)
        with torch.no_grad():
            target = self._target(tensordict)
            td_error = ((target - logarithms.exp()) @ self._support).square()
        tensordict.set(self.tensor_keys.priority, td_error[:, None], inplace=True)
        weights = tensordict.get(self.tensor_keys.priority_weight, None)
        return TensorDict(
            loss=self._reduce_loss(-(target * logarithms).sum(-1), tensordict=tensordict, weights=weights)
        )

    def _target(self, transitions: TensorDictBase) -> Tensor:
        """The probabilities of the returns after the transitions, by the target network, [N, K]."""
        after = transitions["next"]
        expected = self._log_probabilities(after, self.target_value_network_params).exp()
        choosing = self._log_probabilities(after, self.value_network_params).exp() if self.double_dqn else expected
        next_action = (choosing @ self._support).argmax(-1)
        discount = self.value_estimator.gamma
        steps = transitions.get("steps_to_next_obs", None)
        if steps is not None:
            discount = discount**steps
        returns = after["reward"] + discount * ~after["terminated"] * self._support
        return _projected(_of_action(expected, next_action), returns, self._support)

    @property
    def _support(self) -> Tensor:
        return self.value_network_params["module", "0", "module", "support"]

    def _log_probabilities(self, transitions: TensorDictBase, parameters: TensorDictBase) -> Tensor:
        with parameters.to_module(self.value_network, preserve_module_state=False):
            return self.value_network.layers.log_probabilities(transitions["observation"])


def _of_action(values: Tensor, action: Tensor) -> Tensor:
    """Those of one action each: [N, 3, K] and [N] to [N, K]."""
    return values.gather(1, action[:, None, None].expand(-1, 1, values.shape[-1])).squeeze(1)


def _projected(probabilities: Tensor, returns: Tensor, support: Tensor) -> Tensor:
    """The probabilities of other returns, [N, K] each, shared out among the neighbouring atoms of the support [K].

    Returns beyond the support count as its ends. Source: Bellemare et al. 2017, eq. 7.
    """
    spacing = (support[-1] - support[0]) / (len(support) - 1)
    clamped = returns.clamp(support[0], support[-1])
    share = (1 - (clamped[:, None, :] - support[:, None]).abs() / spacing).clamp(min=0)
    return (share * probabilities[:, None, :]).sum(-1)


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

    Args:
        gamma: discount factor.
        loss_function: `l2`, the mean squared error, or `smooth_l1`, Huber's, which grows linearly where the TD error
            exceeds 1.
        double_dqn: whether the trained network picks the next action and the target network values it.
        network: that is trained.

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

    Args:
        gamma: discount factor.
        loss_function: `l2`, the mean squared error, or `smooth_l1`, Huber's, which grows linearly where the TD error
            exceeds 1.
        double_dqn: whether the trained network picks the next action and the target network values it.
        network: that is trained.

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

    Args:
        gamma: discount factor.
        loss_function: `l2`, the mean squared error, or `smooth_l1`, Huber's, which grows linearly where the TD error
            exceeds 1.
        double_dqn: whether the trained network picks the next action and the target network values it.
        alpha: weight of the conservative term beside the squared TD error; 0 for plain (Double) DQN.
        network: that is trained.

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

    Args:
        gamma: discount factor.
        loss_function: `l2`, the mean squared error, or `smooth_l1`, Huber's, which grows linearly where the TD error
            exceeds 1.
        double_dqn: whether the trained network picks the next action and the target network values it.
        alpha: share of its gap to the best action that an action's reward falls by; 0 for plain (Double) DQN.
        network: that is trained.

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
