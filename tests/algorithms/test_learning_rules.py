"""Network, loss and target update: numbers worked by hand."""

import pytest
import torch
from tensordict import TensorDict
from torch import nn

from carrl.algorithms.common.network import make_q_network
from carrl.algorithms.common.optimizer import make_hard_update
from carrl.algorithms.dqn.loss import make_dqn_loss
from carrl.errors import ConfigError
from tests.algorithms.losses import linear_network, with_target


def make_network(seed=0, hidden_sizes=(16, 16, 8)):
    return make_q_network(
        list(hidden_sizes), observation_size=7, action_count=3, generator=torch.Generator().manual_seed(seed)
    )


def transition(reward, terminated=False, truncated=False):
    return TensorDict(
        {
            "observation": torch.tensor([[1.0]]),
            "action": torch.tensor([0]),
            "next": {
                "observation": torch.tensor([[1.0]]),
                "reward": torch.tensor([[reward]]),
                "terminated": torch.tensor([[terminated]]),
                "done": torch.tensor([[terminated or truncated]]),
            },
        },
        batch_size=[1],
    )


def loss_of(batch, double_dqn):
    return with_target(make_dqn_loss(0.5, "l2", double_dqn, network=linear_network()))(batch)["loss"].item()


def test_dqn_takes_the_greatest_value_of_the_target_network():
    assert loss_of(transition(2.0), double_dqn=False) == pytest.approx((2.0 + 0.5 * 7.0 - 1.0) ** 2)


def test_double_dqn_values_the_trained_networks_choice_with_the_target_network():
    assert loss_of(transition(2.0), double_dqn=True) == pytest.approx((2.0 + 0.5 * 5.0 - 1.0) ** 2)


@pytest.mark.parametrize("double_dqn", [False, True])
def test_actions_of_equal_value_count_as_one_action(double_dqn):
    tied = (3.0, 3.0, 3.0)
    chosen = linear_network(tied)(TensorDict({"observation": torch.ones(4, 1)}, [4]))
    assert chosen["action"].shape == (4,) and chosen["action"].dtype is torch.int64
    assert chosen["chosen_action_value"].tolist() == [[3.0]] * 4
    loss = with_target(make_dqn_loss(0.5, "l2", double_dqn, network=linear_network(tied)), tied)
    assert loss(transition(2.0))["loss"].item() == pytest.approx((2.0 + 0.5 * 3.0 - 3.0) ** 2)


@pytest.mark.parametrize("double_dqn", [False, True])
def test_a_terminated_transition_does_not_bootstrap(double_dqn):
    assert loss_of(transition(2.0, terminated=True), double_dqn) == pytest.approx((2.0 - 1.0) ** 2)


def test_a_truncated_transition_bootstraps():
    assert loss_of(transition(2.0, truncated=True), double_dqn=False) == pytest.approx((2.0 + 0.5 * 7.0 - 1.0) ** 2)


def test_the_loss_trains_the_networks_own_parameters_and_not_the_targets():
    network = make_network()
    loss = make_dqn_loss(0.95, "l2", False, network=network)
    assert [p.data_ptr() for p in loss.parameters()] == [p.data_ptr() for p in network.parameters()]


@pytest.mark.parametrize("gamma", [-0.1, 1.1, float("nan")])
def test_a_discount_outside_0_to_1_is_refused(gamma):
    with pytest.raises(ConfigError, match=r"loss\.gamma"):
        make_dqn_loss(gamma, "l2", False, network=make_network())


@pytest.mark.parametrize("period", [1, 2, 3, 10])
def test_target_network_changes_exactly_at_steps_c_2c_3c(period):
    network = make_network()
    loss = make_dqn_loss(0.95, "l2", False, network=network)
    updater = make_hard_update(period, loss=loss)
    changed_at = []
    for step in range(1, 3 * period + 3):
        with torch.no_grad():
            for parameter in network.parameters():
                parameter += 1.0
        before = loss.target_value_network_params.clone()
        updater.step()
        if (loss.target_value_network_params != before).any():
            changed_at.append(step)
            assert (loss.target_value_network_params.data == loss.value_network_params.data).all()
    expected = [c for c in range(1, 3 * period + 3) if c % period == 0]
    assert changed_at == expected


def test_a_period_below_one_is_refused():
    with pytest.raises(ConfigError, match=r"target_updater\.period is 0"):
        make_hard_update(0, loss=make_dqn_loss(0.95, "l2", False, network=make_network()))


def test_the_network_is_table_i():
    layers = [layer for layer in make_network().modules() if isinstance(layer, nn.Linear)]
    assert [(layer.in_features, layer.out_features) for layer in layers] == [(7, 16), (16, 16), (16, 8), (8, 3)]
    relus = [layer for layer in make_network().modules() if isinstance(layer, nn.ReLU)]
    assert len(relus) == 3
    assert all((layer.bias == 0).all() for layer in layers)


def test_the_same_seed_draws_the_same_network_whatever_torchs_own_seed():
    first = make_network(seed=4)
    torch.manual_seed(99)
    second = make_network(seed=4)
    assert all(torch.equal(a, b) for a, b in zip(first.parameters(), second.parameters(), strict=True))


def test_the_network_picks_the_action_of_the_highest_value():
    network = make_network()
    after = network(TensorDict({"observation": torch.rand(50, 7)}, [50]))
    assert torch.equal(after["action"], after["action_value"].argmax(-1))


def test_a_layer_without_units_is_refused():
    with pytest.raises(ConfigError, match="hidden_sizes"):
        make_network(hidden_sizes=(16, 0))
