"""One update of the network: sample, loss, gradient, Adam.

Eagerly, it is TorchRL's loss and torch's optimizer, called as they are. Compiled, those same calls are traced into one
native function, since their overhead is most of the time of so small an update; the eager way is the oracle.
"""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor
from torch.func import grad_and_value
from torchrl.data import TensorDictReplayBuffer
from torchrl.objectives import DQNLoss

from carrl.data.replay_buffer import KEYS
from carrl.run.native import CompilationError, compile_native

_logger = logging.getLogger(__name__)
_MOMENTS = ("step", "exp_avg", "exp_avg_sq")


class Learner:
    """Takes gradient steps on sampled batches, training the loss's parameters in place.

    Parameters and the optimizer's state stay where torch keeps them, whichever way an update is made.

    Args:
        loss: with parameters that the optimizer trains.
        optimizer: Adam, for compiled updates.
        buffer: sampled once for each update.
        compiled: make the updates natively. Where that cannot be done, they run eagerly, and one line says why.
    """

    def __init__(
        self, loss: DQNLoss, optimizer: torch.optim.Optimizer, buffer: TensorDictReplayBuffer, *, compiled: bool
    ) -> None:
        """Compiles nothing yet: the buffer's shape is unknown while it is empty."""
        self._loss, self._optimizer, self._buffer = loss, optimizer, buffer
        self._compiles = compiled
        self._native: Callable[[Tensor], Tensor] | None = None

    def update(self) -> Tensor:
        """Takes one step and returns the loss before it, a scalar.

        The first one is always eager, for it makes the optimizer's state; the second one compiles.
        """
        if self._compiles and self._native is None and self._optimizer.state:
            self._try_to_compile()
        if self._native is None:
            return self._update_eagerly()
        index, _ = self._buffer.sampler.sample(self._buffer.storage, self._buffer.batch_size)
        return self._native(index)

    def _update_eagerly(self) -> Tensor:
        loss = self._loss(self._buffer.sample())["loss"]
        self._optimizer.zero_grad()
        loss.backward()
        self._optimizer.step()
        return loss.detach()

    def _try_to_compile(self) -> None:
        try:
            self._native = _compile_update(self._loss, self._optimizer, self._buffer)
        except CompilationError as error:
            _logger.warning("Updates run eagerly, several times slower, because they cannot be compiled: %s", error)
            self._compiles = False


def _compile_update(
    loss: DQNLoss, optimizer: torch.optim.Optimizer, buffer: TensorDictReplayBuffer
) -> Callable[[Tensor], Tensor]:
    """The update as a native function of the sampled indices [batch_size], acting on the tensors that are there now."""
    options = _adam_options(optimizer)
    keys = list(loss.value_network_params.keys(True, True))
    parameters = [loss.value_network_params[key] for key in keys]
    moments = [[optimizer.state[parameter][name] for parameter in parameters] for name in _MOMENTS]
    targets = [loss.target_value_network_params[key] for key in keys]
    memory = buffer.storage._storage  # all of it, filled or not: its tensors stay where they are
    groups = [parameters, *moments, targets, [memory[key] for key in KEYS]]
    state = [tensor.detach() for group in groups for tensor in group]
    if any(tensor.device.type != "cpu" for tensor in state):
        raise CompilationError("only updates on the CPU are")

    def update(*tensors: Tensor) -> Tensor:
        values, steps, averages, squares, target_values, (*stored, index) = _split(tensors, len(keys))
        batch = TensorDict({}, batch_size=index.shape)
        for key, field in zip(KEYS, stored, strict=True):
            batch[key] = field[index]

        def loss_of(values: list[Tensor]) -> Tensor:
            with _parameters_of(loss, keys, values, target_values):
                return loss(batch)["loss"]

        gradients, value = grad_and_value(loss_of)(values)
        for tensors_of_one in zip(values, gradients, steps, averages, squares, strict=True):
            _adam_step(options, *tensors_of_one)
        return value

    index = torch.zeros(buffer.batch_size, dtype=torch.int64)
    native = compile_native(update, [*(tensor.clone() for tensor in state[: -len(KEYS)]), *state[-len(KEYS) :], index])
    return lambda index: native(*state, index)


def _split(tensors: tuple[Tensor, ...], count: int) -> list[list[Tensor]]:
    """Five groups of `count` tensors each, and one of the rest."""
    groups = [list(tensors[start : start + count]) for start in range(0, 5 * count, count)]
    return [*groups, list(tensors[5 * count :])]


@contextmanager
def _parameters_of(loss: DQNLoss, keys: list[Any], values: list[Tensor], target_values: list[Tensor]) -> Iterator[None]:
    """Lets the loss compute with these tensors; `torch.func.functional_call` on a LossModule raises in torchrl 0.14."""
    stand_ins = {"value_network_params": values, "target_value_network_params": target_values}
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


def _adam_options(optimizer: torch.optim.Optimizer) -> _AdamOptions:
    """What an update needs of plain Adam with one group of parameters.

    Raises:
        CompilationError: it is another optimizer, or uses more of Adam.
    """
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
    """Moves one parameter and its state in place.

    Source: Kingma and Ba 2015, "Adam: A Method for Stochastic Optimization", Algorithm 1.
    """
    lr, beta_1, beta_2, eps = options
    step.add_(1)
    average.lerp_(gradient, 1 - beta_1)
    square.mul_(beta_2).addcmul_(gradient, gradient, value=1 - beta_2)
    unbiased = average / (1 - beta_1 ** step.double()).to(average.dtype)
    scale = (square / (1 - beta_2 ** step.double()).to(square.dtype)).sqrt() + eps
    value.sub_(lr * unbiased / scale)
