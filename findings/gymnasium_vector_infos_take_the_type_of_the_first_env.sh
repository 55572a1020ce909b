#!/usr/bin/env bash
# Expected: a vector environment collects the infos of its sub-environments without changing
#   them: 0 from the first and 12.75 from the second are [0.0, 12.75], as np.array would say.
# Happens: the array for a key gets the type of the value that arrives FIRST, and later values
#   are cast to it in silence. An int 0 in sub-environment 0 cuts the fractions of all others; a
#   bool turns their counts and times into True; an int8 or an int array does the same. With the
#   sub-environments in the other order the values are right, and where sub-environment 0 leaves
#   the key out they are right too, so it comes and goes from step to step. Two cases are loud
#   instead: infinity or None after an int raises inside reset() or step().
# Versions: Gymnasium 1.4.0 (SyncVectorEnv and AsyncVectorEnv), NumPy 2.4.6, Python 3.11.
# Matters to: environments with "not yet" written as 0, False or -1 and a float afterwards (best
#   lap time, distance, return so far), hence to everyone who logs or plots infos of a vector
#   environment: the numbers look reasonable and are rounded down.
# Way out: always send one type for a key (0.0, not 0), or np.float32 scalars.
set -euo pipefail
unset PYTHONPATH
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --disable-pip-version-check gymnasium==1.4.0 numpy==2.4.6
cat > "$work/show.py" <<'PY'
from functools import partial
from importlib.metadata import version

import gymnasium as gym
import numpy as np
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv


class Lap(gym.Env):
    observation_space = gym.spaces.Box(-1, 1, (1,), np.float32)
    action_space = gym.spaces.Discrete(2)

    def __init__(self, best_lap):
        self.best_lap = best_lap

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(1, np.float32), {} if self.best_lap is None else {"best_lap": self.best_lap}


def collected(kind, *best_laps):
    envs = kind([partial(Lap, best_lap) for best_lap in best_laps])
    values = envs.reset()[1]["best_lap"]
    envs.close()
    print(f"{kind.__name__:14s} sent {best_laps!r:22} -> {values.tolist()!r:16} {values.dtype}")
    return values.tolist()


if __name__ == "__main__":
    print(f"gymnasium {version('gymnasium')}, numpy {version('numpy')}")
    still = collected(SyncVectorEnv, 0, 12.75) == [0, 12]
    still &= collected(SyncVectorEnv, 12.75, 0) == [12.75, 0.0]
    still &= collected(SyncVectorEnv, None, 12.75) == [0.0, 12.75]
    still &= collected(SyncVectorEnv, False, 12.75) == [False, True]
    still &= collected(SyncVectorEnv, True, 3) == [True, True]
    still &= collected(AsyncVectorEnv, 0, 12.75) == [0, 12]
    try:
        collected(SyncVectorEnv, 0, float("inf"))
        still = False
    except OverflowError as error:
        print(f"SyncVectorEnv  sent (0, inf) -> OverflowError: {error}")
    print("still so: the first value decides the type" if still else "CHANGED")
    raise SystemExit(0 if still else 1)
PY
"$work/venv/bin/python" "$work/show.py"
