"""Stable-Baselines3 trains on the Gymnasium environment as it stands, and on many cars at once by `carrl.sb3`."""

import sys

import gymnasium
import numpy as np
import pytest
import torch

import carrl
from carrl.errors import ConfigError
from carrl.sim.kinematic import Kinematic
from carrl.task.end import End, SlideAlongWall
from carrl.task.episode import Start

stable_baselines3 = pytest.importorskip("stable_baselines3", reason="pip install 'carrl[sb3]'")


def test_its_dqn_trains_and_then_chooses_actions_that_exist():
    env = gymnasium.make("carrl/Track-v0")
    model = stable_baselines3.DQN(
        "MlpPolicy", env, seed=0, learning_starts=500, train_freq=4, policy_kwargs={"net_arch": [32]}, device="cpu"
    )
    before = [weights.clone() for weights in model.q_net.parameters()]
    model.learn(2_000)
    assert model.num_timesteps == 2_000
    assert any((old != new).any() for old, new in zip(before, model.q_net.parameters(), strict=True))
    observation, _ = env.reset(seed=1)
    for _ in range(50):
        action, _ = model.predict(observation, deterministic=False)
        assert action in env.action_space
        observation, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            observation, _ = env.reset()


def test_its_ppo_trains_on_many_cars_and_logs_their_episodes():
    envs = carrl.sb3.make_vec_env("oval", num_envs=8, observation=carrl.rays_and_last_action())
    model = stable_baselines3.PPO("MlpPolicy", envs, n_steps=64, batch_size=64, n_epochs=1, seed=0, device="cpu")
    before = [weights.clone() for weights in model.policy.parameters()]
    model.learn(1_024)
    assert any((old != new).any() for old, new in zip(before, model.policy.parameters(), strict=True))
    assert len(model.ep_info_buffer) > 5
    actions, _ = model.predict(envs.reset())
    assert actions.shape == (8,)
    assert envs.step(actions)[0].shape == (8, 10)


def test_many_cars_do_what_trackenvs_do():
    envs, env = carrl.sb3.make_vec_env("oval", num_envs=5, max_steps=25), carrl.TrackEnv("oval", 5, max_steps=25)
    views, state = envs.reset(), env.reset()
    rng = np.random.default_rng(0)
    kinds = set()
    for _ in range(60):
        np.testing.assert_array_equal(views, state["observation"].numpy())
        kept = views.copy()
        actions = rng.choice(3, size=5, p=[0.6, 0.3, 0.1])
        before, (views, rewards, dones, infos) = views, envs.step(actions)
        np.testing.assert_array_equal(before, kept)
        driven, state = env.step_and_maybe_reset(state.set("action", torch.tensor(actions)))
        after = driven["next"]
        np.testing.assert_array_equal(rewards, after["reward"][:, 0].numpy())
        np.testing.assert_array_equal(dones, after["done"][:, 0].numpy())
        for car in dones.nonzero()[0]:
            np.testing.assert_array_equal(infos[car]["terminal_observation"], after["observation"][car].numpy())
            assert infos[car]["TimeLimit.truncated"] == after["truncated"][car].item()
            kinds.add(infos[car]["TimeLimit.truncated"])
    assert kinds == {True, False}


def test_many_cars_start_as_the_seed_says():
    def first(seed, later_seed=None):
        envs = carrl.sb3.make_vec_env("oval", num_envs=3, seed=seed, start=Start(anywhere=True))
        if later_seed is not None:
            envs.seed(later_seed)
        return envs.reset()

    np.testing.assert_array_equal(first(1), first(1))
    np.testing.assert_array_equal(first(1, later_seed=5), first(2, later_seed=5))
    assert (first(1) != first(2)).any()


def test_many_cars_take_whole_numbers_for_actions_alone():
    envs = carrl.sb3.make_vec_env(num_envs=2)
    envs.reset()
    with pytest.raises(ConfigError, match=r"action is of torch\.float64"):
        envs.step(np.array([1.9, 0.0]))


def test_many_cars_can_be_asked_for_their_tracks():
    envs = carrl.sb3.make_vec_env(["oval", "paper"], num_envs=2)
    assert [track.name for track in envs.get_attr("tracks", 0)[0]] == ["oval", "paper"]


def test_without_stable_baselines3_the_remedy_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "stable_baselines3.common.vec_env", None)
    with pytest.raises(ConfigError, match=r"needs Stable-Baselines3, .*; pip install 'carrl\[sb3\]'"):
        carrl.sb3.make_vec_env()


def test_its_own_vectors_of_copies_need_no_pygame(monkeypatch):
    from stable_baselines3.common.env_util import make_vec_env

    monkeypatch.setitem(sys.modules, "pygame", None)
    monkeypatch.delitem(sys.modules, "carrl.render.live", raising=False)
    envs = make_vec_env("carrl/Track-v0", n_envs=2, seed=0)
    envs.reset()
    assert envs.step(np.array([0, 1]))[0].shape == (2, 7)


def test_its_sac_trains_on_many_cars_with_a_pedal():
    envs = carrl.sb3.make_vec_env(
        "oval",
        num_envs=4,
        vehicle=Kinematic(),
        action=carrl.ContinuousActions(),
        end=End({"contact": SlideAlongWall()}),
    )
    model = stable_baselines3.SAC(
        "MlpPolicy", envs, learning_starts=50, policy_kwargs={"net_arch": [16]}, batch_size=16, seed=0, device="cpu"
    )
    model.learn(120)
    actions, _ = model.predict(envs.reset())
    assert actions.shape == (4, 2)
    assert np.isfinite(envs.step(actions)[1]).all()
