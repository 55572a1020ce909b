#!/usr/bin/env bash
# Expected: after buffer.empty() and extend(new), each sample comes from the new data. That is
#   the loop of PPO: collect, fill, a few epochs, empty, collect again.
# Happens: with `prefetch` the batches drawn ahead outlive empty(): it clears storage, sampler
#   and writer but not the queue of batches, so the next samples hold data that was deleted.
#   With the default random sampler these are the next `prefetch` batches. Without replacement
#   the leftovers are used up where an epoch runs to its end, and it happens only where it is
#   left early (a stop at a KL limit). Nothing is said; log-probabilities, advantages and returns
#   of a policy that no longer exists take part in the update. If the batch is drawn between
#   empty() and extend(), sample() raises an IndexError of that moment later on instead (not
#   shown, it depends on the threads).
# Versions: torchrl 0.14.1, tensordict 0.14.3, torch 2.13.0, Python 3.11.
# Matters to: on-policy training with a prefetching buffer and early stopping; whoever empties a
#   replay buffer between tasks or seeds.
# Way out: a new buffer, or throw `prefetch` samples away after empty().
set -euo pipefail
unset PYTHONPATH
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --disable-pip-version-check \
    torch==2.13.0 torchrl==0.14.1 tensordict==0.14.3 numpy==2.4.6
cat > "$work/show.py" <<'PY'
import logging
import time
from importlib.metadata import version

import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.data.replay_buffers import RandomSampler, SamplerWithoutReplacement

logging.disable(logging.INFO)
for package in ("torchrl", "tensordict", "torch"):
    print(f"{package} {version(package)}")


def policies_seen(sampler, prefetch):
    """Train on policy 0, stop early, empty the buffer, fill it from policy 1, sample four times."""
    buffer = ReplayBuffer(
        storage=LazyTensorStorage(32), sampler=sampler, batch_size=8, prefetch=prefetch
    )
    buffer.extend(TensorDict({"policy": torch.zeros(32, dtype=torch.int64)}, [32]))
    buffer.sample()
    time.sleep(1)  # the threads that fetch ahead are done long before
    buffer.empty()
    buffer.extend(TensorDict({"policy": torch.ones(32, dtype=torch.int64)}, [32]))
    return [buffer.sample()["policy"].unique().tolist() for _ in range(4)]


seen = {}
for sampler in (RandomSampler, SamplerWithoutReplacement):
    for prefetch in (None, 1, 2):
        seen[sampler, prefetch] = policies_seen(sampler(), prefetch)
        print(f"{sampler.__name__}, prefetch={prefetch}: policies {seen[sampler, prefetch]}")

still = all(batch == [1] for batch in seen[RandomSampler, None])
still &= all(batch == [1] for batch in seen[SamplerWithoutReplacement, None])
still &= seen[RandomSampler, 2] == [[0], [0], [1], [1]]
still &= seen[SamplerWithoutReplacement, 2][0] == [0]
print("still so: deleted data is sampled" if still else "CHANGED")
raise SystemExit(0 if still else 1)
PY
"$work/venv/bin/python" "$work/show.py"
