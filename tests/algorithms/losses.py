"""A network and transitions small enough to work out a loss by hand, and random ones for comparisons."""

import torch
from tensordict import TensorDict
from torch import nn

from carrl.algorithms.common.network import QNetwork
from carrl.algorithms.common.optimizer import make_hard_update

TRAINED, TARGET = (1.0, 4.0, 2.0), (3.0, 5.0, 7.0)


def linear_network(weights=TRAINED):
    """Q-values that are the weights times a single input."""
    layer = nn.Linear(1, 3, bias=False)
    layer.weight.data = torch.tensor(weights)[:, None]
    return QNetwork(layer)


def transitions(count=1, action=0, reward=2.0):
    following = {
        "observation": torch.ones(count, 1),
        "reward": torch.full((count, 1), reward),
        "terminated": torch.zeros(count, 1, dtype=torch.bool),
        "done": torch.zeros(count, 1, dtype=torch.bool),
    }
    values = {"observation": torch.ones(count, 1), "action": torch.full((count,), action), "next": following}
    return TensorDict(values, [count])


def with_target(loss, target=TARGET):
    make_hard_update(1000, loss=loss)  # without an updater the loss warns
    loss.target_value_network_params["module", "0", "module", "weight"].data.copy_(torch.tensor(target)[:, None])
    return loss


def random_transitions(count=64):
    generator = torch.Generator().manual_seed(0)

    def noise(*shape):
        return torch.randn(count, *shape, generator=generator)

    terminated = noise(1) > 0.5
    following = {"observation": noise(7), "reward": noise(1), "terminated": terminated, "done": terminated}
    action = torch.randint(3, (count,), generator=generator)
    return TensorDict({"observation": noise(7), "action": action, "next": following}, [count])
