"""What actors do, with and without exploration, for many replicates at once.

Shapes: `A` replicates, `B` cars, of which each replicate drives the next B / A; `O` values of an observation; `C`
controls.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs.utils import ExplorationType, exploration_type

from carrl.algorithms.actor_critic.exploration import ActionNoise
from carrl.algorithms.actor_critic.network import Actor
from carrl.algorithms.algorithm import CollectPolicy
from carrl.algorithms.common.stacked import StackedLayers


class GreedyActors:
    """The actions without exploration, each car's by its own replicate's actor.

    Args:
        actors: one for each replicate, all of one shape.
    """

    def __init__(self, actors: Sequence[Actor]) -> None:
        self.layers = StackedLayers([actor.layers for actor in actors])
        self.is_stochastic, self.distribution = actors[0].is_stochastic, actors[0].distribution

    def actions(self, observation: Tensor) -> Tensor:
        """The actions [B, C]: observations [B, O] as the environment gives them."""
        return self.middle(self.layers(observation))

    def middle(self, outputs: Tensor) -> Tensor:
        """The action of a deterministic actor's outputs; of a stochastic one's the middle, where its noise is zero."""
        return (outputs.chunk(2, -1)[0] if self.is_stochastic else outputs).tanh()

    def drawn(self, outputs: Tensor, noise: Tensor) -> Tensor:
        """The action of a stochastic actor's outputs, with this noise, standard normal, [B, C]."""
        loc, scale = self.distribution(outputs)
        return torch.tanh(loc + scale * noise)


class ActorPolicy(CollectPolicy):
    """Each car's action by its own replicate's actor, drawn where that is stochastic, and with noise.

    Reads `observation` [B, O] and, if it is there, `step` [B], the number of the step in its episode; writes `action`
    and `greedy_action`, which is without exploration, [B, C] each.

    Args:
        actors: of all replicates.
        exploration: of all their cars.
    """

    in_keys = ["observation"]  # noqa: RUF012 (TensorDict's protocol)
    out_keys = ["action", "greedy_action"]  # noqa: RUF012

    def __init__(self, actors: GreedyActors, exploration: ActionNoise) -> None:
        super().__init__()
        self.actors, self.exploration = actors, exploration

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the actions; those without exploration where its type asks for them."""
        outputs = self.actors.layers(tensordict["observation"])
        greedy = action = self.actors.middle(outputs)
        if exploration_type() in (ExplorationType.RANDOM, None):
            if self.actors.is_stochastic:
                action = self.actors.drawn(outputs, self.exploration.draw(len(outputs)))
            step = tensordict.get("step", None)
            is_first = torch.zeros(len(action), dtype=torch.bool) if step is None else step.view(-1) == 0
            action = self.exploration(action, is_first.to(action.device))
        tensordict["action"], tensordict["greedy_action"] = action, greedy
        return tensordict

    @property
    def device(self) -> torch.device:
        """Where it acts."""
        return self.exploration.device

    def shared_state(self) -> dict[str, Any]:
        """The actors' weights, and the env steps by which noise falls."""
        weights = {name: weight.cpu() for name, weight in self.actors.layers.weights.items()}
        return {"weights": weights, "env_steps": int(self.exploration.env_steps)}

    def load_shared_state(self, state: Mapping[str, Any]) -> None:
        """Acts from now on as the policy with this state."""
        self.actors.layers.load_weights(state["weights"])
        self.exploration.step(state["env_steps"] - int(self.exploration.env_steps))
