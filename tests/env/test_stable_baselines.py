"""Stable-Baselines3 trains on the Gymnasium environment as it stands."""

import gymnasium
import pytest

import carrl  # noqa: F401 (registers the environment)


def test_its_dqn_trains_and_then_chooses_actions_that_exist():
    reason = "Stable-Baselines3 is in the optional group bench"
    stable_baselines3 = pytest.importorskip("stable_baselines3", reason=reason)
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
