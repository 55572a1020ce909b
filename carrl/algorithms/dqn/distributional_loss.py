"""The loss of distributional Q-learning (C51).

Shapes: `N` transitions, `K` atoms, the returns whose probabilities are predicted.
"""

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.objectives import DQNLoss

from carrl.algorithms.common.network import QNetwork
from carrl.algorithms.dqn.loss import set_discount
from carrl.algorithms.dqn.return_distribution import predicts_distribution
from carrl.errors import ConfigError


def make_distributional_loss(gamma: float, double_dqn: bool, *, network: QNetwork) -> "DistributionalLoss":
    """The cross entropy between the predicted returns and those that a target network expects after the transition.

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
