"""Acts for many agents at once.

Shapes: `A` agents, `B` cars, of which each agent drives the next B / A; `R` values of an observation.
"""

from collections.abc import Mapping, Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torch.func import functional_call
from torchrl.modules import QValueActor

from carrl.algorithms.common.network import Power
from carrl.algorithms.common.stack import stack_in_place


class GreedyPolicy(TensorDictModuleBase):
    """The actions of the highest value, each car's by its own agent's network.

    Reads `observation` [B, R]; writes `action_value` [B, 3], `chosen_action_value` [B, 1] and `action` [B], int64, as
    each network does. The networks' parameters become views of stacked ones, so that the policy follows whatever
    trains them.

    Args:
        networks: one for each agent, all of one shape.
    """

    in_keys = ["observation"]  # noqa: RUF012 (TensorDict's protocol)
    out_keys = ["action_value", "chosen_action_value", "action"]  # noqa: RUF012

    def __init__(self, networks: Sequence[QValueActor]) -> None:
        super().__init__()
        layers = [network.module[0].module for network in networks]
        parameters = [dict(each.named_parameters()) | dict(each.named_buffers()) for each in layers]
        self._stacked = {name: stack_in_place([of_one[name] for of_one in parameters]) for name in parameters[0]}
        self._layers = layers[:1]  # in a list, which hides it from torch: the collector would copy its parameters
        self._is_layered = isinstance(layers[0], nn.Sequential) and all(map(_is_simple, layers[0]))
        self.agents = len(networks)

    @property
    def weights(self) -> Mapping[str, Tensor]:
        """Of all networks, stacked, [A, ...], by name."""
        return self._stacked

    def load_weights(self, weights: Mapping[str, Tensor]) -> None:
        """Copies these, by the same names and of the same shapes, into the networks."""
        for name, own in self._stacked.items():
            own.copy_(weights[name])

    def action_values(self, observation: Tensor) -> Tensor:
        """The value of every action, [B, 3]: observations [B, R] as the environment gives them."""
        by_agent = observation.view(self.agents, -1, observation.shape[-1])
        (layers,) = self._layers
        if self._is_layered:
            return self._layer_by_layer(layers, by_agent).flatten(0, 1)
        compute = torch.vmap(lambda own, observed: functional_call(layers, own, (observed,)))
        return compute(self._stacked, by_agent).flatten(0, 1)

    def _layer_by_layer(self, layers: nn.Sequential, values: Tensor) -> Tensor:
        """What vmap would compute, [A, N, R] to [A, N, 3], in a tenth of the time."""
        for name, layer in layers.named_children():
            if isinstance(layer, nn.Linear):
                weight, bias = self._stacked[f"{name}.weight"], self._stacked[f"{name}.bias"]
                values = torch.baddbmm(bias[:, None], values, weight.mT)
            else:
                values = layer(values)
        return values

    def actions(self, observation: Tensor) -> Tensor:
        """The actions of the highest value, [B], int64: observations [B, R] as the environment gives them."""
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
