"""Acting for many replicates at once."""

import pytest
import torch
from tensordict import TensorDict
from torch import nn

from carrl.algorithms.common.compiled_update import stack_in_place
from carrl.algorithms.common.network import QNetwork, make_q_network
from carrl.algorithms.dqn.policy import GreedyPolicy
from carrl.errors import ConfigError


def table_i(seed):
    generator = torch.Generator().manual_seed(seed)
    return make_q_network([16, 16, 8], observation_size=7, action_count=3, generator=generator)


def normalised(seed):
    """A network that is not made of plain layers alone."""
    torch.manual_seed(seed)
    layers = nn.Sequential(nn.Linear(7, 8), nn.LayerNorm(8), nn.Linear(8, 3))
    return QNetwork(layers)


def rooted(seed):
    """A network that reads the square roots of its inputs."""
    generator = torch.Generator().manual_seed(seed)
    return make_q_network([8], 0.5, observation_size=7, action_count=3, generator=generator)


@pytest.mark.parametrize("make", [table_i, normalised, rooted])
def test_every_agent_acts_as_its_own_network_would(make):
    networks = [make(seed) for seed in (1, 2, 3)]
    observation = torch.rand(12, 7)
    expected = torch.cat(
        [
            network(TensorDict({"observation": observation[4 * i : 4 * i + 4]}, [4]))
            for i, network in enumerate(networks)
        ]
    )
    policy = GreedyPolicy(networks)
    written = policy(TensorDict({"observation": observation}, [12]))
    for key in ("action_value", "chosen_action_value", "action"):
        torch.testing.assert_close(written[key], expected[key])
    assert torch.equal(policy.actions(observation), expected["action"])


def test_together_and_alone_the_values_are_the_same_bit_for_bit():
    observation = torch.rand(96, 7)
    together = GreedyPolicy([table_i(seed) for seed in range(3)]).action_values(observation)
    alone = [GreedyPolicy([table_i(seed)]).action_values(observation[32 * seed : 32 * seed + 32]) for seed in range(3)]
    assert torch.equal(together, torch.cat(alone))


def test_the_policy_follows_the_networks_as_they_are_trained():
    network = table_i(0)
    policy = GreedyPolicy([network])
    observation = torch.rand(5, 7)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.fill_(0.5)
    torch.testing.assert_close(policy.action_values(observation), network.layers(observation))


def test_actions_are_those_of_the_highest_value_for_all_that_the_networks_read():
    network = make_q_network([4], observation_size=10, action_count=3, generator=torch.Generator().manual_seed(0))
    readings, last_action = torch.rand(6, 7), torch.tensor([0, 1, 2, 0, 1, 2])
    observation = torch.cat([readings, nn.functional.one_hot(last_action, 3).float()], dim=-1)
    expected = network.layers(observation).argmax(-1)
    assert torch.equal(GreedyPolicy([network]).actions(observation), expected)


def test_stacked_tensors_are_rows_of_one_and_stay_where_they_are():
    tensors = [nn.Parameter(torch.full((2, 3), float(number))) for number in range(3)]
    stacked = stack_in_place(tensors)
    assert stacked.shape == (3, 2, 3)
    stacked += 1
    assert [tensor[0, 0].item() for tensor in tensors] == [1, 2, 3]
    assert stack_in_place(tensors).data_ptr() == stacked.data_ptr()
    assert stack_in_place(tensors[1:]).data_ptr() == stacked[1].data_ptr()
    assert stack_in_place([tensors[0], tensors[2]]).data_ptr() != stacked.data_ptr()


def test_an_exponent_of_a_half_reads_square_roots():
    plain, root = (
        make_q_network([4], exponent, observation_size=7, action_count=3, generator=torch.Generator().manual_seed(1))
        for exponent in (1.0, 0.5)
    )
    observation = torch.rand(5, 7)
    read = [TensorDict({"observation": each}, [5]) for each in (observation.sqrt(), observation)]
    torch.testing.assert_close(plain(read[0])["action_value"], root(read[1])["action_value"])


def test_an_exponent_that_is_not_positive_is_refused():
    with pytest.raises(ConfigError, match=r"network\.input_exponent is 0; it must be a positive number"):
        make_q_network([4], 0, observation_size=7, action_count=3, generator=torch.Generator())
