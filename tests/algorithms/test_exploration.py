"""Epsilon-greedy on the paper's schedule, and on two others."""

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Categorical
from torchrl.envs.utils import ExplorationType, set_exploration_type

from carrl.algorithms.dqn.policy import ConstantEpsilonGreedy, ExponentialEpsilonGreedy, LinearEpsilonGreedy
from carrl.data.collector import make_collector
from carrl.env.track_env import TrackEnv
from carrl.errors import ConfigError


def make_exploration(epsilon_max=0.99, epsilon_min=0.01, decay_rate=1e-4, seed=0):
    return ExponentialEpsilonGreedy(
        epsilon_max,
        epsilon_min,
        decay_rate,
        action_spec=Categorical(3),
        generators=[torch.Generator().manual_seed(seed)],
    )


def equation_4(t):
    return 0.01 + (0.99 - 0.01) * math.exp(-1e-4 * t)


@pytest.mark.parametrize("num_envs", [1, 2, 8, 64])
def test_epsilon_after_t_env_steps_is_equation_4_for_any_number_of_parallel_envs(num_envs):
    exploration = make_exploration()
    for t in range(0, 5_000, num_envs):
        assert exploration.epsilon == pytest.approx(equation_4(t), abs=1e-6)
        exploration.step(num_envs)


@pytest.mark.parametrize("num_envs", [1, 4])
def test_epsilon_in_a_collected_batch_is_equation_4_at_its_env_step(num_envs):
    env = TrackEnv(num_envs=num_envs, seed=0)
    exploration = make_exploration(decay_rate=1e-2)

    def policy(state):
        return exploration(state.set("action", torch.zeros(num_envs, dtype=torch.int64)))

    t = 0
    for batch in make_collector(1, env=env, policy=policy):
        expected = 0.01 + 0.98 * math.exp(-1e-2 * t)
        torch.testing.assert_close(batch["epsilon"], torch.full((num_envs, 1), expected))
        t += batch.numel()
        exploration.step(batch.numel())
        if t >= 40:
            break
    assert t == 40


def test_the_ends_of_the_schedule_are_table_i():
    exploration = make_exploration()
    assert exploration.epsilon == pytest.approx(0.99)
    exploration.step(10_000_000)
    assert exploration.epsilon == pytest.approx(0.01)


def explored(exploration, cars=30_000):
    return exploration(TensorDict({"action": torch.zeros(cars, dtype=torch.int64)}, [cars]))


def test_actions_are_replaced_with_probability_epsilon_evenly_over_all_actions():
    after = explored(make_exploration(epsilon_max=0.6, epsilon_min=0.6))
    assert after["exploratory"].float().mean().item() == pytest.approx(0.6, abs=0.01)
    counts = after["action"][after["exploratory"]].bincount(minlength=3) / after["exploratory"].sum()
    torch.testing.assert_close(counts, torch.full((3,), 1 / 3), atol=0.01, rtol=0)
    assert (after["action"][~after["exploratory"]] == 0).all()
    assert (after["epsilon"] == 0.6).all()


def test_no_exploration_when_the_mode_is_deterministic():
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        after = explored(make_exploration())
    assert (after["action"] == 0).all()
    assert not after["exploratory"].any()


def test_draws_come_from_its_own_generators():
    first = explored(make_exploration(seed=5))
    torch.rand(10)
    assert (first == explored(make_exploration(seed=5))).all()
    assert (first["action"] != explored(make_exploration(seed=6))["action"]).any()


def parts(seed=0):
    return {"action_spec": Categorical(3), "generators": [torch.Generator().manual_seed(seed)]}


def test_a_linear_schedule_falls_in_a_straight_line_and_then_stays():
    exploration = LinearEpsilonGreedy(0.9, 0.1, 100, **parts())
    found = []
    for frames in (0, 25, 25, 50, 900):
        exploration.step(frames)
        found.append(exploration.epsilon)
    assert found == pytest.approx([0.9, 0.7, 0.5, 0.1, 0.1])


def test_a_constant_epsilon_stays_what_it_is():
    exploration = ConstantEpsilonGreedy(0.25, **parts())
    assert exploration.epsilon == 0.25
    exploration.step(1000)
    assert exploration.epsilon == 0.25
    assert not explored(ConstantEpsilonGreedy(0.0, **parts()))["exploratory"].any()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: LinearEpsilonGreedy(0.9, 0.1, 0, **parts()), "exploration.env_steps_to_min is 0"),
        (lambda: LinearEpsilonGreedy(math.nan, 0.1, 5, **parts()), "epsilon_max is nan"),
        (lambda: ConstantEpsilonGreedy(1.5, **parts()), "exploration.epsilon is 1.5; it must lie in 0..1"),
        (lambda: ConstantEpsilonGreedy(math.nan, **parts()), "exploration.epsilon is nan"),
    ],
)
def test_other_impossible_schedules_are_refused(make, message):
    with pytest.raises(ConfigError, match=message):
        make()


@pytest.mark.parametrize(
    "wrong", [{"epsilon_max": 1.5}, {"epsilon_min": 0.995}, {"decay_rate": -1.0}, {"decay_rate": math.nan}]
)
def test_impossible_schedules_are_refused(wrong):
    with pytest.raises(ConfigError, match="exploration"):
        make_exploration(**wrong)
