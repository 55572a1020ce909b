"""Table I of the paper, which every contestant trains with."""

import math

HIDDEN_SIZES = (16, 16, 8)
CAPACITY = 131_072
BATCH_SIZE = 128
GAMMA = 0.95
LEARNING_RATE = 1e-3
TARGET_PERIOD = 36_000
CARS = 64
"""Driven side by side where a contestant can, as in CarRL's own run."""


def epsilon_after(frames: int) -> float:
    """The probability of a random action after this many env steps (the paper, eq. 4)."""
    return 0.01 + 0.98 * math.exp(-1e-4 * frames)


ACTOR_CRITIC_BATCH_SIZE = 256
ACTOR_CRITIC_GAMMA = 0.99
ACTOR_CRITIC_RATES = {"sac": 3e-4, "td3": 1e-3, "ddpg": 1e-3}
"""Of actor and critics alike; each is there with Stable-Baselines3, too."""
TAU = 0.005
