"""Every loss on environments so small that the values are known, learnt through the algorithm's own updates.

Source: after the probe environments of rejax (Liesen et al. 2024) and Jones 2021, "Debugging RL, Without the Agonizing
Pain". Each is a state or two with transitions for all actions, and all of them are learnt at once, by one network.
"""

from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.data import Categorical

from carrl.algorithms.common.network import QNetwork, make_distributional_network, make_dueling_network, make_q_network
from carrl.algorithms.common.optimizer import make_hard_update, make_soft_update
from carrl.algorithms.dqn.dqn import DQN, Replicate
from carrl.algorithms.dqn.loss import (
    make_advantage_learning_loss,
    make_cql_loss,
    make_distributional_loss,
    make_dqn_loss,
    make_dueling_loss,
)
from carrl.algorithms.dqn.policy import ConstantEpsilonGreedy
from carrl.data.replay_buffer import NStepReturns

GAMMA, ACTIONS = 0.5, 3
ONE_STEP, BEFORE_IT, BY_ACTION, NEGATIVE, TRUNCATED, TERMINATED = range(6)
STATES = 6
ALL_ALIKE = (1.0, 1.0, 1.0)
BY_ACTION_REWARDS = (-1.0, 0.0, 1.0)
CQL_ALPHA = GAP_ALPHA = 0.5


def one_hot(states):
    return nn.functional.one_hot(torch.as_tensor(states), STATES).float()


def transitions(state, rewards, after, *, terminated, truncated=False):
    """Each action once, in this state."""
    flag = partial(torch.full, (ACTIONS, 1))
    following = {
        "observation": one_hot([after] * ACTIONS),
        "reward": torch.tensor(rewards)[:, None],
        "terminated": flag(terminated),
        "done": flag(terminated or truncated),
    }
    return TensorDict(
        {"observation": one_hot([state] * ACTIONS), "action": torch.arange(ACTIONS), "next": following}, [ACTIONS]
    )


BATCH = torch.cat(
    [
        transitions(ONE_STEP, ALL_ALIKE, ONE_STEP, terminated=True),
        transitions(BEFORE_IT, (0.0, 0.0, 0.0), ONE_STEP, terminated=False),
        transitions(BY_ACTION, BY_ACTION_REWARDS, BY_ACTION, terminated=True),
        transitions(NEGATIVE, (-1.0, -1.0, -1.0), NEGATIVE, terminated=True),
        transitions(TRUNCATED, ALL_ALIKE, TRUNCATED, terminated=False, truncated=True),
        transitions(TERMINATED, ALL_ALIKE, TERMINATED, terminated=True),
    ]
)


def table(generator):
    """A value for each state and action, without any layers between."""
    network = QNetwork(nn.Sequential(nn.Linear(STATES, ACTIONS, bias=True)))
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.uniform_(-0.5, 0.5, generator=generator)
    return network


SIZES = {"observation_size": STATES, "action_count": ACTIONS}
layers = partial(make_q_network, [32, 32], **SIZES)
dueling = partial(make_dueling_network, [32, 32], **SIZES)
distributional = partial(make_distributional_network, [32, 32], 9, -4.0, 4.0, **SIZES)
OPTIONS = {
    "dqn": (table, partial(make_dqn_loss, GAMMA, "l2", False)),
    "double_dqn": (table, partial(make_dqn_loss, GAMMA, "l2", True)),
    "huber": (table, partial(make_dqn_loss, GAMMA, "smooth_l1", False)),
    "layers": (lambda generator: layers(generator=generator), partial(make_dqn_loss, GAMMA, "l2", True)),
    "dueling": (lambda generator: dueling(generator=generator), partial(make_dueling_loss, GAMMA, "l2", True)),
    "distributional": (
        lambda generator: distributional(generator=generator),
        partial(make_distributional_loss, GAMMA, True),
    ),
    "cql": (table, partial(make_cql_loss, GAMMA, "l2", True, CQL_ALPHA)),
    "advantage_learning": (table, partial(make_advantage_learning_loss, GAMMA, "l2", True, GAP_ALPHA)),
}

TARGET = partial(make_hard_update, 20)


