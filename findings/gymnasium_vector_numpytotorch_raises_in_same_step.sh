#!/usr/bin/env bash
# Expected: SAME_STEP is one of the three autoreset modes of Gymnasium's vector environments and
#   NumpyToTorch one of its vector wrappers, so make_vec("CartPole-v1") with both runs on.
# Happens: it runs until the first episode ends and then raises BufferError from step(). In this
#   mode the last observations of ended episodes travel in info["final_obs"], an array of dtype
#   object with None for the sub-environments that go on, and the wrapper passes each array of
#   `info` to DLPack, which has no such type. NEXT_STEP and DISABLED carry no such array and work.
#   Nothing is said when the two are put together, and a smoke test shorter than one episode is
#   green. (Any other info that Gymnasium stores as an object array, such as a text, raises too.)
# Versions: Gymnasium 1.4.0, array-api-compat 1.16.0, torch 2.13.0, NumPy 2.4.6, Python 3.11.
# Matters to: PyTorch users who choose SAME_STEP, which is what Stable-Baselines3 and older
#   Gym did and the mode in which no step is wasted.
# Way out: convert observations, rewards and flags with torch.from_numpy in the training loop.
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
import torch
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import NumpyToTorch

for package in ("gymnasium", "array-api-compat", "torch", "numpy"):
    print(f"{package} {version(package)}")


def outcome(mode):
    """Push three carts to the left until an episode has ended."""
    plain = gym.make_vec("CartPole-v1", 3, "sync", vector_kwargs={"autoreset_mode": mode})
    envs = NumpyToTorch(plain)
    envs.reset(seed=0)
    for step in range(1, 50):
        try:
            terminated = envs.step(torch.zeros(3, dtype=torch.int64))[2]
        except BufferError as error:
            return f"BufferError in step {step}: {error}"
        if terminated.any():
            return f"an episode ended in step {step}, no error"
    return "no episode ended"


outcomes = {mode: outcome(mode) for mode in AutoresetMode}
for mode, text in outcomes.items():
    print(f"{mode.name:10s} {text}")
raises = [mode for mode, text in outcomes.items() if text.startswith("BufferError")]
ends = [mode for mode, text in outcomes.items() if text.startswith("an episode ended")]
still = raises == [AutoresetMode.SAME_STEP] and len(ends) == 2
print("still so: only SAME_STEP raises" if still else "CHANGED")
raise SystemExit(0 if still else 1)
PY
"$work/venv/bin/python" "$work/show.py"
