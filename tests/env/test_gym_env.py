"""The driving task as Gymnasium sees it."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

import carrl
from carrl.env.reward import TERMS
from carrl.errors import ConfigError


@pytest.mark.parametrize("random_start", [False, True])
def test_gymnasiums_checker_passes(random_start):
    env = gymnasium.make("carrl/Track-v0", track="oval", random_start=random_start)
    check_env(env.unwrapped, skip_render_check=True)


def test_it_is_the_same_task_as_the_torchrl_environment():
    gym_env, env = gymnasium.make("carrl/Track-v0", track="paper"), carrl.TrackEnv(track="paper")
    observation, info = gym_env.reset(seed=0)
    state = env.reset()
    actions = np.random.default_rng(0).choice(3, size=200, p=[0.6, 0.3, 0.1])
    for action in actions:
        np.testing.assert_array_equal(observation, state["observation"][0].numpy())
        np.testing.assert_array_equal(info["pose"], state["pose"][0].numpy())
        observation, reward, terminated, truncated, info = gym_env.step(action)
        transition, state = env.step_and_maybe_reset(state.set("action", torch.tensor([action])))
        after = transition["next"]
        assert (reward, terminated, truncated) == (after["reward"].item(), after["terminated"].item(), False)
        assert [info[name] for name in TERMS] == after["reward_terms"][0].tolist()
        if terminated:
            observation, info = gym_env.reset()


def test_an_episode_is_truncated_at_a_thousand_steps_or_as_asked():
    assert gymnasium.make("carrl/Track-v0").spec.max_episode_steps == 1000
    env = gymnasium.make("carrl/Track-v0", max_episode_steps=3)
    env.reset(seed=0)
    assert [env.step(0)[3] for _ in range(3)] == [False, False, True]


def test_random_starts_follow_the_seed():
    env = gymnasium.make("carrl/Track-v0", random_start=True)
    first, again, other = (env.reset(seed=seed)[1]["pose"] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_stepping_before_a_reset_is_refused():
    with pytest.raises(gymnasium.error.ResetNeeded):
        gymnasium.make("carrl/Track-v0").unwrapped.step(0)


def test_a_render_mode_is_refused():
    with pytest.raises(ConfigError, match="does not draw"):
        carrl.GymTrackEnv(render_mode="human")
