"""An update of one replicate's actor, critics and targets: eagerly, and as a function to be compiled.

Shapes: `N` transitions of a minibatch, `C` controls.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.func import grad_and_value
from torchrl.objectives import LossModule

from carrl.algorithms.actor_critic.loss import ALPHA, CRITIC, ActorCriticLoss, Losses
from carrl.algorithms.actor_critic.network import Actor
from carrl.algorithms.algorithm import Tree
from carrl.algorithms.common.noise import GivenNoise
from carrl.algorithms.common.optimizer import Adam, GradientClipping, LearningRateDecay, SoftTargetUpdate, TargetUpdater
from carrl.algorithms.common.stand_ins import forget_cached, standing_in

Function = Callable[[Tree, Tree, Tree, TensorDictBase], tuple[Tree, Tree]]


@dataclass(frozen=True)
class Replicate:
    """One seed's networks, their loss with the targets in it, and what moves them.

    Attributes:
        seed: of the replicate.
        rule: by which it learns.
        actor: which drives; the loss has the same one.
        loss: with actor, critics and their targets.
        optimizers: of each part that is trained.
        target_updater: of all targets.
        generator: of the noise in updates, on the CPU.
        clipping: of each part's gradient; None for none.
        learning_rate: how the learning rates fall; None for not at all.
    """

    seed: int
    rule: ActorCriticLoss
    actor: Actor
    loss: LossModule
    optimizers: Mapping[str, torch.optim.Optimizer]
    target_updater: TargetUpdater
    generator: torch.Generator
    clipping: GradientClipping | None = None
    learning_rate: LearningRateDecay | None = None

    @property
    def networks(self) -> tuple[str, str]:
        """What the loss calls the parameters of critics and actor."""
        return f"{self.rule.critic_name}_params", "actor_network_params"

    @property
    def targets(self) -> Mapping[str, str]:
        """What it calls those of the targets, with the names of those that they follow."""
        followed = self.networks if self.rule.has_target_actor else self.networks[:1]
        return {f"target_{name}": name for name in followed}

    def group_of(self, part: str) -> str:
        """The group of the state that has the parameters of a part."""
        return part if part == ALPHA else self.networks[part != CRITIC]

    def losses(self, transitions: TensorDictBase, noise: Sequence[Tensor], with_actor: bool) -> Losses:
        """What the loss finds in transitions [N], with this noise, [N, C] for each draw."""
        forget_cached(self.loss)  # its parameters may have moved to other memory
        with GivenNoise(noise):
            return self.rule.losses(self.loss, transitions, with_actor)

    def update(self, transitions: TensorDictBase, noise: Sequence[Tensor], with_actor: bool) -> tuple[Tensor, Tensor]:
        """Calls TorchRL's loss and torch's optimizers as they are; the critics' loss [] and squared TD errors [N]."""
        found = self.losses(transitions, noise, with_actor)
        moving = [self.optimizers[part] for part in found.of_parts]
        for optimizer in moving:
            optimizer.zero_grad()
        torch.stack(list(found.of_parts.values())).sum().backward()
        for optimizer in moving:
            if self.clipping is not None:
                torch.nn.utils.clip_grad_norm_(optimizer.param_groups[0]["params"], self.clipping.max_norm)
            optimizer.step()
        if with_actor:
            self.target_updater.follow()
        return found.of_parts[CRITIC].detach(), found.td_error

    def state(self) -> Tree:
        """What updates change; targets that are copied to between updates are among it."""
        groups: dict[str, Any] = {name: self._trained(name, name) for name in self.networks}
        groups |= {target: self._trained(target, name) for target, name in self.targets.items()}
        if ALPHA in self.optimizers:
            groups[ALPHA] = {"log_alpha": self.loss.log_alpha}
        for part, optimizer in self.optimizers.items():
            groups[f"adam_{part}"] = Adam.state_of(optimizer, groups[self.group_of(part)])
        return groups

    def constants(self) -> Tree:
        """What is no parameter in any network."""
        following = {**{name: name for name in self.networks}, **self.targets}
        return {
            name: {
                key: each
                for key, each in self.loss._modules[name].items(True, True)
                if key not in self._trained(name, source)
            }
            for name, source in following.items()
        }

    def _trained(self, name: str, source: str) -> dict[Any, Tensor]:
        """The tensors of a group that the source group, which it follows or is, has as parameters."""
        own = self.loss._modules[name]
        return {key: own[key] for key, value in self.loss._modules[source].items(True, True) if value.requires_grad}

    def function(self, with_actor: bool) -> Function:
        """The same update of any replicate like this one, as `FunctionalUpdate` has it."""
        adams = {part: Adam.of(optimizer) for part, optimizer in self.optimizers.items()}
        groups = {part: self.group_of(part) for part in adams if with_actor or part == CRITIC}

        def function(state: Tree, constants: Tree, inputs: Tree, batch: TensorDictBase) -> tuple[Tree, Tree]:
            def loss_of(trained: Tree) -> tuple[Tensor, tuple[Tensor, Tensor]]:
                read = {**state, **trained}
                networks = {name: {**read[name], **own} for name, own in constants.items()}
                with standing_in(self.loss, networks, read.get(ALPHA)), GivenNoise(list(inputs.get("noise", []))):
                    found = self.rule.losses(self.loss, batch, with_actor)
                total = torch.stack(list(found.of_parts.values())).sum()
                return total, (found.of_parts[CRITIC].detach(), found.td_error)

            trained = {group: state[group] for group in groups.values()}
            gradients, (_, (value, td_error)) = grad_and_value(loss_of, has_aux=True)(trained)
            changes: dict[str, Any] = {}
            for part, group in groups.items():
                rate = inputs["learning_rate"][part] if "learning_rate" in inputs else None
                gradient, moments = self._clipped(gradients[group]), f"adam_{part}"
                changes[group], changes[moments] = adams[part].step(state[group], gradient, state[moments], rate)
            return {**changes, **self._followed(state, changes, with_actor)}, {"loss": value, "td_error": td_error}

        return function

    def _clipped(self, gradient: Tree) -> Tree:
        if self.clipping is None:
            return gradient
        return dict(zip(gradient, self.clipping.clipped(list(gradient.values())), strict=True))

    def _followed(self, state: Tree, changes: Tree, with_actor: bool) -> Tree:
        """The targets after a soft update."""
        if not with_actor or not isinstance(self.target_updater, SoftTargetUpdate):
            return {}
        share = 1 - self.target_updater.eps
        return {
            target: {key: own.lerp(changes[name][key], share) for key, own in state[target].items()}
            for target, name in self.targets.items()
        }
