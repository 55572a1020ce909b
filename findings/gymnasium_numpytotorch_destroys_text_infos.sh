#!/usr/bin/env bash
# Expected: NumpyToTorch turns the arrays of an environment into tensors and hands everything
#   else in `info` through. The wrapper has nothing to convert in a text, and None and bytes do
#   come back as they were.
# Happens: every str in `info` is replaced by the repr of a generator object, without an
#   exception or a warning. A text is an iterable, so it lands in the branch for lists, which
#   rebuilds a value as type(value)(generator): right for list and tuple, but str(generator) is
#   "<generator object ...>". Texts inside lists and dicts go the same way.
# Versions: Gymnasium 1.4.0, array-api-compat 1.16.0, torch 2.13.0, NumPy 2.4.6, Python 3.11.
# Matters to: whoever reads names from infos in a torch loop (track or level ids, the reason an
#   episode ended). Grouping by such a name makes a new group every few steps, because the
#   repr holds an address; comparing it with a known name is always false.
# Way out: keep texts in an attribute of the environment, or send a number and look the name up.
# (packaging is installed by name: the wrapper imports it, the extra gymnasium[torch] forgets it.)
set -euo pipefail
unset PYTHONPATH
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --disable-pip-version-check \
    torch==2.13.0 gymnasium==1.4.0 array-api-compat==1.16.0 numpy==2.4.6 packaging==26.4
cat > "$work/show.py" <<'PY'
from importlib.metadata import version

import gymnasium as gym
import numpy as np
import torch
from gymnasium.wrappers import NumpyToTorch

for package in ("gymnasium", "array-api-compat", "torch", "numpy"):
    print(f"{package} {version(package)}")


class Corridor(gym.Env):
    observation_space = gym.spaces.Box(-1, 1, (2,), np.float32)
    action_space = gym.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(2, np.float32), {"level": "oval"}

    def step(self, action):
        info = {"level": "oval", "tags": ["wet"], "raw": b"oval", "nothing": None, "laps": 2}
        return np.zeros(2, np.float32), 0.0, False, False, info


plain = Corridor()
plain.reset()
before = plain.step(1)[4]
wrapped = NumpyToTorch(Corridor())
_, reset_info = wrapped.reset()
after = wrapped.step(torch.tensor(1))[4]
print("reset:", reset_info)
for key, value in before.items():
    print(f"step: {key:8s} {value!r} -> {after[key]!r}")

texts = (reset_info["level"], after["level"], after["tags"][0])
still = all(text.startswith("<generator object") for text in texts)
still = still and after["raw"] == b"oval" and after["nothing"] is None
print("still so: texts are replaced by the name of a generator" if still else "CHANGED")
raise SystemExit(0 if still else 1)
PY
"$work/venv/bin/python" "$work/show.py"
