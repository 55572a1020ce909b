"""Distributional Q-learning: numbers worked by hand, and TorchRL's own loss as the oracle."""

import math

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.modules import DistributionalQValueActor
from torchrl.objectives import DistributionalDQNLoss

from carrl.algorithms.common.network import QNetwork, ReturnDistribution, make_distributional_network, make_q_network
from carrl.algorithms.common.optimizer import make_hard_update
from carrl.algorithms.dqn.loss import _projected, make_cql_loss, make_distributional_loss, make_dqn_loss
from carrl.algorithms.dqn.policy import GreedyPolicy
from carrl.errors import ConfigError
from tests.algorithms.test_conservative_loss import random_transitions

SUPPORT = torch.tensor([-1.0, 0.0, 1.0])


def make_network(seed=0, atoms=11, least=-2.0, greatest=2.0):
    generator = torch.Generator().manual_seed(seed)
    sizes = {"observation_size": 7, "action_count": 3}
    return make_distributional_network([16, 8], atoms, least, greatest, **sizes, generator=generator)


def project(returns):
    """What the probabilities 0.5, 0.3, 0.2 of these returns become."""
    return _projected(torch.tensor([[0.5, 0.3, 0.2]]), torch.tensor([returns]), SUPPORT)[0].tolist()


def test_returns_on_atoms_keep_their_probabilities():
    assert project([-1.0, 0.0, 1.0]) == pytest.approx([0.5, 0.3, 0.2])


def test_returns_between_atoms_are_shared_out_by_how_near_they_are():
    assert project([-0.75, 0.0, 0.5]) == pytest.approx([0.375, 0.125 + 0.3 + 0.1, 0.1])


def test_returns_beyond_the_support_count_as_its_ends():
    assert project([-5.0, 3.0, 3.0]) == pytest.approx([0.5, 0.0, 0.5])


def test_values_are_the_expected_returns():
    logits = torch.tensor([[1.0, 1.0, 1.0, -99.0, -99.0, 0.0, 0.0, -99.0, 0.0]])
    network = QNetwork(ReturnDistribution(nn.Identity(), SUPPORT))
    after = network(TensorDict({"observation": logits}, [1]))
    assert after["action_value"][0].tolist() == pytest.approx([0.0, 1.0, 0.0])
    assert after["action"].tolist() == [1]


def test_the_policy_acts_by_them():
    networks = [make_network(seed) for seed in range(2)]
    observation = torch.rand(6, 7)
    expected = torch.cat([each.layers(observation[3 * i : 3 * i + 3]) for i, each in enumerate(networks)])
    torch.testing.assert_close(GreedyPolicy(networks).action_values(observation), expected)


class Logits(nn.Module):
    """The layers of a network of ours, as TorchRL's actor wants them: [N, K, 3]."""

    def __init__(self, distribution):
        super().__init__()
        self.distribution = distribution

    def forward(self, observation):
        return self.distribution.layers(observation).unflatten(-1, (3, -1)).mT


def with_other_target(loss):
    make_hard_update(1000, loss=loss)  # without an updater the loss warns
    generator = torch.Generator().manual_seed(5)
    for key, value in sorted(loss.target_value_network_params.items(True, True), key=lambda pair: pair[1].shape):
        if "support" not in key:
            value.data.copy_(torch.randn(value.shape, generator=generator))
    return loss


@pytest.mark.parametrize("steps", [None, 3])
def test_torchrls_own_loss_gives_the_same(steps):
    network = make_network()
    distribution = network.layers
    ours = with_other_target(make_distributional_loss(0.9, True, network=network))
    actor = DistributionalQValueActor(
        Logits(distribution), distribution.support, in_keys=["observation"], action_space="categorical"
    )
    theirs = with_other_target(DistributionalDQNLoss(actor, gamma=0.9))
    batch = random_transitions()
    if steps:
        batch["steps_to_next_obs"] = torch.full((64, 1), steps)
    expected = theirs(batch.clone())["loss"]
    torch.testing.assert_close(ours(batch)["loss"], expected)
    expected.backward()
    gradient = [parameter.grad.clone() for parameter in network.parameters()]
    network.zero_grad()
    ours(batch)["loss"].backward()
    for own, other in zip(network.parameters(), gradient, strict=True):
        torch.testing.assert_close(own.grad, other)


def test_it_learns_the_returns_of_a_probe_with_known_values():
    """One observation, one step: action 0 earns 1, the others earn -1 or 1 by chance."""
    network = make_network(atoms=3, least=-1.0, greatest=1.0)
    loss = make_distributional_loss(0.9, True, network=network)
    make_hard_update(1000, loss=loss)
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-2)
    action = torch.tensor([0, 0, 1, 1, 2, 2])
    reward = torch.tensor([1.0, 1.0, 1.0, -1.0, 1.0, -1.0])[:, None]
    ended = torch.ones(6, 1, dtype=torch.bool)
    following = {"observation": torch.ones(6, 7), "reward": reward, "terminated": ended, "done": ended}
    batch = TensorDict({"observation": torch.ones(6, 7), "action": action, "next": following}, [6])
    for _ in range(300):
        optimizer.zero_grad()
        loss(batch)["loss"].backward()
        optimizer.step()
    chances = network.layers.log_probabilities(torch.ones(1, 7))[0].exp()
    torch.testing.assert_close(
        chances.detach(), torch.tensor([[0.0, 0, 1], [0.5, 0, 0.5], [0.5, 0, 0.5]]), atol=0.03, rtol=0
    )
    assert batch["td_error"].flatten().tolist() == pytest.approx([0, 0, 1, 1, 1, 1], abs=0.1)


def test_weights_count_losses():
    loss = with_other_target(make_distributional_loss(0.9, False, network=make_network()))
    batch = random_transitions(2)
    alone = [loss(batch[i : i + 1])["loss"].item() for i in range(2)]
    batch["priority_weight"] = torch.tensor([1.0, 3.0])
    assert loss(batch)["loss"].item() == pytest.approx((alone[0] + 3 * alone[1]) / 4, rel=1e-5)


def test_losses_and_networks_that_do_not_fit_are_refused():
    plain = make_q_network([4], observation_size=7, action_count=3, generator=torch.Generator())
    with pytest.raises(ConfigError, match="loss is distributional, and the network is not; set network=distributional"):
        make_distributional_loss(0.9, True, network=plain)
    for make in (
        lambda network: make_dqn_loss(0.9, "l2", True, network=network),
        lambda network: make_cql_loss(0.9, "l2", True, 1.0, network=network),
    ):
        with pytest.raises(ConfigError, match="network is distributional, which loss=distributional alone can train"):
            make(make_network())


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"atoms": 1}, "network.atoms is 1; it must be at least 2"),
        ({"least": 3.0}, "network.least_return is 3.0 and greatest_return is 2.0"),
        ({"greatest": math.nan}, "network.least_return is -2.0 and greatest_return is nan"),
        ({"least": -math.inf}, "network.least_return is -inf"),
    ],
)
def test_a_support_that_is_none_is_refused(wrong, message):
    with pytest.raises(ConfigError, match=message):
        make_network(**wrong)
