"""Advantage learning: numbers worked by hand, the gap that it opens, and Double DQN as the oracle."""

import math

import pytest
import torch
from tensordict import TensorDict

from carrl.algorithms.common.network import make_q_network
from carrl.algorithms.common.optimizer import make_hard_update
from carrl.algorithms.dqn.loss import make_advantage_learning_loss, make_dqn_loss
from carrl.errors import ConfigError
from tests.algorithms.losses import TARGET, TRAINED, linear_network, random_transitions, transitions, with_target


@pytest.mark.parametrize("action", [0, 1, 2])
@pytest.mark.parametrize(("double_dqn", "next_value"), [(False, 7.0), (True, 5.0)])
def test_the_reward_falls_by_a_share_of_the_gap_that_the_target_network_sees(action, double_dqn, next_value):
    loss = with_target(make_advantage_learning_loss(0.5, "l2", double_dqn, 0.25, network=linear_network()))
    td_error = 2.0 - 0.25 * (max(TARGET) - TARGET[action]) + 0.5 * next_value - TRAINED[action]
    batch = transitions(action=action)
    assert loss(batch)["loss"].item() == pytest.approx(td_error**2, rel=1e-6)
    assert batch["td_error"].item() == pytest.approx(td_error**2, rel=1e-6)


@pytest.mark.parametrize("double_dqn", [False, True])
def test_with_alpha_0_it_is_the_dqn_loss(double_dqn):
    ours = with_target(make_advantage_learning_loss(0.5, "smooth_l1", double_dqn, 0.0, network=linear_network()))
    plain = with_target(make_dqn_loss(0.5, "smooth_l1", double_dqn, network=linear_network()))
    assert ours(transitions())["loss"].item() == plain(transitions())["loss"].item()


def test_the_transitions_stay_as_they_are_but_for_their_errors():
    batch = transitions(count=4, action=0)
    with_target(make_advantage_learning_loss(0.5, "l2", True, 0.5, network=linear_network()))(batch)
    assert (batch["next", "reward"] == 2.0).all()
    assert batch["td_error"].numel() == 4


def test_only_the_networks_own_parameters_are_trained_and_the_gap_is_no_part_of_the_gradient():
    network = linear_network()
    loss = with_target(make_advantage_learning_loss(0.5, "l2", True, 0.25, network=network))
    loss(transitions(action=0))["loss"].backward()
    (weight,) = network.parameters()
    td_error = 2.0 - 0.25 * 4.0 + 0.5 * 5.0 - 1.0
    torch.testing.assert_close(weight.grad[:, 0], torch.tensor([-2 * td_error, 0.0, 0.0]))
    assert [p.data_ptr() for p in loss.parameters()] == [weight.data_ptr()]


@pytest.mark.parametrize("alpha", [0.0, 0.5, 0.9])
def test_repeated_it_sets_actions_further_apart_and_leaves_the_best_ones_value(alpha):
    """One situation that ends at once: three actions worth 1, 4 and 2 in truth."""
    network = linear_network((0.0, 0.0, 0.0))
    loss = with_target(make_advantage_learning_loss(0.9, "l2", True, alpha, network=network), (0.0, 0.0, 0.0))
    batch = TensorDict.cat([transitions(action=action, reward=worth) for action, worth in enumerate(TRAINED)])
    batch["next", "terminated"][:] = True
    optimizer = torch.optim.SGD(network.parameters(), lr=0.5)
    for _ in range(600):
        optimizer.zero_grad()
        loss(batch)["loss"].backward()
        optimizer.step()
        loss.target_value_network_params.data.copy_(loss.value_network_params.data)
    (weight,) = network.parameters()
    expected = 4.0 - (4.0 - torch.tensor(TRAINED)) / (1 - alpha)
    torch.testing.assert_close(weight.detach()[:, 0], expected, atol=1e-2, rtol=0)


def test_it_is_a_mean_over_the_transitions():
    generator = torch.Generator().manual_seed(0)
    network = make_q_network([16, 8], observation_size=7, action_count=3, generator=generator)
    loss = make_advantage_learning_loss(0.9, "l2", True, 0.5, network=network)
    make_hard_update(1000, loss=loss)
    batch = random_transitions()
    assert loss(batch)["loss"].item() == pytest.approx(batch["td_error"].mean().item(), rel=1e-5)


@pytest.mark.parametrize("alpha", [-0.1, 1.0, math.nan, math.inf])
def test_an_alpha_that_is_no_share_is_refused(alpha):
    with pytest.raises(ConfigError, match=r"loss\.alpha is .*; it must be at least 0 and less than 1"):
        make_advantage_learning_loss(0.95, "l2", True, alpha, network=linear_network())


def test_a_discount_outside_0_to_1_is_refused():
    with pytest.raises(ConfigError, match=r"loss\.gamma"):
        make_advantage_learning_loss(1.5, "l2", True, 0.5, network=linear_network())
