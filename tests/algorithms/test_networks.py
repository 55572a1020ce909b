"""Dueling and noisy networks."""

import math
from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from carrl.algorithms.common.network import (
    make_distributional_network,
    make_dueling_network,
    make_noisy_network,
    make_q_network,
)
from carrl.algorithms.common.optimizer import make_hard_update
from carrl.algorithms.common.weight_noise import WeightNoise, is_noisy
from carrl.algorithms.dqn.loss import make_dqn_loss, make_dueling_loss
from carrl.algorithms.dqn.policy import GreedyPolicy
from carrl.errors import ConfigError
from tests.algorithms.losses import random_transitions

SIZES = {"observation_size": 7, "action_count": 3}


def dueling(seed=0, hidden_sizes=(16, 16, 8)):
    return make_dueling_network(list(hidden_sizes), **SIZES, generator=torch.Generator().manual_seed(seed))


def noisy(seed=0, initial_noise=0.5):
    return make_noisy_network([16, 8], initial_noise, **SIZES, generator=torch.Generator().manual_seed(seed))


def with_noise(network, seed=1):
    loss = make_dqn_loss(0.9, "l2", True, network=network)
    make_hard_update(1000, loss=loss)
    return loss, WeightNoise(network, loss, torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("make", [dueling, noisy])
def test_the_same_seed_draws_the_same_network_whatever_torchs_own_seed(make):
    first = make(seed=4)
    torch.manual_seed(99)
    second = make(seed=4)
    assert all(
        torch.equal(*pair) for pair in zip(first.state_dict().values(), second.state_dict().values(), strict=True)
    )


@pytest.mark.parametrize(
    "make",
    [
        make_q_network,
        make_dueling_network,
        partial(make_noisy_network, initial_noise=0.5),
        partial(make_distributional_network, atoms=5, least_return=-9.0, greatest_return=9.0),
    ],
)
def test_every_network_reads_powers_of_the_observations_if_it_is_to(make):
    def values(exponent, observation):
        generator = torch.Generator().manual_seed(3)
        network = make([16, 8], input_exponent=exponent, **SIZES, generator=generator)
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            return network(TensorDict({"observation": observation}, [5]))["action_value"]

    observation = 2 * torch.rand(5, 7) - 1
    roots = observation.sign() * observation.abs().sqrt()
    torch.testing.assert_close(values(0.5, observation), values(1.0, roots))
    assert not torch.allclose(values(0.5, observation), values(1.0, observation))


def test_the_dueling_loss_takes_a_dueling_network_that_reads_powers_and_no_other():
    generator = torch.Generator().manual_seed(0)
    make_dueling_loss(0.9, "l2", True, network=make_dueling_network([8, 8], 0.5, **SIZES, generator=generator))
    with pytest.raises(ConfigError, match="loss is dueling, and the network is not"):
        make_dueling_loss(0.9, "l2", True, network=make_q_network([8, 8], 0.5, **SIZES, generator=generator))


def test_dueling_values_are_the_state_value_and_advantages_about_their_mean():
    layers = dueling().layers
    observation = torch.rand(5, 7)
    shared = layers.features(observation)
    advantage = layers.advantage(shared)
    expected = layers.value(shared) + advantage - advantage.mean(-1, keepdim=True)
    torch.testing.assert_close(layers(observation), expected)
    widths = [layer.out_features for layer in layers.modules() if isinstance(layer, torch.nn.Linear)]
    assert widths == [16, 16, 8, 3, 8, 1]


def test_a_dueling_network_needs_two_layers():
    with pytest.raises(ConfigError, match=r"network.hidden_sizes is \[16\]; a dueling network has at least 2"):
        dueling(hidden_sizes=[16])


def test_the_dueling_loss_is_for_dueling_networks():
    plain = make_q_network([4], **SIZES, generator=torch.Generator())
    with pytest.raises(ConfigError, match="loss is dueling, and the network is not; set network=dueling"):
        make_dueling_loss(0.9, "l2", True, network=plain)
    assert make_dueling_loss(0.9, "l2", True, network=dueling()).double_dqn


@pytest.mark.parametrize("make", [dueling, noisy])
def test_every_agent_acts_as_its_own_network_would(make):
    networks = [make(seed) for seed in (1, 2, 3)]
    for seed, network in enumerate(networks):
        with_noise(network, seed)
    observation = torch.rand(12, 7)
    with set_exploration_type(ExplorationType.RANDOM):
        expected = [each.layers(observation[4 * i : 4 * i + 4]) for i, each in enumerate(networks)]
        actual = GreedyPolicy(networks).action_values(observation)
    torch.testing.assert_close(actual, torch.cat(expected))


def test_greedy_drives_have_no_noise():
    network = noisy()
    policy, observation = GreedyPolicy([network]), torch.rand(5, 7)
    before = policy.action_values(observation)
    with_noise(network)
    assert torch.equal(policy.action_values(observation), before)
    with set_exploration_type(ExplorationType.RANDOM):
        assert (policy.action_values(observation) != before).any()


def test_the_loss_has_noise_of_its_own_for_each_network_and_new_noise_each_time():
    loss, noise = with_noise(noisy())
    first = loss(random_transitions())["loss"].item()
    assert loss(random_transitions())["loss"].item() == first
    noise.draw()
    assert loss(random_transitions())["loss"].item() != first
    key = ("module", "0", "module", "0", "weight_epsilon")
    assert (loss.value_network_params[key] != loss.target_value_network_params[key]).any()


def test_noise_is_factorised_and_of_variance_one():
    """E[f(x)^2] = E|x| = sqrt(2 / pi) for each of two factors, so a weight's noise has the variance 2 / pi."""
    loss, noise = with_noise(noisy())
    weight = loss.value_network_params["module", "0", "module", "0", "weight_epsilon"]
    squares = []
    for _ in range(500):
        noise.draw()
        squares.append(weight.square().mean().item())
        assert torch.linalg.matrix_rank(weight) == 1
    assert sum(squares) / 500 == pytest.approx(2 / math.pi, rel=0.1)


def test_the_noise_that_the_cars_drive_with_is_that_of_the_last_update():
    network = noisy()
    loss, noise = with_noise(network)
    GreedyPolicy([network])  # which moves the network's tensors into a stack
    noise.draw()
    own, of_loss = network.layers[0].weight_epsilon, loss.value_network_params
    assert torch.equal(own, of_loss["module", "0", "module", "0", "weight_epsilon"])


def test_noise_follows_its_own_generator_and_goes_on_from_its_state():
    network = noisy()
    loss, noise = with_noise(network)
    state = {"loss": {key: value.clone() for key, value in loss.state_dict().items()}, "noise": noise.state_dict()}
    own = network.layers[0].weight_epsilon.clone()
    noise.draw()
    after = loss.state_dict()["value_network_params.module.0.module.0.weight_epsilon"].clone()
    other = noisy(seed=5)
    other_loss, other_noise = with_noise(other, seed=9)
    other_loss.load_state_dict(state["loss"])
    other_noise.load_state_dict(state["noise"])
    assert torch.equal(other.layers[0].weight_epsilon, own)
    other_noise.draw()
    assert torch.equal(other_loss.state_dict()["value_network_params.module.0.module.0.weight_epsilon"], after)


def test_a_noisy_network_is_told_apart_and_its_noise_must_be_a_number():
    assert is_noisy(noisy())
    assert not is_noisy(dueling())
    with pytest.raises(ConfigError, match=r"network\.initial_noise is nan; it must be a number of at least 0"):
        noisy(initial_noise=math.nan)


def test_a_noisy_network_writes_what_others_write():
    after = noisy()(TensorDict({"observation": torch.rand(5, 7)}, [5]))
    assert torch.equal(after["action"], after["action_value"].argmax(-1))
