"""DDPG, TD3 and SAC, as one algorithm: which of them it is, the loss says.

Shapes: `A` replicates, `N` transitions of a minibatch, `F` of any number; `C` controls.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Bounded

from carrl.algorithms.actor_critic.exploration import ActionNoise
from carrl.algorithms.actor_critic.loss import ActorCriticLoss, values
from carrl.algorithms.actor_critic.network import Actor, ActorCritic
from carrl.algorithms.actor_critic.policy import ActorPolicy, GreedyActors
from carrl.algorithms.actor_critic.update import Replicate
from carrl.algorithms.algorithm import Algorithm, Figures, FunctionalUpdate, Policy, Tree, UpdateResult
from carrl.algorithms.common.measuring import thinned
from carrl.algorithms.common.parts import check_parts
from carrl.config import build_node
from carrl.errors import ConfigError
from carrl.log.schema import Column
from carrl.task.random_streams import part_generator
from carrl.task.task import World


class ActorCriticAlgorithm(Algorithm):
    """An actor for each replicate, which learns what its critics value.

    Args:
        replicates: alike in everything but their values.
        exploration: of all their cars.
        control_names: what the numbers of an action are called.
    """

    def __init__(self, replicates: Sequence[Replicate], exploration: ActionNoise, control_names: Sequence[str]) -> None:
        self.rule, self.replicates, self.exploration = replicates[0].rule, list(replicates), exploration
        self.seeds = [replicate.seed for replicate in replicates]
        self.networks = [replicate.actor for replicate in replicates]
        actors = GreedyActors([replicate.actor for replicate in replicates])
        self.collect_policy, self.greedy_policy = ActorPolicy(actors, exploration), actors.actions
        names = tuple(control_names)
        self.log_columns = (
            Column("greedy_action", "greedy_action", "float32", (len(names),), "the action without exploration", names),
        )
        self._controls = len(names)
        self._rates = [
            {part: optimizer.param_groups[0]["lr"] for part, optimizer in replicate.optimizers.items()}
            for replicate in self.replicates
        ]
        self._noise: list[Tensor] = []
        self._with_actor = True

    # Updates

    @property
    def steps_left(self) -> int:
        """Env steps from now to the next copy into the targets."""
        return min(replicate.target_updater.steps_left for replicate in self.replicates)

    def count_steps(self, steps: int) -> None:
        """Moves the exploration along, and copies into the targets if it is time."""
        for replicate in self.replicates:
            replicate.target_updater.step(steps)
        self.exploration.step(steps)

    def kind_of(self, update: int) -> int:
        """0 where the actor moves, too, and 1 where the critics do alone."""
        return int(update % self.rule.update_kinds != 0)

    def prepare(self, update: int, batch_size: int) -> None:
        """Sets learning rates and draws the noise of the update, [draws, N, C] for each replicate."""
        self._with_actor = self.kind_of(update) == 0
        for replicate, rates in zip(self.replicates, self._rates, strict=True):
            if replicate.learning_rate is not None:
                for part, optimizer in replicate.optimizers.items():
                    optimizer.param_groups[0]["lr"] = rates[part] * replicate.learning_rate.share(update)
        if self.rule.draws:
            shape = self.rule.draws, batch_size, self._controls
            self._noise = [torch.randn(shape, generator=replicate.generator) for replicate in self.replicates]

    def update(self, batch: TensorDictBase) -> UpdateResult:
        """Updates one replicate after the other."""
        losses, td_errors = [], []
        for index, replicate in enumerate(self.replicates):
            transitions = batch[:, index].contiguous()  # so that they are summed as one replicate's alone
            loss, td_error = replicate.update(transitions, self._noise_of(index), self._with_actor)
            losses.append(loss)
            td_errors.append(td_error)
        return UpdateResult(torch.stack(losses), torch.stack(td_errors, dim=1))

    def _noise_of(self, index: int) -> list[Tensor]:
        return [each.to(self.collect_policy.device) for each in self._noise[index]] if self._noise else []

    def functional(self) -> list[FunctionalUpdate]:
        """The same losses, differentiated by torch.func: with the actor and, where it moves less often, without."""
        state, constants = ([part(each) for each in self.replicates] for part in (Replicate.state, Replicate.constants))
        kinds = [True, False] if self.rule.update_kinds > 1 else [True]
        functions = [self.replicates[0].function(with_actor) for with_actor in kinds]
        return [FunctionalUpdate(function, state, constants, self._inputs) for function in functions]

    def _inputs(self) -> list[Tree]:
        """Learning rates that change, and the noise of the update."""
        inputs: list[Tree] = []
        for index, replicate in enumerate(self.replicates):
            own: dict[str, Any] = {"noise": self._noise_of(index)} if self._noise else {}
            if replicate.learning_rate is not None:
                rates = {part: each.param_groups[0]["lr"] for part, each in replicate.optimizers.items()}
                own["learning_rate"] = {part: torch.tensor(rate) for part, rate in rates.items()}
            inputs.append(own)
        return inputs

    # Figures

    def figures(self) -> Figures:
        """How much noise there is in the next step, if any."""
        return self.exploration.figures()

    def measure(self, transitions: TensorDictBase) -> list[Figures]:
        """The mean TD error, the value of what was done, and what else the loss has to say of them."""
        return [self._measure(index, transitions[:, index]) for index in range(len(self.replicates))]

    def measure_logged(self, transitions: TensorDictBase) -> list[Figures]:
        """How far replicates have come.

        `td_error` is the mean absolute TD error, `logged_value` the mean value of the actions that were taken and
        `greedy_value` of what the actors would do: far above `logged_value`, it is wishful thinking. `action_distance`
        is the mean difference between the two in a control.
        """
        everyone = transitions["observation"].repeat(len(self.replicates), 1)
        found: list[Figures] = []
        for index, greedy in enumerate(self.greedy_policy(everyone).chunk(len(self.replicates))):
            measured = self._measure(index, transitions)
            found.append(
                {
                    "td_error": measured["td_error"],
                    "logged_value": measured["action_value"],
                    "greedy_value": self._values(index, transitions["observation"], greedy).mean().item(),
                    "action_distance": (greedy - transitions["action"]).abs().mean().item(),
                }
            )
        return found

    def _measure(self, index: int, transitions: TensorDictBase) -> dict[str, float]:
        """Figures of a sample of transitions [F], with the same noise each time, so that no generator moves on."""
        sample, replicate = thinned(transitions), self.replicates[index]
        shape = self.rule.draws, *sample["action"].shape
        noise = torch.randn(shape, generator=torch.Generator().manual_seed(0)).to(sample["action"].device)
        with torch.no_grad():
            found = replicate.losses(sample, list(noise), with_actor=True)
        return {
            "td_error": found.td_error.sqrt().mean().item(),
            "action_value": self._values(index, sample["observation"], sample["action"]).mean().item(),
            **{name: value.item() for name, value in found.figures.items()},
            **self.figures(),
        }

    def _values(self, index: int, observation: Tensor, action: Tensor) -> Tensor:
        return values(self.replicates[index].loss, self.rule.critic_name, observation, action)

    # State

    def state_dict(self) -> dict[str, Any]:
        """All that updates and env steps change."""
        return {
            "replicates": [
                {
                    "loss": replicate.loss.state_dict(),
                    "optimizers": {part: each.state_dict() for part, each in replicate.optimizers.items()},
                    "target_updater": replicate.target_updater.state_dict(),
                    "generator": replicate.generator.get_state(),
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
            for part, optimizer in replicate.optimizers.items():
                optimizer.load_state_dict(own["optimizers"][part])
                optimizer.param_groups[0]["lr"] = rates[part]
            replicate.target_updater.load_state_dict(own["target_updater"])
            replicate.generator.set_state(own["generator"])
        self.exploration.load_state_dict(state["exploration"])


_PARTS = {
    "loss": "loss=ddpg, td3 or sac",
    "network": "network=actor_critic",
    "exploration": "exploration=none, gaussian or ornstein_uhlenbeck",
}


@dataclass(frozen=True)
class ActorCriticRecipe:
    """Makes it of a configuration's network, loss, target_updater, optimizer, exploration and their like."""

    def build(
        self, config: Mapping[str, Any], world: World, seeds: Sequence[int], device: torch.device
    ) -> ActorCriticAlgorithm:
        """The algorithm with a replicate for each seed.

        Raises:
            ConfigError: a part refuses its values, or is that of another algorithm.
        """
        rule = self._rule(config, world)
        replicates = [self._replicate(rule, config, world, seed, device) for seed in seeds]
        exploration: ActionNoise = build_node(
            "exploration",
            config["exploration"],
            action_spec=world.action.spec.to(device),
            generators=[part_generator(seed, "exploration") for seed in seeds],
        )
        return ActorCriticAlgorithm(replicates, exploration.to(device), world.action.control_names)

    def _rule(self, config: Mapping[str, Any], world: World) -> ActorCriticLoss:
        check_parts(config, _PARTS, actor_critic=True)
        if not isinstance(world.action.spec, Bounded):
            raise ConfigError("an actor steers by numbers, and action is a choice among some; set action=continuous")
        rule: ActorCriticLoss = build_node("loss", config["loss"])
        return rule

    def _replicate(
        self, rule: ActorCriticLoss, config: Mapping[str, Any], world: World, seed: int, device: torch.device
    ) -> Replicate:
        networks = self._networks(rule, config, world, part_generator(seed, "network"))
        for network in (networks.actor, *networks.critics):
            network.to(device)
        loss = rule.make(networks, world.action.spec.shape[-1])
        clipping, learning_rate = (
            build_node(name, config[name]) if config.get(name) else None
            for name in ("gradient_clipping", "learning_rate")
        )
        target_updater = build_node("target_updater", config["target_updater"], loss=loss)
        optimizers = {
            part: build_node("optimizer", config["optimizer"], params=rule.parameters(loss, part))
            for part in rule.rates
        }
        for part, optimizer in optimizers.items():
            for group in optimizer.param_groups:
                group["lr"] *= rule.rates[part]
        return Replicate(
            seed=seed,
            rule=rule,
            actor=networks.actor,
            loss=loss,
            optimizers=optimizers,
            target_updater=target_updater,
            generator=part_generator(seed, "noise"),
            clipping=clipping,
            learning_rate=learning_rate,
        )

    def _networks(
        self, rule: ActorCriticLoss, config: Mapping[str, Any], world: World, generator: torch.Generator
    ) -> ActorCritic:
        networks: ActorCritic = build_node(
            "network",
            config["network"],
            observation_size=world.observation_size,
            controls=world.action.spec.shape[-1],
            is_stochastic=rule.is_stochastic,
            critics=rule.critics,
            generator=generator,
        )
        return networks

    def make_network(self, config: Mapping[str, Any], world: World) -> Actor:
        """The actor for this world, which is what checkpoints keep.

        Raises:
            ConfigError: the actions of the world are a choice among some.
        """
        return self._networks(self._rule(config, world), config, world, torch.Generator()).actor

    def greedy_policy(self, network: Actor) -> Policy:
        """The action in the middle."""
        return GreedyActors([network]).actions
