"""DQN as one plain loop of PyTorch and NumPy, in the manner of CleanRL: one environment, one file, no framework.

Shapes: `C` capacity, `M` minibatch, `R` rays.
"""

import copy
import time
from itertools import pairwise

import gymnasium
import numpy as np
import torch
from torch import nn

import carrl  # noqa: F401 (registers carrl/Track-v0)
from benchmarks.figures import Measurement
from benchmarks.settings import (
    BATCH_SIZE,
    CAPACITY,
    GAMMA,
    HIDDEN_SIZES,
    LEARNING_RATE,
    TARGET_PERIOD,
    epsilon_after,
)


class Memory:
    """A ring of the latest C transitions in NumPy arrays."""

    def __init__(self, capacity: int, rays: int) -> None:
        """Makes room for all of them."""
        self.observations = np.zeros((capacity, rays), np.float32)
        self.next_observations = np.zeros((capacity, rays), np.float32)
        self.actions = np.zeros((capacity, 1), np.int64)
        self.rewards = np.zeros(capacity, np.float32)
        self.continues = np.zeros(capacity, np.float32)
        self.added = 0

    def add(self, observation: np.ndarray, action: int, reward: float, after: np.ndarray, terminated: bool) -> None:
        """Keeps one transition in the place of the oldest."""
        place = self.added % len(self.actions)
        self.observations[place], self.next_observations[place] = observation, after
        self.actions[place], self.rewards[place], self.continues[place] = action, reward, not terminated
        self.added += 1

    def sample(self, count: int, random: np.random.Generator) -> list[torch.Tensor]:
        """A minibatch [M, ...], uniform with replacement."""
        places = random.integers(min(self.added, len(self.actions)), size=count)
        columns = (self.observations, self.actions, self.rewards, self.next_observations, self.continues)
        return [torch.from_numpy(column[places]) for column in columns]


def train_plain(frames: int, seed: int) -> Measurement:
    """Trains on `carrl/Track-v0` for this many env steps, with one update for each once there is a minibatch."""
    torch.manual_seed(seed)
    random = np.random.default_rng(seed)
    env: gymnasium.Env[np.ndarray, np.int64] = gymnasium.make("carrl/Track-v0")
    rays, actions = len(env.observation_space.sample()), int(env.action_space.n)  # type: ignore[attr-defined]
    network = _make_network(rays, actions)
    target = copy.deepcopy(network)
    optimizer = torch.optim.Adam(network.parameters(), lr=LEARNING_RATE)
    memory = Memory(CAPACITY, rays)
    updates = 0
    began = time.perf_counter()
    observation, _ = env.reset(seed=seed)
    for frame in range(frames):
        if random.random() < epsilon_after(frame):
            action = int(random.integers(actions))
        else:
            with torch.no_grad():
                action = int(network(torch.from_numpy(observation)).argmax())
        after, reward, terminated, truncated, _ = env.step(action)
        memory.add(observation, action, float(reward), after, terminated)
        observation = env.reset()[0] if terminated or truncated else after
        if memory.added >= BATCH_SIZE:
            _update(network, target, optimizer, memory.sample(BATCH_SIZE, random))
            updates += 1
        if (frame + 1) % TARGET_PERIOD == 0:
            target.load_state_dict(network.state_dict())
    return Measurement(frames, updates, time.perf_counter() - began)


def _make_network(rays: int, actions: int) -> nn.Sequential:
    sizes = [rays, *HIDDEN_SIZES]
    hidden = [layer for pair in pairwise(sizes) for layer in (nn.Linear(*pair), nn.ReLU())]
    return nn.Sequential(*hidden, nn.Linear(sizes[-1], actions))


def _update(
    network: nn.Module, target: nn.Module, optimizer: torch.optim.Optimizer, minibatch: list[torch.Tensor]
) -> None:
    observations, actions, rewards, next_observations, continues = minibatch
    with torch.no_grad():
        wanted = rewards + GAMMA * continues * target(next_observations).max(dim=1).values
    loss = nn.functional.mse_loss(network(observations).gather(1, actions).squeeze(1), wanted)
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
