"""DQN and its descendants, as one algorithm.

Shapes: `A` replicates, `N` transitions of a minibatch, `F` of any number.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.func import grad_and_value
from torchrl.data import Categorical
from torchrl.objectives import DQNLoss

from carrl.algorithms.algorithm import (
    Algorithm,
    Figures,
    FunctionalUpdate,
    ManyUpdates,
    Policy,
    Tree,
    UpdateResult,
)
from carrl.algorithms.common.measuring import thinned
from carrl.algorithms.common.native import CompilationError, has_compiler
from carrl.algorithms.common.network import QNetwork
from carrl.algorithms.common.optimizer import Adam, GradientClipping, LearningRateDecay, SoftTargetUpdate, TargetUpdater
from carrl.algorithms.common.parts import check_parts
from carrl.algorithms.common.stand_ins import standing_in
from carrl.algorithms.common.weight_noise import WeightNoise, is_noisy
from carrl.algorithms.dqn.loss import ConservativeDQNLoss
from carrl.algorithms.dqn.policy import EpsilonGreedy, ExploringPolicy, GreedyActions, GreedyPolicy, value_column
from carrl.algorithms.dqn.update import MOST_WEIGHTS, MachineUpdates, check_plain, weights_of
from carrl.config import build_node
from carrl.errors import ConfigError
from carrl.log.schema import Column
from carrl.task.random_streams import part_generator
from carrl.task.task import World


@dataclass(frozen=True)
class Replicate:
    """One seed's network, its loss with the target network in it, and what moves them."""

    seed: int
    network: QNetwork
    loss: DQNLoss
    optimizer: torch.optim.Optimizer
    target_updater: TargetUpdater
    clipping: GradientClipping | None = None
    learning_rate: LearningRateDecay | None = None
    noise: WeightNoise | None = None


