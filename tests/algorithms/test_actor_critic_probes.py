"""DDPG, TD3 and SAC on environments so small that values and the best actions are known.

Source: as in `test_probe_environments`. Each state has transitions for actions from -1 to 1, all learnt at once.
"""

from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torch import nn

from carrl.algorithms.actor_critic.loss import values
from carrl.data.replay_buffer import NStepReturns
from tests.algorithms.actor_critics import GAMMA, RULES, make_algorithm

ONE_STEP, BEFORE_IT, LEFT, RIGHT, TRUNCATED, TERMINATED = range(6)
STATES = 6
ACTIONS = torch.linspace(-1, 1, 9)[:, None]
BEST = {LEFT: 0.5, RIGHT: -0.5}


def one_hot(states):
    return nn.functional.one_hot(torch.as_tensor(states), STATES).float()


def transitions(state, reward, after, *, terminated, truncated=False):
    """Each of the actions once, in this state."""
    flag = partial(torch.full, (len(ACTIONS), 1))
    following = {
        "observation": one_hot([after] * len(ACTIONS)),
        "reward": torch.as_tensor(reward).expand(len(ACTIONS), 1).clone(),
        "terminated": flag(terminated),
        "done": flag(terminated or truncated),
    }
    return TensorDict(
        {"observation": one_hot([state] * len(ACTIONS)), "action": ACTIONS, "next": following}, [len(ACTIONS)]
    )


def near(best):
    """1 for the best action, less the farther off."""
    return 1 - (ACTIONS - best).square()


BATCH = torch.cat(
    [
        transitions(ONE_STEP, 1.0, ONE_STEP, terminated=True),
        transitions(BEFORE_IT, 0.0, ONE_STEP, terminated=False),
        transitions(LEFT, near(BEST[LEFT]), LEFT, terminated=True),
        transitions(RIGHT, near(BEST[RIGHT]), RIGHT, terminated=True),
        transitions(TRUNCATED, 1.0, TRUNCATED, terminated=False, truncated=True),
        transitions(TERMINATED, 1.0, TERMINATED, terminated=True),
    ]
)


def learn(algorithm, batch=BATCH, updates=300):
    for number in range(updates):
        algorithm.prepare(number, len(batch))
        algorithm.update(batch[:, None].clone())
        algorithm.count_steps(1)
    return algorithm


def valued(algorithm, state, actions=ACTIONS):
    """What the critics expect of actions in a state, [actions]."""
    (replicate,) = algorithm.replicates
    return values(replicate.loss, replicate.rule.critic_name, one_hot([state] * len(actions)), actions)


@pytest.fixture(scope="module", params=RULES)
def learnt(request):
    """Each of the algorithms after its updates."""
    return learn(make_algorithm(RULES[request.param], STATES))


def is_about(found, expected):
    torch.testing.assert_close(found, torch.as_tensor(expected).expand_as(found), rtol=0, atol=0.1)


def test_one_step_is_worth_its_reward(learnt):
    is_about(valued(learnt, ONE_STEP), 1.0)


def test_a_step_before_it_is_worth_its_discounted_value(learnt):
    is_about(valued(learnt, BEFORE_IT), GAMMA)


def test_an_episode_that_is_truncated_goes_on_in_the_value_and_one_that_is_terminated_does_not(learnt):
    is_about(valued(learnt, TRUNCATED), 1 / (1 - GAMMA))
    is_about(valued(learnt, TERMINATED), 1.0)


@pytest.mark.parametrize("state", BEST)
def test_the_value_depends_on_the_action_and_the_actor_finds_the_best(learnt, state):
    is_about(valued(learnt, state), near(BEST[state])[:, 0])
    assert learnt.greedy_policy(one_hot([state])).item() == pytest.approx(BEST[state], abs=0.15)


@pytest.mark.parametrize("name", RULES)
def test_returns_over_several_steps_reach_the_reward_without_bootstrapping(name):
    """Targets stay what they were, so that the discounted reward can have come from the returns alone."""
    onto, to = BATCH[: len(ACTIONS)], BATCH[len(ACTIONS) : 2 * len(ACTIONS)]
    kept = NStepReturns(2, gamma=GAMMA)(torch.stack([to, onto])[..., None]).flatten(0, 1)[:, 0]
    algorithm = make_algorithm(RULES[name], STATES, tau=1e-9)
    is_about(valued(learn(algorithm, kept, 100), BEFORE_IT), GAMMA)


def test_weights_of_transitions_count_and_a_weight_of_zero_teaches_nothing():
    batch = BATCH.clone()
    state = batch["observation"].argmax(-1)
    batch["next", "reward"][state == TERMINATED] = 100.0
    batch["priority_weight"] = (state != TERMINATED).float()
    algorithm = learn(make_algorithm(RULES["td3"], STATES), batch, 100)
    is_about(valued(algorithm, ONE_STEP), 1.0)
    assert valued(algorithm, TERMINATED).max() < 3
