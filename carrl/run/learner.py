"""Updates of the networks: sample, loss, gradient, Adam, and the target networks in their time.

Eagerly, an update is TorchRL's loss and torch's optimizer, called as they are, for one agent after the other. Compiled,
those same calls are traced into one native function for all agents together, since their overhead is nearly all of the
time of so small an update; the eager way is the oracle.

Shapes: `A` agents, `U` updates.
"""

import logging
import math
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor
from torch.func import grad_and_value
from torchrl.data import TensorDictReplayBuffer
from torchrl.modules import QValueActor
from torchrl.objectives import DQNLoss

from carrl.agent.stack import stack_in_place
from carrl.agent.target_updater import PeriodicHardUpdate
from carrl.data.replay_buffer import KEYS
from carrl.run.native import CompilationError, NativeFunction, compile_native

_logger = logging.getLogger(__name__)
_MOMENTS = ("step", "exp_avg", "exp_avg_sq")


@dataclass(frozen=True)
class Agent:
    """What learns: a network, its loss with the target network in it, and what moves them."""

    seed: int
    network: QValueActor
    loss: DQNLoss
    optimizer: torch.optim.Optimizer
    target_updater: PeriodicHardUpdate


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
        self._native: _NativeUpdate | None = None
        self.updates = 0
        self.first_update_at: float | None = None
        self.losses = torch.full([len(agents)], math.nan)

    def learn(self, frames: int) -> None:
        """The updates for the next `frames` env steps, if there is a batch to sample; the targets follow.

        Afterwards `losses` [A] are those before the last update, `updates` counts them all, and `first_update_at` is
        the monotonic time of the first one in the way that all later ones are made, compiled or not.
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

    @property
    def _batch_size(self) -> int:
        return self._buffer.batch_size

    def _update(self, count: int) -> None:
        """The first update of all is eager, for it makes the optimizers' state; the second one compiles."""
        samples, _ = self._buffer.sampler.sample(self._buffer.storage, count * self._batch_size)
        batches = list(zip(*(index.split(self._batch_size) for index in samples), strict=True))
        if self._compiles and self._native is None:
            self._update_eagerly(batches.pop(0))
            self._try_to_compile()
        for items, agents in batches:
            if self._native is None:
                self._update_eagerly((items, agents))
            else:
                self.losses = self._native(items)
            if self.first_update_at is None:
                self.first_update_at = time.monotonic()
        self.updates += count

    def _update_eagerly(self, sample: tuple[Tensor, Tensor]) -> None:
        batch = self._buffer.storage.get(sample)
        losses = []
        for index, agent in enumerate(self._agents):
            loss = agent.loss(batch[:, index])["loss"]
            agent.optimizer.zero_grad()
            loss.backward()
            agent.optimizer.step()
            losses.append(loss.detach())
        self.losses = torch.stack(losses)

    def _try_to_compile(self) -> None:
        try:
            self._native = _NativeUpdate(self._agents, self._buffer)
        except CompilationError as error:
            _logger.warning("Updates run eagerly, many times slower, because they cannot be compiled: %s", error)
            self._compiles = False


