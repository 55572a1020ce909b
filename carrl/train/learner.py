"""Updates of the networks: sample, loss, gradient, Adam, and the target networks in their time.

Eagerly, an update is TorchRL's loss and torch's optimizer, called as they are, for one agent after the other. Compiled,
those same calls are traced into one native function for all agents together, since their overhead is nearly all of the
time of so small an update; the eager way is the oracle.

Shapes: `A` agents, `U` updates.
"""

import logging
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torchrl.data import TensorDictReplayBuffer
from torchrl.modules import QValueActor
from torchrl.objectives import DQNLoss

from carrl.algorithms.common.gradient_clipping import GradientClipping
from carrl.algorithms.common.learning_rate import LearningRateDecay
from carrl.algorithms.common.target_updater import TargetUpdater
from carrl.algorithms.common.weight_noise import WeightNoise
from carrl.data.sampler import Minibatch, PrioritizedAgentSampler
from carrl.train.divergence import Divergence
from carrl.train.native import CompilationError
from carrl.train.native_update import NativeUpdate

COMPILED, EAGER = "compiled", "eager"
"""The kinds of update. Their numbers differ by rounding: by 1e-7 after some hundred updates, and by more and more."""
_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Agent:
    """What learns: a network, its loss with the target network in it, and what moves them."""

    seed: int
    network: QValueActor
    loss: DQNLoss
    optimizer: torch.optim.Optimizer
    target_updater: TargetUpdater
    clipping: GradientClipping | None = None
    learning_rate: LearningRateDecay | None = None
    noise: WeightNoise | None = None