def make_algorithm(option, target=TARGET):
    make_network, make_loss = OPTIONS[option]
    network = make_network(torch.Generator().manual_seed(1))
    loss = make_loss(network=network)
    optimizer = torch.optim.Adam(list(loss.parameters()), lr=0.05)
    exploration = ConstantEpsilonGreedy(
        0.0, action_spec=Categorical(ACTIONS, dtype=torch.int64), generators=[torch.Generator()]
    )
    return DQN([Replicate(0, network, loss, optimizer, target(loss=loss))], exploration, ("a", "b", "c"))


def learnt(algorithm, batch=BATCH, updates=300):
    """The values of all states and actions after so many updates, each with the whole batch."""
    for number in range(updates):
        algorithm.prepare(number, len(batch))
        algorithm.update(batch[:, None].clone())
        algorithm.count_steps(1)
    with torch.no_grad():
        return algorithm.greedy.action_values(one_hot(range(STATES)))


@pytest.fixture(scope="module", params=OPTIONS)
def option(request):
    """A loss's name, and the values that are learnt with it."""
    return request.param, learnt(make_algorithm(request.param))


def is_about(values, *expected):
    expected = torch.tensor(expected).expand_as(values)
    torch.testing.assert_close(values, expected, rtol=0, atol=0.05)


def test_one_step_is_worth_its_reward(option):
    is_about(option[1][ONE_STEP], 1.0)


def test_a_step_before_it_is_worth_its_discounted_value(option):
    is_about(option[1][BEFORE_IT], GAMMA)


def test_the_value_depends_on_the_observation(option):
    is_about(option[1][NEGATIVE], -1.0)


def test_an_episode_that_is_truncated_goes_on_in_the_value_and_one_that_is_terminated_does_not(option):
    is_about(option[1][TRUNCATED], 1 / (1 - GAMMA))
    is_about(option[1][TERMINATED], 1.0)


def test_the_value_depends_on_the_action(option):
    name, values = option
    found = values[BY_ACTION]
    assert found.argmax() == 2
    if name == "advantage_learning":  # gaps are 1 / (1 - alpha) times as large
        is_about(found, *(1 - (1 - reward) / (1 - GAP_ALPHA) for reward in BY_ACTION_REWARDS))
    elif name == "cql":  # where the gradient of both its terms is zero
        rewards = torch.tensor(BY_ACTION_REWARDS)
        is_about(2 * (found - rewards) + CQL_ALPHA * (ACTIONS * found.softmax(-1) - 1), 0.0)
        assert found[2] < 1.0 < 1.0 + found[2] - found[0]
    else:
        is_about(found, *BY_ACTION_REWARDS)


def test_a_target_network_that_follows_softly_leads_to_the_same_values():
    values = learnt(make_algorithm("double_dqn", partial(make_soft_update, 0.1)))
    is_about(values[TRUNCATED], 1 / (1 - GAMMA))
    is_about(values[BEFORE_IT], GAMMA)


def test_returns_over_several_steps_reach_the_reward_without_bootstrapping():
    """The target network stays what it was, so that the discounted reward can have come from the returns alone."""
    steps = torch.stack([BATCH[3:6], BATCH[:3]])[..., None]  # to the reward and onto it: [T, N, A]
    kept = NStepReturns(2, gamma=GAMMA)(steps).flatten(0, 1)[:, 0]
    assert kept["steps_to_next_obs"].unique().tolist() == [2]
    never = partial(make_hard_update, 10**6)
    is_about(learnt(make_algorithm("double_dqn", never), kept)[BEFORE_IT], GAMMA)


def test_weights_of_transitions_count_and_a_weight_of_zero_leaves_a_value_alone():
    algorithm = make_algorithm("dqn")
    algorithm.networks[0].layers[0].bias.requires_grad_(False)  # which all states share
    before = algorithm.greedy.action_values(one_hot(range(STATES))).clone()
    batch = BATCH.clone()
    batch["priority_weight"] = (batch["observation"].argmax(-1) != NEGATIVE).float()
    after = learnt(algorithm, batch)
    assert torch.equal(after[NEGATIVE], before[NEGATIVE])
    is_about(after[ONE_STEP], 1.0)
