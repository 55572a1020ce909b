"""What there is to say about a loss that stopped being a number."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from tensordict import TensorDictBase
from torch import nn

REPORT = "divergence.json"
"""The file in a run's folder with the whole story."""


@dataclass(frozen=True)
class Divergence:
    """The first update of an agent whose loss was not finite.

    Attributes:
        update: its number, from 1.
        loss: before it.
        items: of the minibatch, places in the replay buffer.
    """

    update: int
    loss: float
    items: Sequence[int]


def describe(divergence: Divergence, minibatch: TensorDictBase, network: nn.Module) -> dict[str, Any]:
    """The minibatch's values and the parameters' norms, ready for JSON.

    Args:
        divergence: what happened.
        minibatch: the agent's transitions [N], as they are in the buffer.
        network: as it is after the updates that followed in the same round.
    """
    return {
        "update": divergence.update,
        "loss": str(divergence.loss),
        "minibatch": {
            name: {"least": str(values.min().item()), "greatest": str(values.max().item())}
            for name, values in minibatch.exclude("index").flatten_keys(".").items()
        },
        "parameter_norms": {name: str(value.norm().item()) for name, value in network.named_parameters()},
        "items": list(divergence.items),
    }


def sentence(report: dict[str, Any]) -> str:
    """The report in short."""
    reward = report["minibatch"]["next.reward"]
    norms = ", ".join(f"{float(norm):.3g}" for norm in report["parameter_norms"].values())
    place = f"at update {report['update']:,}" + (f", frame {report['frame']:,}," if "frame" in report else "")
    return (
        f"the loss is {report['loss']} {place} of seed {report['seed']}: the rewards of its minibatch are "
        f"{reward['least']} to {reward['greatest']}, the norms of the parameters {norms} ({REPORT} has all of it); "
        "try a smaller optimizer.lr, also with resume=RUN"
    )
