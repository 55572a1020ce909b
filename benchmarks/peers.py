"""The contestants that are not CarRL: `python -m benchmarks.peers NAME --frames F` trains one, prints its figures."""

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from typing import Any

import torch

from benchmarks.figures import Measurement
from benchmarks.plain_dqn import train_plain
from benchmarks.settings import (
    ACTOR_CRITIC_BATCH_SIZE,
    ACTOR_CRITIC_GAMMA,
    ACTOR_CRITIC_RATES,
    BATCH_SIZE,
    CAPACITY,
    CARS,
    GAMMA,
    HIDDEN_SIZES,
    LEARNING_RATE,
    TARGET_PERIOD,
    TAU,
    epsilon_after,
)


def train_sb3_one_car(frames: int, seed: int) -> Measurement:
    """Stable-Baselines3 on `carrl/Track-v0`: one car through Gymnasium."""
    import gymnasium

    import carrl  # noqa: F401 (registers carrl/Track-v0)

    return _train_sb3(gymnasium.make("carrl/Track-v0"), frames, seed)


def train_sb3_many_cars(frames: int, seed: int) -> Measurement:
    """Stable-Baselines3 on all cars in one batched environment."""
    from carrl.sb3 import TrackVecEnv

    return _train_sb3(TrackVecEnv("paper", CARS, seed=seed), frames, seed)


def train_sb3_actor_critic(algorithm: str, units: int, frames: int, seed: int) -> Measurement:
    """Stable-Baselines3's SAC, TD3 or DDPG on all cars in one batched environment, which steer by numbers."""
    import stable_baselines3

    from carrl.sb3 import TrackVecEnv
    from carrl.task.action import ContinuousActions

    env = TrackVecEnv("paper", CARS, seed=seed, action=ContinuousActions(("steer",)))
    kind = getattr(stable_baselines3, algorithm.upper())
    model = kind(
        "MlpPolicy",
        env,
        learning_rate=ACTOR_CRITIC_RATES[algorithm],
        buffer_size=CAPACITY,
        learning_starts=ACTOR_CRITIC_BATCH_SIZE,
        batch_size=ACTOR_CRITIC_BATCH_SIZE,
        tau=TAU,
        gamma=ACTOR_CRITIC_GAMMA,
        train_freq=1,
        gradient_steps=-1,
        policy_kwargs={"net_arch": [units, units], "optimizer_kwargs": {"fused": True}},
        seed=seed,
        device="cpu",
    )
    return _measured(model, frames)


PEERS: dict[str, Callable[[int, int], Measurement]] = {
    "sb3-one-car": train_sb3_one_car,
    "sb3-many-cars": train_sb3_many_cars,
    "plain-loop": train_plain,
    **{f"sb3-{algorithm}": partial(train_sb3_actor_critic, algorithm, 64) for algorithm in ACTOR_CRITIC_RATES},
    "sb3-sac-256": partial(train_sb3_actor_critic, "sac", 256),
}


def _train_sb3(env: Any, frames: int, seed: int) -> Measurement:
    """From the beginning of `learn` to its end, without a logger or callbacks.

    Two things are Stable-Baselines3's own and cannot be chosen: the Huber loss and the clipping of gradients.
    """
    from stable_baselines3 import DQN

    model = DQN(
        "MlpPolicy",
        env,
        learning_rate=LEARNING_RATE,
        buffer_size=CAPACITY,
        learning_starts=BATCH_SIZE,
        batch_size=BATCH_SIZE,
        gamma=GAMMA,
        train_freq=1,
        gradient_steps=-1,  # as many as there were env steps since the last ones: one for each car
        target_update_interval=TARGET_PERIOD,
        policy_kwargs={
            "net_arch": list(HIDDEN_SIZES),
            "activation_fn": torch.nn.ReLU,
            "optimizer_kwargs": {"fused": True},  # about a tenth faster than torch's default
        },
        seed=seed,
        device="cpu",
    )
    model.exploration_schedule = lambda remaining: epsilon_after(round((1 - remaining) * frames))
    return _measured(model, frames)


def _measured(model: Any, frames: int) -> Measurement:
    """A model's training, from the beginning of `learn` to its end."""
    began = time.perf_counter()
    model.learn(frames, log_interval=None)
    seconds = time.perf_counter() - began
    return Measurement(int(model.num_timesteps), int(model._n_updates), seconds)


def main(argv: list[str] | None = None) -> None:
    """Trains one and prints its measurement as JSON."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers")
    parser.add_argument("name", choices=sorted(PEERS))
    parser.add_argument("--frames", type=int, required=True)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    torch.set_num_threads(1)
    print(json.dumps(asdict(PEERS[arguments.name](arguments.frames, arguments.seed))))


if __name__ == "__main__":
    main()