class DQN(Algorithm):
    """A value for each action, learnt against a target network; which descendant it is, network and loss say.

    Args:
        replicates: alike in everything but their values.
        exploration: of all their cars.
        action_names: of the actions that there are.
    """

    def __init__(
        self, replicates: Sequence[Replicate], exploration: EpsilonGreedy, action_names: Sequence[str]
    ) -> None:
        self.log_columns = dqn_columns(action_names)
        self.replicates, self.exploration = list(replicates), exploration
        self.seeds = [replicate.seed for replicate in replicates]
        networks = [replicate.network for replicate in replicates]
        self.networks = networks
        self.greedy = GreedyPolicy(networks)
        self.greedy_policy = self.greedy.actions
        self.collect_policy = ExploringPolicy(self.greedy, exploration)
        self._rates = [[group["lr"] for group in replicate.optimizer.param_groups] for replicate in replicates]

    def check_memory(self, weighted: bool) -> None:
        """Raises ConfigError if the weights would count for a part of the loss only."""
        if weighted and isinstance(self.replicates[0].loss, ConservativeDQNLoss):
            raise ConfigError(
                "loss is cql, whose conservative term weighs all transitions alike, and replay_buffer is prioritized; "
                "set replay_buffer=uniform, or another loss"
            )

    # Updates

    @property
    def steps_left(self) -> int:
        """Env steps from now to the next copy into a target network."""
        return min(replicate.target_updater.steps_left for replicate in self.replicates)

    def count_steps(self, steps: int) -> None:
        """Moves epsilon along, and copies into the target networks if it is time."""
        for replicate in self.replicates:
            replicate.target_updater.step(steps)
        self.exploration.step(steps)

    def prepare(self, update: int, batch_size: int) -> None:
        """Sets learning rates and draws the noise of weights."""
        for replicate, rates in zip(self.replicates, self._rates, strict=True):
            if replicate.learning_rate is not None:
                for group, rate in zip(replicate.optimizer.param_groups, rates, strict=True):
                    group["lr"] = rate * replicate.learning_rate.share(update)
            if replicate.noise is not None:
                replicate.noise.draw()

    def update(self, batch: TensorDictBase) -> UpdateResult:
        """Calls TorchRL's loss and torch's optimizer as they are, for one replicate after the other."""
        losses, td_errors, weighted = [], [], "priority_weight" in batch
        for index, replicate in enumerate(self.replicates):
            transitions = batch[:, index]
            if weighted:  # contiguous, so that they are summed as one replicate's alone
                transitions["priority_weight"] = transitions["priority_weight"].contiguous()
            loss = replicate.loss(transitions)["loss"]
            replicate.optimizer.zero_grad()
            loss.backward()
            if replicate.clipping is not None:
                torch.nn.utils.clip_grad_norm_(replicate.loss.parameters(), replicate.clipping.max_norm)
            replicate.optimizer.step()
            replicate.target_updater.follow()
            losses.append(loss.detach())
            td_errors.append(transitions["td_error"][:, 0])
        return UpdateResult(torch.stack(losses), torch.stack(td_errors, dim=1) if weighted else None)

    def functional(self) -> list[FunctionalUpdate]:
        """The same loss, differentiated by torch.func, and the same Adam, clipping and soft update."""
        one = self.replicates[0]
        adam, clipping, loss = Adam.of(one.optimizer), one.clipping, one.loss
        follow = 1 - one.target_updater.eps if isinstance(one.target_updater, SoftTargetUpdate) else None

        def function(state: Tree, constants: Tree, inputs: Tree, batch: TensorDictBase) -> tuple[Tree, Tree]:
            read = {**constants, **inputs}

            def loss_of(parameters: Tree) -> tuple[Tensor, Tensor]:
                networks = {
                    "value_network_params": {**parameters, **read["buffers"]},
                    "target_value_network_params": {**state["target"], **read["target_buffers"]},
                }
                with standing_in(loss, networks):
                    value = loss(batch)["loss"]
                return value, batch["td_error"][:, 0].detach()

            gradients, (value, td_error) = grad_and_value(loss_of, has_aux=True)(state["network"])
            if clipping is not None:
                gradients = dict(zip(gradients, clipping.clipped(list(gradients.values())), strict=True))
            network, moments = adam.step(state["network"], gradients, state["adam"], read.get("learning_rate"))
            changes = {"network": network, "adam": moments}
            if follow is not None:
                changes["target"] = {key: own.lerp(network[key], follow) for key, own in state["target"].items()}
            return changes, {"loss": value, "td_error": td_error}

        constants = [{}] * len(self.replicates) if one.noise else [_buffers_of(each.loss) for each in self.replicates]
        return [FunctionalUpdate(function, [_state_of(each) for each in self.replicates], constants, self._inputs)]

    def machine_code(self, memory: Mapping[Any, Tensor], batch_size: int) -> ManyUpdates:
        """The same for networks of linear layers with ReLU between them, and losses of values that are points."""
        one = self.replicates[0]
        if weights_of(one.network) > MOST_WEIGHTS and has_compiler():
            raise CompilationError("a C++ compiler makes faster code for so large a network")
        check_plain(one.network, one.loss)
        adam = Adam.of(one.optimizer)
        updates = MachineUpdates(
            one.network,
            one.loss,
            [_state_of(each) for each in self.replicates],
            adam=adam,
            clipping=one.clipping,
            tau=1 - one.target_updater.eps if isinstance(one.target_updater, SoftTargetUpdate) else 0.0,
            memory=memory,
            batch_size=batch_size,
        )
        rate, decay = self._rates[0][0], one.learning_rate

        def make(first: int, items: Tensor, weights: Tensor | None) -> UpdateResult:
            shares = [decay.share(number) if decay else 1.0 for number in range(first, first + len(items))]
            return updates(items, weights, rate * np.array(shares))

        return make

    def _inputs(self) -> list[Tree]:
        """Learning rates that change, and the noise of weights."""
        inputs: list[Tree] = []
        for replicate in self.replicates:
            own: dict[str, Any] = _buffers_of(replicate.loss) if replicate.noise else {}
            if replicate.learning_rate is not None:
                own["learning_rate"] = torch.tensor(replicate.optimizer.param_groups[0]["lr"])
            inputs.append(own)
        return inputs

    # Figures

    def figures(self) -> Figures:
        """Epsilon in the next step."""
        return {"epsilon": self.exploration.epsilon}

    def measure(self, transitions: TensorDictBase) -> list[Figures]:
        """The mean TD error, and the mean value of the actions chosen, as they were when chosen."""
        chosen = transitions["action_value"].gather(-1, transitions["action"][..., None])[..., 0]
        return [
            {
                "td_error": _td_error(replicate, transitions[:, index]),
                "action_value": chosen[:, index].mean().item(),
                **self.figures(),
            }
            for index, replicate in enumerate(self.replicates)
        ]

    def measure_logged(self, transitions: TensorDictBase) -> list[Figures]:
        """How far replicates have come.

        `td_error` is the mean absolute TD error, `logged_value` the mean value of the actions that were taken and
        `greedy_value` of the best ones: far above `logged_value`, it is wishful thinking. `agreement` is the share of
        the transitions whose action is the best one.
        """
        count = len(self.replicates)
        values = self.greedy.action_values(transitions["observation"].repeat(count, 1))
        values = values.view(count, len(transitions), -1)
        logged = transitions["action"].expand(count, -1)
        greedy_value, greedy = values.max(dim=-1)
        logged_value = values.gather(-1, logged[..., None])[..., 0]
        means = torch.stack([logged_value, greedy_value, (greedy == logged).float()], dim=-1).mean(1).tolist()
        names = ("logged_value", "greedy_value", "agreement")
        return [
            {"td_error": _td_error(replicate, transitions), **dict(zip(names, own, strict=True))}
            for replicate, own in zip(self.replicates, means, strict=True)
        ]

    # State

    def state_dict(self) -> dict[str, Any]:
        """All that updates and env steps change."""
        return {
            "replicates": [
                {
                    "loss": replicate.loss.state_dict(),
                    "optimizer": replicate.optimizer.state_dict(),
                    "target_updater": replicate.target_updater.state_dict(),
                    **({"noise": replicate.noise.state_dict()} if replicate.noise else {}),
                }
                for replicate in self.replicates
            ],
            "exploration": self.exploration.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on from there; the optimizers' learning rates stay as they are.

        Raises:
            ValueError, RuntimeError: it is the state of something else.
        """
        for replicate, rates, own in zip(self.replicates, self._rates, state["replicates"], strict=True):
            replicate.loss.load_state_dict(own["loss"])
            replicate.optimizer.load_state_dict(own["optimizer"])
            for group, rate in zip(replicate.optimizer.param_groups, rates, strict=True):
                group["lr"] = rate
            replicate.target_updater.load_state_dict(own["target_updater"])
            if replicate.noise:
                replicate.noise.load_state_dict(own["noise"])
        self.exploration.load_state_dict(state["exploration"])


def _td_error(replicate: Replicate, transitions: TensorDictBase) -> float:
    """The mean absolute TD error on some transitions [F], as the loss defines it."""
    sample = thinned(transitions)
    with torch.no_grad():
        replicate.loss(sample)  # which notes the squared errors as priorities
    return sample["td_error"].sqrt().mean().item()


def _state_of(replicate: Replicate) -> Tree:
    """What updates change; a target network that is copied to between updates is among it."""
    trained, target = replicate.loss.value_network_params, replicate.loss.target_value_network_params
    network = {key: value for key, value in trained.items(True, True) if value.requires_grad}
    return {
        "network": network,
        "target": {key: target[key] for key in network},
        "adam": Adam.state_of(replicate.optimizer, network),
    }


def _buffers_of(loss: DQNLoss) -> dict[str, Any]:
    """What is no parameter in either network."""
    trained, target = loss.value_network_params, loss.target_value_network_params
    keys = [key for key, value in trained.items(True, True) if not value.requires_grad]
    return {"buffers": {key: trained[key] for key in keys}, "target_buffers": {key: target[key] for key in keys}}


def dqn_columns(action_names: Sequence[str]) -> tuple[Column, ...]:
    """What DQN has to say of a transition."""
    return (
        value_column(action_names),
        Column("epsilon", "epsilon", "float32", (), "probability with which an action was drawn at random"),
        Column("exploratory", "exploratory", "bool", (), "the action was drawn at random"),
    )


_PARTS = {
    "loss": "another loss, or algorithm=actor_critic",
    "network": "network=paper",
    "exploration": "exploration=paper",
}


@dataclass(frozen=True)
class DQNRecipe:
    """Makes `DQN` of a configuration's network, loss, target_updater, optimizer, exploration and their like."""

    def build(self, config: Mapping[str, Any], world: World, seeds: Sequence[int], device: torch.device) -> DQN:
        """The algorithm with a replicate for each seed.

        Raises:
            ConfigError: a part refuses its values.
        """
        replicates = [self._replicate(config, world, seed, device) for seed in seeds]
        exploration: EpsilonGreedy = build_node(
            "exploration",
            config["exploration"],
            action_spec=world.action.spec.to(device),
            generators=[part_generator(seed, "exploration") for seed in seeds],
        )
        return DQN(replicates, exploration.to(device), world.action.names)

    def _replicate(self, config: Mapping[str, Any], world: World, seed: int, device: torch.device) -> Replicate:
        network = self.make_network(config, world, part_generator(seed, "network")).to(device)
        loss = build_node("loss", config["loss"], network=network)
        target_updater = build_node("target_updater", config["target_updater"], loss=loss)
        clipping, learning_rate = (
            build_node(name, config[name]) if config.get(name) else None  # runs of earlier versions have none
            for name in ("gradient_clipping", "learning_rate")
        )
        return Replicate(
            seed=seed,
            network=network,
            loss=loss,
            optimizer=build_node("optimizer", config["optimizer"], params=list(loss.parameters())),
            target_updater=target_updater,
            clipping=clipping,
            learning_rate=learning_rate,
            noise=WeightNoise(network, loss, part_generator(seed, "noise")) if is_noisy(network) else None,
        )

    def make_network(
        self, config: Mapping[str, Any], world: World, generator: torch.Generator | None = None
    ) -> QNetwork:
        """The network for this world, with the weights that the generator draws.

        Raises:
            ConfigError: the actions of the world are not a choice among some, or a part is that of another algorithm.
        """
        check_parts(config, _PARTS, actor_critic=False)
        spec = world.action.spec
        if not isinstance(spec, Categorical):
            raise ConfigError(
                "DQN has a value for each action, and action is made of numbers; set an action of discrete choices, "
                "such as steer3, or loss=sac"
            )
        network: QNetwork = build_node(
            "network",
            config["network"],
            observation_size=world.observation_size,
            action_count=spec.n,
            generator=generator or torch.Generator(),
        )
        return network

    def greedy_policy(self, network: QNetwork) -> Policy:
        """The action of the highest value."""
        return GreedyActions(network)
