"""An update of all agents as one native function.

Shapes: `A` agents.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor
from torch.func import grad_and_value
from torchrl.data import TensorDictReplayBuffer
from torchrl.objectives import DQNLoss

from carrl.algorithms.common.stack import stack_in_place
from carrl.algorithms.common.target_updater import SoftTargetUpdate
from carrl.data.replay_buffer import keys_of
from carrl.data.sampler import Minibatch
from carrl.train.native import CompilationError, NativeFunction, compile_native

if TYPE_CHECKING:
    from carrl.train.learner import Agent

_MOMENTS = ("step", "exp_avg", "exp_avg_sq")


class NativeUpdate:
    """An update of all agents as one native function, on the tensors that are there when it is made.

    It follows the agents' losses, clipping, Adam and soft target updates; what changes from one update to the next, a
    learning rate that falls and the noise of weights, is among its inputs.

    Args:
        agents: whose optimizers have made a step.
        buffer: that holds a transition.
        weighted: whether minibatches have weights, and TD errors are wanted.

    Raises:
        CompilationError: it cannot be compiled, or not here.
    """

    def __init__(self, agents: Sequence["Agent"], buffer: TensorDictReplayBuffer, weighted: bool) -> None:
        (self._agent, *_), self._weighted = agents, weighted
        self._options = _adam_options([agent.optimizer for agent in agents])
        trained = [agent.loss.value_network_params for agent in agents]
        targets = [agent.loss.target_value_network_params for agent in agents]
        self._keys = [key for key, value in trained[0].items(True, True) if value.requires_grad]
        self._fixed_keys = [key for key in trained[0].keys(True, True) if key not in self._keys]
        parameters = [[of_agent[key] for of_agent in trained] for key in self._keys]
        moments = [
            [
                [agent.optimizer.state[parameter][name] for agent, parameter in zip(agents, of_agents, strict=True)]
                for of_agents in parameters
            ]
            for name in _MOMENTS
        ]
        followers = [[of_agent[key] for of_agent in targets] for key in self._keys]
        learnt = [stack_in_place(of_agents) for group in (parameters, *moments, followers) for of_agents in group]
        self._fixed = [
            [of_agent[key] for of_agent in group] for group in (trained, targets) for key in self._fixed_keys
        ]
        self._rate = torch.tensor(self._options.lr)
        memory = buffer.storage._storage  # all of it, filled or not: its tensors stay where they are
        if any(tensor.device.type != "cpu" for tensor in learnt):
            raise CompilationError("only updates on the CPU are")
        self._memory_keys = keys_of(buffer)
        fixed = [torch.stack(of_agents) for of_agents in self._fixed]
        rate = [] if self._agent.learning_rate is None else [self._rate]
        self._inputs = [*learnt, *fixed, *rate, *(memory[key] for key in self._memory_keys)]
        self._stacks = self._inputs[len(learnt) : len(learnt) + len(fixed)]
        items = torch.zeros(buffer.batch_size, len(agents), dtype=torch.int64)
        scratch = [tensor.clone() for tensor in learnt]
        drawn = [items, torch.ones(items.shape)] if weighted else [items]
        self._call: NativeFunction = compile_native(self._update, [*scratch, *self._inputs[len(learnt) :], *drawn])

    def __call__(self, minibatch: Minibatch) -> tuple[Tensor, Tensor | None]:
        """Updates; the losses before it, [A], and if they are wanted, the squared TD errors, [batch_size, A]."""
        self._rate.fill_(self._agent.optimizer.param_groups[0]["lr"])
        if self._agent.noise is not None:
            for stack, of_agents in zip(self._stacks, self._fixed, strict=True):
                torch.stack(of_agents, out=stack)
        if minibatch.weights is None:
            (losses,) = self._call([*self._inputs, minibatch.items])
            return losses, None
        losses, td_errors = self._call([*self._inputs, minibatch.items, minibatch.weights])
        return losses, td_errors

    def _update(self, *tensors: Tensor) -> Tensor | tuple[Tensor, Tensor]:
        rest = iter(tensors)

        def take(count: int) -> list[Tensor]:
            return [next(rest) for _ in range(count)]

        values, steps, averages, squares, targets = (take(len(self._keys)) for _ in range(5))
        fixed, fixed_targets = (take(len(self._fixed_keys)) for _ in range(2))
        options = self._options
        if self._agent.learning_rate is not None:
            options = options._replace(lr=next(rest))
        memory, items = take(len(self._memory_keys)), next(rest)
        agents = torch.arange(items.shape[1])
        batch = [field[items, agents] for field in memory] + ([next(rest)] if self._weighted else [])
        of_agent = (0, 0, 0, 0, 1)
        gradients, losses, td_errors = torch.vmap(self._gradients, in_dims=of_agent, out_dims=(0, 0, 1))(
            values, targets, fixed, fixed_targets, batch
        )
        for value, target, *moments in zip(values, targets, gradients, steps, averages, squares, strict=True):
            _adam_step(options, value, *moments)
            if isinstance(self._agent.target_updater, SoftTargetUpdate):
                target.lerp_(value, 1 - self._agent.target_updater.eps)
        return (losses, td_errors) if self._weighted else losses

    def _gradients(
        self,
        values: list[Tensor],
        targets: list[Tensor],
        fixed: list[Tensor],
        fixed_targets: list[Tensor],
        batch: list[Tensor],
    ) -> tuple[list[Tensor], Tensor, Tensor]:
        """One agent's gradient, loss and squared TD errors, as TorchRL defines them."""
        differentiate = grad_and_value(self._loss, has_aux=True)
        gradient, (loss, td_errors) = differentiate(values, targets, fixed, fixed_targets, batch)
        clipping = self._agent.clipping
        return (gradient if clipping is None else clipping.clipped(gradient)), loss, td_errors

    def _loss(
        self,
        values: list[Tensor],
        targets: list[Tensor],
        fixed: list[Tensor],
        fixed_targets: list[Tensor],
        batch: list[Tensor],
    ) -> tuple[Tensor, Tensor]:
        names = [*self._memory_keys, *(["priority_weight"] if self._weighted else [])]
        transitions = TensorDict({}, batch_size=batch[0].shape[:1])
        for name, field in zip(names, batch, strict=True):
            transitions[name] = field
        keys = [*self._keys, *self._fixed_keys]
        with _parameters_of(self._agent.loss, keys, [*values, *fixed], [*targets, *fixed_targets]):
            loss = self._agent.loss(transitions)["loss"]
        return loss, transitions["td_error"][:, 0].detach()


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
    lr: float | Tensor
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