class Learner:
    """Trains agents side by side, each as it would be alone.

    Parameters and the optimizers' state stay where torch keeps them, whichever way an update is made, but become views
    of stacked tensors.

    Args:
        agents: alike in everything but their values.
        buffer: with the memories of all agents.
        compiled: make the updates natively. Where that cannot be done, they run eagerly, and one line says why.
        frames_per_update: env steps of each agent for one update of its network.
    """

    def __init__(
        self, agents: Sequence[Agent], buffer: TensorDictReplayBuffer, *, compiled: bool, frames_per_update: int = 1
    ) -> None:
        """Compiles nothing yet: the buffer's shape is unknown while it is empty."""
        self._agents, self._buffer = agents, buffer
        self._compiles = compiled
        self._frames_per_update = frames_per_update
        self._frames_waiting = 0
        self._native: NativeUpdate | None = None
        self._kind: str | None = None if compiled else EAGER  # not known before it was tried
        self._rates = [[group["lr"] for group in agent.optimizer.param_groups] for agent in agents]
        self.updates = 0
        self.first_update_at: float | None = None
        self._is_compiling = self._is_interrupted = False
        self.losses = torch.full([len(agents)], math.nan)
        self.divergences: dict[int, Divergence] = {}

    def state_dict(self) -> dict[str, Any]:
        """All that an update changes, but the buffer."""
        return {
            "updates": self.updates,
            "kind": self._kind,
            "frames_waiting": self._frames_waiting,
            "losses": self.losses,
            "sampler": self._buffer.sampler.state_dict(),
            "agents": [
                {
                    "loss": agent.loss.state_dict(),
                    "optimizer": agent.optimizer.state_dict(),
                    "target_updater": agent.target_updater.state_dict(),
                    **({"noise": agent.noise.state_dict()} if agent.noise else {}),
                }
                for agent in self._agents
            ],
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes on from there; the optimizers' learning rates stay as they are.

        Networks keep their memory, whose views others hold. Call it before the first update.
        """
        self.updates, self.losses = state["updates"], state["losses"].clone()
        self._kind = state["kind"]
        self._frames_waiting = state["frames_waiting"]
        self._buffer.sampler.load_state_dict(state["sampler"])
        for agent, rates, own in zip(self._agents, self._rates, state["agents"], strict=True):
            agent.loss.load_state_dict(own["loss"])
            agent.optimizer.load_state_dict(own["optimizer"])
            for group, rate in zip(agent.optimizer.param_groups, rates, strict=True):
                group["lr"] = rate
            agent.target_updater.load_state_dict(own["target_updater"])
            if agent.noise:
                agent.noise.load_state_dict(own["noise"])

    def learn(self, frames: int) -> None:
        """The updates for the next `frames` env steps, if there is a batch to sample; the targets follow.

        Afterwards `losses` [A] are those before the last update, `updates` counts them all, and `first_update_at` is
        the monotonic time of the first one in the way that all later ones are made, compiled or not. `divergences`
        has an entry for each agent whose loss has ever not been finite.
        """
        while frames > 0:
            count = min(frames, *(agent.target_updater.steps_left for agent in self._agents))
            if len(self._buffer) >= self._batch_size:
                updates, self._frames_waiting = divmod(self._frames_waiting + count, self._frames_per_update)
                if updates:
                    self._update(updates)
            for agent in self._agents:
                agent.target_updater.step(count)
            frames -= count

    def interrupt(self) -> None:
        """Ends a compilation that is going on, from a signal's handler; without one it does nothing.

        Raises:
            KeyboardInterrupt: there is one; `learn` raises it, too.
        """
        if self._is_compiling:
            self._is_interrupted = True
            raise KeyboardInterrupt

    @property
    def _batch_size(self) -> int:
        return self._buffer.batch_size

    def _update(self, count: int) -> None:
        """The first update of all is eager, for it makes the optimizers' state; the second one compiles."""
        losses, items = [], []
        storage, sampler = self._buffer.storage, self._buffer.sampler
        for number, minibatch in enumerate(sampler.minibatches(storage, count, self._batch_size), self.updates):
            self._prepare(number)
            if self._compiles and self._native is None and number > 0:
                self._try_to_compile()
            update = self._native or self._update_eagerly
            self.losses, td_errors = update(minibatch)
            if td_errors is not None:
                sampler.set_priorities(minibatch.items, td_errors.sqrt())
            losses.append(self.losses)
            items.append(minibatch.items)
            if self.first_update_at is None and (self._native is not None or not self._compiles):
                self.first_update_at = time.monotonic()
        self._note_divergences(torch.stack(losses), items)
        self.updates += count

    def _prepare(self, update: int) -> None:
        """Sets what an update is made with, by its number from 0: learning rates and the noise of weights."""
        for agent, rates in zip(self._agents, self._rates, strict=True):
            if agent.learning_rate is not None:
                for group, rate in zip(agent.optimizer.param_groups, rates, strict=True):
                    group["lr"] = rate * agent.learning_rate.share(update)
            if agent.noise is not None:
                agent.noise.draw()

    def _note_divergences(self, losses: Tensor, items: Sequence[Tensor]) -> None:
        """Looks for losses [U, A] that are not finite; the items sampled are [batch_size, A] for each update."""
        broken = ~losses.isfinite()
        if not broken.any():
            return
        for agent in broken.any(0).nonzero()[:, 0].tolist():
            first = int(broken[:, agent].int().argmax())
            minibatch = items[first][:, agent].tolist()
            divergence = Divergence(self.updates + first + 1, losses[first, agent].item(), minibatch)
            self.divergences.setdefault(agent, divergence)

    def _update_eagerly(self, minibatch: Minibatch) -> tuple[Tensor, Tensor | None]:
        """The losses before the update, [A], and if there are weights, the squared TD errors, [batch_size, A]."""
        batch = self._buffer.storage.get((minibatch.items, minibatch.agents))
        losses, td_errors = [], []
        for index, agent in enumerate(self._agents):
            transitions = batch[:, index]
            if minibatch.weights is not None:
                transitions["priority_weight"] = minibatch.weights[:, index].contiguous()  # sums like one agent's alone
            loss = agent.loss(transitions)["loss"]
            agent.optimizer.zero_grad()
            loss.backward()
            if agent.clipping is not None:
                torch.nn.utils.clip_grad_norm_(agent.loss.parameters(), agent.clipping.max_norm)
            agent.optimizer.step()
            agent.target_updater.follow()
            losses.append(loss.detach())
            td_errors.append(transitions["td_error"][:, 0])
        return torch.stack(losses), None if minibatch.weights is None else torch.stack(td_errors, dim=1)

    def _try_to_compile(self) -> None:
        self._is_compiling = True
        try:
            self._native = NativeUpdate(
                self._agents, self._buffer, isinstance(self._buffer.sampler, PrioritizedAgentSampler)
            )
        except CompilationError as error:
            if not self._is_interrupted:
                _logger.warning("Updates run eagerly, many times slower, because they cannot be compiled: %s", error)
            self._compiles = False
        finally:
            self._is_compiling = False
        if self._is_interrupted:  # torchrl 0.14 makes an error of its own of a KeyboardInterrupt that is raised in it
            raise KeyboardInterrupt
        self._note_kind(EAGER if self._native is None else COMPILED)

    def _note_kind(self, kind: str) -> None:
        """Says where updates go on in another way than before, whose numbers differ in their last digits."""
        if self._kind not in (None, kind):
            _logger.warning(
                "The updates so far were %s, those from here on are %s: the run will not be, bit for bit, the one "
                "never stopped.",
                self._kind,
                kind,
            )
        self._kind = kind
