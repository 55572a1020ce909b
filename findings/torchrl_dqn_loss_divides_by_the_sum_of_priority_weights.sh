#!/usr/bin/env bash
# Expected: with importance weights w of a prioritised memory the loss is the mean of w_i l_i over
#   the minibatch, as in Schaul et al. 2016 (Algorithm 1), who divide the weights by the greatest
#   one so that they only scale updates down.
# Happens: DQNLoss (and all that reduce as it does) returns sum(w l) / sum(w). Only the ratios of
#   the weights count: the same weights times 0.01 give the same loss and gradient. A minibatch
#   with small weights throughout counts as much as any other, so whether a sampler divides by the
#   greatest weight, of the batch or of the memory, makes no difference, and losses are several
#   times those of other implementations (below: 0.84 where the mean is 0.44). Nothing warns.
# Versions: torchrl 0.14.1, tensordict 0.14.3, torch 2.13.0, Python 3.11.
# Matters to: anyone who compares prioritised DQN in TorchRL with another implementation, or
#   writes an update of their own beside it.
# Way out: reduction="none" (the elements are then w_i l_i), and the mean by hand.
set -euo pipefail
unset PYTHONPATH
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --disable-pip-version-check torch==2.13.0 torchrl==0.14.1 tensordict==0.14.3 numpy==2.4.6
cat > "$work/show.py" <<'PY'
from importlib.metadata import version

import torch
from tensordict import TensorDict
from torchrl.modules import MLP, QValueActor
from torchrl.objectives import DQNLoss

for package in ("torchrl", "tensordict", "torch"):
    print(f"{package} {version(package)}")

torch.manual_seed(0)
network = QValueActor(MLP(in_features=4, out_features=3, num_cells=[8]), in_keys=["observation"], action_space="categorical")
batch = TensorDict(
    {
        "observation": torch.randn(16, 4),
        "action": torch.randint(3, (16,)),
        "next": {
            "observation": torch.randn(16, 4),
            "reward": torch.randn(16, 1),
            "done": torch.zeros(16, 1, dtype=torch.bool),
            "terminated": torch.zeros(16, 1, dtype=torch.bool),
        },
    },
    batch_size=[16],
)
weights = torch.linspace(0.05, 1.0, 16)


def measured(scale, reduction="mean"):
    loss = DQNLoss(network, loss_function="l2", delay_value=True, action_space="categorical", reduction=reduction)
    loss.make_value_estimator(gamma=0.9)
    sample = batch.clone()
    sample["priority_weight"] = scale * weights
    value = loss(sample)["loss"]
    if reduction == "none":
        return value.detach()
    network.zero_grad()
    value.backward()
    return value.item(), torch.cat([each.grad.flatten() for each in loss.parameters() if each.grad is not None]).norm().item()


elements = measured(1.0, "none")
print(f"mean of w l: {elements.mean().item():.4f}; sum(w l) / sum(w): {(elements.sum() / weights.sum()).item():.4f}")
found = {scale: measured(scale) for scale in (1.0, 0.1, 0.01)}
for scale, (value, gradient) in found.items():
    print(f"weights times {scale}: loss {value:.4f}, norm of the gradient {gradient:.4f}")
same = all(abs(value / found[1.0][0] - 1) < 1e-4 and abs(gradient / found[1.0][1] - 1) < 1e-4 for value, gradient in found.values())
by_sum = abs(found[1.0][0] - (elements.sum() / weights.sum()).item()) < 1e-4
print("still so" if same and by_sum else "changed: smaller weights no longer give the same loss")
raise SystemExit(0 if same and by_sum else 1)
PY
"$work/venv/bin/python" "$work/show.py" 2> "$work/warnings"
