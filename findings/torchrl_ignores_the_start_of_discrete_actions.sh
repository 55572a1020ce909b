#!/usr/bin/env bash
# Expected: Discrete(3, start=-1) is Gymnasium's way to say that the actions are -1, 0 and 1
#   (right, straight, left). GymWrapper either sends these or refuses the space.
# Happens: GymWrapper drops `start` and sends 0, 1 and 2: -1 is never taken and 2, which is
#   outside the space, is. MultiDiscrete(start=...) and vector environments go the same way.
#   Nothing warns, and check_env_specs succeeds, because it looks at TorchRL's spec only. An
#   environment that computes with the action (steering = action * angle) trains on without
#   one of its actions and with one twice as strong; one that indexes a list may even work.
#   (Stable-Baselines3 ignores `start` too, but documents it, and its check_env warns.)
# Versions: torchrl 0.14.1, tensordict 0.14.3, torch 2.13.0, Gymnasium 1.4.0, Python 3.11.
# Matters to: TorchRL users with signed actions: steering, gear changes, trading positions.
# Way out: Discrete(3) and the shift inside the environment, or gym.wrappers.TransformAction.
set -euo pipefail
unset PYTHONPATH
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --disable-pip-version-check \
    torch==2.13.0 torchrl==0.14.1 tensordict==0.14.3 gymnasium==1.4.0 numpy==2.4.6
cat > "$work/show.py" <<'PY'
from importlib.metadata import version

import gymnasium as gym
import numpy as np
import torch
from gymnasium.spaces import Box, Discrete, MultiDiscrete
from torchrl.envs import GymWrapper
from torchrl.envs.utils import check_env_specs

for package in ("torchrl", "tensordict", "torch", "gymnasium"):
    print(f"{package} {version(package)}")


class Car(gym.Env):
    observation_space = Box(-1, 1, (1,), np.float32)

    def __init__(self, action_space):
        self.action_space = action_space
        self.taken = []

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.taken.append(action)
        return np.zeros(1, np.float32), 0.0, False, False, {}


def received(action_space, categorical):
    car = Car(action_space)
    env = GymWrapper(car, categorical_action_encoding=categorical)
    check_env_specs(env)
    env.rollout(100)
    legal = sum(action in action_space for action in car.taken)
    values = sorted({int(value) for action in car.taken for value in np.atleast_1d(action)})
    print(f"{action_space}: values received {values}, {legal} of {len(car.taken)} actions legal")
    return values


torch.manual_seed(0)
signed = Discrete(3, start=-1)
still = received(Discrete(3), True) == [0, 1, 2]
still &= received(signed, True) == [0, 1, 2]
still &= received(signed, False) == [0, 1, 2]
still &= received(MultiDiscrete([3, 3], start=[-1, -1]), True) == [0, 1, 2]
print("still so: start is ignored" if still else "CHANGED")
raise SystemExit(0 if still else 1)
PY
"$work/venv/bin/python" "$work/show.py"
