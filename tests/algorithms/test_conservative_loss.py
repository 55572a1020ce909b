"""Conservative Q-learning: numbers worked by hand, and TorchRL's own terms as the oracle."""

import math

import pytest
import torch
from torchrl.objectives import DiscreteCQLLoss

from carrl.algorithms.common.network import make_q_network
from carrl.algorithms.common.optimizer import make_hard_update
from carrl.algorithms.dqn.loss import make_cql_loss, make_dqn_loss
from carrl.errors import ConfigError
from tests.algorithms.losses import TRAINED, linear_network, random_transitions, transitions, with_target

EXCESS = math.log(math.e + math.e**4 + math.e**2) - 1.0  # of all actions over the first, whose value is 1


@pytest.mark.parametrize(("double_dqn", "next_value"), [(False, 7.0), (True, 5.0)])
def test_the_loss_is_the_td_error_and_alpha_times_the_excess(double_dqn, next_value):
    loss = with_target(make_cql_loss(0.5, "l2", double_dqn, 0.25, network=linear_network()))
    td_error = 2.0 + 0.5 * next_value - 1.0
    assert loss(transitions())["loss"].item() == pytest.approx(td_error**2 + 0.25 * EXCESS, rel=1e-6)


def test_the_excess_is_the_mean_over_the_transitions():
    loss = with_target(make_cql_loss(0.0, "l2", False, 1.0, network=linear_network()))
    batch = torch.cat([transitions(action=0, reward=1.0), transitions(action=1, reward=4.0)])  # no TD error
    assert loss(batch)["loss"].item() == pytest.approx((EXCESS + EXCESS - 3.0) / 2, rel=1e-6)


def test_the_excess_pushes_the_actions_in_proportion_to_their_softmax_and_pulls_the_one_taken():
    network = linear_network()
    loss = with_target(make_cql_loss(0.0, "l2", False, 2.0, network=network))
    loss(transitions(reward=1.0))["loss"].backward()  # no TD error
    (weight,) = network.parameters()
    expected = 2.0 * (torch.tensor(TRAINED).softmax(0) - torch.tensor([1.0, 0.0, 0.0]))
    torch.testing.assert_close(weight.grad[:, 0], expected)


@pytest.mark.parametrize("double_dqn", [False, True])
def test_with_alpha_0_it_is_the_dqn_loss(double_dqn):
    conservative = with_target(make_cql_loss(0.5, "l2", double_dqn, 0.0, network=linear_network()))
    plain = with_target(make_dqn_loss(0.5, "l2", double_dqn, network=linear_network()))
    assert conservative(transitions())["loss"].item() == plain(transitions())["loss"].item()


def test_torchrls_own_terms_give_the_same_where_the_target_network_is_the_trained_one():
    network = make_q_network([16, 8], observation_size=7, action_count=3, generator=torch.Generator().manual_seed(0))
    ours = make_cql_loss(0.9, "l2", False, 3.0, network=network)
    make_hard_update(1000, loss=ours)
    theirs = DiscreteCQLLoss(network, loss_function="l2", delay_value=True, action_space="categorical")
    theirs.make_value_estimator(gamma=0.9)
    make_hard_update(1000, loss=theirs)
    terms = theirs(random_transitions())
    expected = 2 * terms["loss_qvalue"] + 3.0 * terms["loss_cql"]  # theirs halves the squared error
    torch.testing.assert_close(ours(random_transitions())["loss"], expected)


def test_torchrls_own_cql_loss_does_not_read_its_target_network():
    loss = DiscreteCQLLoss(linear_network(), loss_function="l2", delay_value=True, action_space="categorical")
    loss.make_value_estimator(gamma=0.5)
    value = with_target(loss)(transitions())["target_value"].item()
    assert value == 2.0 + 0.5 * max(
        TRAINED
    )  # if it is 2 + 0.5 * max(TARGET), carrl.algorithms.dqn.loss may build on it


def test_the_loss_trains_the_networks_own_parameters_and_no_others():
    network = linear_network()
    loss = make_cql_loss(0.95, "l2", True, 1.0, network=network)
    assert [p.data_ptr() for p in loss.parameters()] == [p.data_ptr() for p in network.parameters()]


@pytest.mark.parametrize("alpha", [-1.0, math.nan, math.inf])
def test_an_alpha_that_is_no_weight_is_refused(alpha):
    with pytest.raises(ConfigError, match=r"loss\.alpha is .*; it must be a number of at least 0"):
        make_cql_loss(0.95, "l2", True, alpha, network=linear_network())


def test_a_discount_outside_0_to_1_is_refused():
    with pytest.raises(ConfigError, match=r"loss\.gamma"):
        make_cql_loss(1.5, "l2", True, 1.0, network=linear_network())