class _NativeUpdate:
    """An update of all agents as one native function, on the tensors that are there when it is made."""

    def __init__(self, agents: Sequence[Agent], buffer: TensorDictReplayBuffer) -> None:
        self._options = _adam_options([agent.optimizer for agent in agents])
        self._loss = agents[0].loss
        self._keys = list(self._loss.value_network_params.keys(True, True))
        parameters = [[agent.loss.value_network_params[key] for agent in agents] for key in self._keys]
        targets = [[agent.loss.target_value_network_params[key] for agent in agents] for key in self._keys]
        moments = [
            [
                [agent.optimizer.state[parameter][name] for agent, parameter in zip(agents, of_agents, strict=True)]
                for of_agents in parameters
            ]
            for name in _MOMENTS
        ]
        learnt = [stack_in_place(of_agents) for group in (parameters, *moments, targets) for of_agents in group]
        memory = buffer.storage._storage  # all of it, filled or not: its tensors stay where they are
        if any(tensor.device.type != "cpu" for tensor in learnt):
            raise CompilationError("only updates on the CPU are")
        self._inputs = [*learnt, *(memory[key] for key in KEYS)]
        items = torch.zeros(buffer.batch_size, len(agents), dtype=torch.int64)
        scratch = [tensor.clone() for tensor in learnt]
        self._call: NativeFunction = compile_native(self._update, [*scratch, *self._inputs[len(learnt) :], items])

    def __call__(self, items: Tensor) -> Tensor:
        """Updates from these items of the memory, [batch_size, A]; the losses before it, [A]."""
        (losses,) = self._call([*self._inputs, items])
        return losses

    def _update(self, *tensors: Tensor) -> Tensor:
        values, steps, averages, squares, targets, (*memory, items) = _split(tensors, len(self._keys))
        agents = torch.arange(items.shape[1])
        batch = [field[items, agents] for field in memory]
        gradients, losses = torch.vmap(grad_and_value(self._loss_of), in_dims=(0, 0, 1))(values, targets, batch)
        for value, *rest in zip(values, gradients, steps, averages, squares, strict=True):
            _adam_step(self._options, value, *rest)
        return losses

    def _loss_of(self, values: list[Tensor], targets: list[Tensor], batch: list[Tensor]) -> Tensor:
        """One agent's loss, as TorchRL defines it."""
        transitions = TensorDict({}, batch_size=batch[0].shape[:1])
        for key, field in zip(KEYS, batch, strict=True):
            transitions[key] = field
        with _parameters_of(self._loss, self._keys, values, targets):
            return self._loss(transitions)["loss"]


def _split(tensors: tuple[Tensor, ...], count: int) -> list[list[Tensor]]:
    """Five groups of `count` tensors each, and one of the rest."""
    groups = [list(tensors[start : start + count]) for start in range(0, 5 * count, count)]
    return [*groups, list(tensors[5 * count :])]


@contextmanager
def _parameters_of(loss: DQNLoss, keys: list[Any], values: list[Tensor], targets: list[Tensor]) -> Iterator[None]:
    """Lets the loss compute with these tensors; `torch.func.functional_call` on a LossModule raises in torchrl 0.14."""
    stand_ins = {"value_network_params": values, "target_value_network_params": targets}
    own = {name: loss._modules[name] for name in stand_ins}
    try:
        for name, tensors in stand_ins.items():
            loss._modules[name] = TensorDict(dict(zip(keys, tensors, strict=True)), [])
        yield
    finally:
        loss._modules.update(own)


class _AdamOptions(NamedTuple):
    lr: float
    beta_1: float
    beta_2: float
    eps: float


def _adam_options(optimizers: Sequence[torch.optim.Optimizer]) -> _AdamOptions:
    """What an update needs of plain Adam with one group of parameters, the same for all agents.

    Raises:
        CompilationError: it is another optimizer, or uses more of Adam.
    """
    optimizer = optimizers[0]
    if type(optimizer) is not torch.optim.Adam or len(optimizer.param_groups) != 1:
        raise CompilationError(f"the optimizer is {type(optimizer).__name__}, not Adam with one group")
    (group,) = optimizer.param_groups
    extras = [name for name in ("weight_decay", "amsgrad", "maximize", "decoupled_weight_decay") if group[name]]
    if extras:
        raise CompilationError(f"the optimizer uses {', '.join(extras)}")
    beta_1, beta_2 = group["betas"]
    return _AdamOptions(group["lr"], beta_1, beta_2, group["eps"])


def _adam_step(
    options: _AdamOptions, value: Tensor, gradient: Tensor, step: Tensor, average: Tensor, square: Tensor
) -> None:
    """Moves one parameter [A, ...] and its state in place; `step` is [A].

    Source: Kingma and Ba 2015, "Adam: A Method for Stochastic Optimization", Algorithm 1.
    """
    lr, beta_1, beta_2, eps = options
    step.add_(1)
    taken = step.double().view(-1, *[1] * (value.ndim - 1))
    average.lerp_(gradient, 1 - beta_1)
    square.mul_(beta_2).addcmul_(gradient, gradient, value=1 - beta_2)
    unbiased = average / (1 - beta_1**taken).to(average.dtype)
    scale = (square / (1 - beta_2**taken).to(square.dtype)).sqrt() + eps
    value.sub_(lr * unbiased / scale)
