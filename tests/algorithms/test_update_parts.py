"""What an update is made with beside the loss: soft target updates, clipping, a learning rate that falls."""

import math

import pytest
import torch
from torch import nn

from carrl.algorithms.common.optimizer import CosineDecay, GradientClipping, LinearDecay, make_soft_update
from carrl.algorithms.dqn.loss import make_dqn_loss
from carrl.errors import ConfigError
from tests.algorithms.test_learning_rules import linear_network


def test_a_soft_update_moves_the_target_a_share_of_the_way_after_each_update():
    network = linear_network([1.0, 2.0, 3.0])
    loss = make_dqn_loss(0.9, "l2", False, network=network)
    updater = make_soft_update(0.25, loss=loss)
    target = loss.target_value_network_params["module", "0", "module", "weight"]
    network.layers.weight.data += 8.0
    updater.step(100)
    assert target.flatten().tolist() == [1.0, 2.0, 3.0]
    updater.follow()
    assert target.flatten().tolist() == [3.0, 4.0, 5.0]
    updater.follow()
    assert target.flatten().tolist() == [4.5, 5.5, 6.5]


@pytest.mark.parametrize("tau", [0.0, -0.1, 0.6, math.nan])
def test_a_share_that_is_none_is_refused(tau):
    with pytest.raises(ConfigError, match=rf"target_updater\.tau is {tau}; it must be more than 0 and at most 0\.5"):
        make_soft_update(tau, loss=make_dqn_loss(0.9, "l2", False, network=linear_network([1.0, 2.0, 3.0])))


@pytest.mark.parametrize(("max_norm", "expected"), [(2.5, [1.5, 2.0]), (5.1, [3.0, 4.0])])
def test_a_gradient_longer_than_the_limit_is_scaled_to_it(max_norm, expected):
    clipped = GradientClipping(max_norm).clipped([torch.tensor([3.0]), torch.tensor([[4.0]])])
    assert torch.cat([each.flatten() for each in clipped]).tolist() == pytest.approx(expected, rel=1e-6)


def test_torchs_own_clipping_gives_the_same():
    parameters = [nn.Parameter(torch.randn(5, 3)), nn.Parameter(torch.randn(7))]
    for parameter in parameters:
        parameter.grad = torch.randn(parameter.shape)
    clipped = GradientClipping(1.0).clipped([parameter.grad.clone() for parameter in parameters])
    nn.utils.clip_grad_norm_(parameters, 1.0)
    for own, parameter in zip(clipped, parameters, strict=True):
        torch.testing.assert_close(own, parameter.grad)


@pytest.mark.parametrize("max_norm", [0.0, -1.0, math.nan, math.inf])
def test_a_limit_that_is_none_is_refused(max_norm):
    with pytest.raises(ConfigError, match=r"gradient_clipping\.max_norm is .*; it must be a positive number"):
        GradientClipping(max_norm)


def test_the_learning_rate_falls_linearly_and_then_stays():
    decay = LinearDecay(final_share=0.2, updates=100)
    assert [decay.share(update) for update in (0, 50, 100, 1000)] == pytest.approx([1.0, 0.6, 0.2, 0.2])


def test_the_learning_rate_falls_along_a_cosine_and_then_stays():
    decay = CosineDecay(final_share=0.0, updates=300)
    assert [decay.share(update) for update in (0, 100, 150, 300, 1000)] == pytest.approx([1, 0.75, 0.5, 0, 0])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"final_share": 1.5}, "learning_rate.final_share is 1.5; it must lie in 0..1"),
        ({"final_share": math.nan}, "learning_rate.final_share is nan"),
        ({"updates": 0}, "learning_rate.updates is 0; it must be at least 1"),
    ],
)
def test_a_schedule_that_is_none_is_refused(wrong, message):
    with pytest.raises(ConfigError, match=message):
        LinearDecay(**{"final_share": 0.1, "updates": 10, **wrong})
