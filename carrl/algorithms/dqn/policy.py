"""Acts for many replicates at once.

Shapes: `A` replicates, `B` cars, of which each replicate drives the next B / A; `O` values of an observation; `K`
actions.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torch.func import functional_call

from carrl.algorithms.algorithm import CollectPolicy
from carrl.algorithms.common.network import Power, QNetwork
from carrl.algorithms.common.stack import stack_in_place
from carrl.algorithms.dqn.exploration import EpsilonGreedy


class GreedyPolicy(TensorDictModuleBase):
    """The actions of the highest value, each car's by its own replicate's network.

    Reads `observation` [B, O]; writes `action_value` [B, K], `chosen_action_value` [B, 1] and `action` [B], int64, as
    each network does. The networks' parameters become views of stacked ones, so that the policy follows whatever
    trains them.

    Args:
        networks: one for each replicate, all of one shape.
    """

    in_keys = ["observation"]  # noqa: RUF012 (TensorDict's protocol)
    out_keys = ["action_value", "chosen_action_value", "action"]  # noqa: RUF012

    def __init__(self, networks: Sequence[QNetwork]) -> None:
        super().__init__()
        layers = [network.layers for network in networks]
        parameters = [dict(each.named_parameters()) | dict(each.named_buffers()) for each in layers]
        self._stacked = {name: stack_in_place([of_one[name] for of_one in parameters]) for name in parameters[0]}
        self.layers = layers[0]  # whose values the stacked ones replace
        self.replicates = len(networks)
        self._is_layered = isinstance(self.layers, nn.Sequential) and all(map(_is_simple, self.layers))

    @property
    def weights(self) -> Mapping[str, Tensor]:
        """Of all networks, stacked, [A, ...], by name."""
        return self._stacked

    def load_weights(self, weights: Mapping[str, Tensor]) -> None:
        """Copies these, by the same names and of the same shapes, into the networks."""
        for name, own in self._stacked.items():
            own.copy_(weights[name])

    def action_values(self, observation: Tensor) -> Tensor:
        """The value of every action, [B, K]: observations [B, O] as the environment gives them."""
        by_replicate = observation.view(self.replicates, -1, observation.shape[-1])
        if self._is_layered:
            return self._layer_by_layer(by_replicate).flatten(0, 1)
        compute = torch.vmap(lambda own, observed: functional_call(self.layers, own, (observed,)))
        return compute(self._stacked, by_replicate).flatten(0, 1)

    def _layer_by_layer(self, values: Tensor) -> Tensor:
        """What vmap would compute, [A, N, O] to [A, N, K], in a tenth of the time."""
        for name, layer in self.layers.named_children():
            if isinstance(layer, nn.Linear):
                weight, bias = self._stacked[f"{name}.weight"], self._stacked[f"{name}.bias"]
                values = torch.baddbmm(bias[:, None], values, weight.mT)
            else:
                values = layer(values)
        return values

    def actions(self, observation: Tensor) -> Tensor:
        """The actions of the highest value, [B], int64: observations [B, O] as the environment gives them."""
        return self.action_values(observation).argmax(dim=-1)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the actions and their values."""
        values = self.action_values(tensordict["observation"])
        action = values.argmax(dim=-1)
        tensordict["action_value"] = values
        tensordict["chosen_action_value"] = values.gather(-1, action[:, None])
        tensordict["action"] = action
        return tensordict


def _is_simple(layer: nn.Module) -> bool:
    """Whether a layer is linear and no more than that, or does the same to each value."""
    return (type(layer) is nn.Linear and layer.bias is not None) or isinstance(
        layer, nn.ReLU | nn.Tanh | nn.ELU | Power
    )


class ExploringPolicy(CollectPolicy):
    """The greedy action, or by chance another one; writes what both its parts do."""

    in_keys = GreedyPolicy.in_keys
    out_keys = [*GreedyPolicy.out_keys, "epsilon", "exploratory"]  # noqa: RUF012

    def __init__(self, greedy: GreedyPolicy, exploration: EpsilonGreedy) -> None:
        super().__init__()
        self.greedy, self.exploration = greedy, exploration

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the actions."""
        return self.exploration(self.greedy(tensordict))

    @property
    def device(self) -> torch.device:
        """Where it acts."""
        return self.exploration.env_steps.device

    def shared_state(self) -> dict[str, Any]:
        """The networks' weights, and the env steps by which epsilon falls."""
        weights = {name: weight.cpu() for name, weight in self.greedy.weights.items()}
        return {"weights": weights, "env_steps": int(self.exploration.env_steps)}

    def load_shared_state(self, state: Mapping[str, Any]) -> None:
        """Acts from now on as the policy with this state."""
        self.greedy.load_weights(state["weights"])
        self.exploration.step(state["env_steps"] - int(self.exploration.env_steps))
