"""Acts for many agents at once.

Shapes: `A` agents, `B` cars, of which each agent drives the next B / A; `R` values of an observation.
"""

from collections.abc import Callable, Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torch.func import functional_call
from torch.fx.experimental.proxy_tensor import make_fx
from torchrl.modules import QValueActor

from carrl.agent.stack import stack_in_place
from carrl.env.observation import observe


class GreedyPolicy(TensorDictModuleBase):
    """The actions of the highest value, each car's by its own agent's network.

    Reads `observation` [B, R]; writes `action_value` [B, 3], `chosen_action_value` [B, 1] and `action` [B], int64, as
    each network does. The networks' parameters become views of stacked ones, so that the policy follows whatever
    trains them. Their operations are traced once for each number of cars and then called without the modules around
    them, which take several times as long as the arithmetic.

    Args:
        networks: one for each agent, all of one shape.
        observe_action: whether they read the last action, too.
    """

    in_keys = ["observation"]  # noqa: RUF012 (TensorDict's protocol)
    out_keys = ["action_value", "chosen_action_value", "action"]  # noqa: RUF012

    def __init__(self, networks: Sequence[QValueActor], observe_action: bool = False) -> None:
        super().__init__()
        # In a list, which hides them from torch: the collector would copy and register a submodule's parameters.
        layers = [network.module[0].module for network in networks]
        self._layers = layers[:1]
        parameters = [dict(each.named_parameters()) for each in layers]
        self._stacked = {name: stack_in_place([of_one[name] for of_one in parameters]) for name in parameters[0]}
        self._traces: dict[torch.Size, Callable[..., Tensor]] = {}
        self._observe_action = observe_action
        self.agents = len(networks)

    def action_values(self, observation: Tensor) -> Tensor:
        """The value of every action, [B, 3]: observations [B, R] as the environment gives them."""
        by_agent = observation.view(self.agents, -1, observation.shape[-1])
        if by_agent.shape not in self._traces:
            trace = make_fx(lambda parameters, observation: self._compute(parameters, observation))
            self._traces[by_agent.shape] = trace(self._stacked, by_agent)
        return self._traces[by_agent.shape](self._stacked, by_agent).flatten(0, 1)

    def actions(self, readings: Tensor, last_action: Tensor) -> Tensor:
        """The actions of the highest value, [B], int64: readings [B, R] in 0..1, right to left; last actions [B]."""
        return self.action_values(observe(readings, last_action, self._observe_action)).argmax(dim=-1)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the actions and their values."""
        values = self.action_values(tensordict["observation"])
        action = values.argmax(dim=-1)
        tensordict["action_value"] = values
        tensordict["chosen_action_value"] = values.gather(-1, action[:, None])
        tensordict["action"] = action
        return tensordict

    def _compute(self, parameters: dict[str, Tensor], by_agent: Tensor) -> Tensor:
        """The values [A, N, 3] of observations [A, N, R]."""
        return torch.vmap(lambda own, observation: functional_call(self._layers[0], own, (observation,)))(
            parameters, by_agent
        )
