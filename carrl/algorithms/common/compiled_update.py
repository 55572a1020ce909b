"""An update of all replicates as one native function, whatever the algorithm.

Shapes: `A` replicates, `N` transitions of a minibatch.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor
from torch.utils._pytree import tree_flatten, tree_map, tree_unflatten

from carrl.algorithms.algorithm import FunctionalUpdate, Tree, UpdateResult
from carrl.algorithms.common.native import CompilationError, compile_native
from carrl.algorithms.common.stack import stack_in_place


class CompiledUpdate:
    """An update of all replicates as one native function, on the tensors that are there when it is made.

    The algorithm's functional update is mapped over the replicates, whose state becomes rows of stacked tensors; taking
    the minibatch out of the memory is part of the function.

    Args:
        update: of one replicate.
        memory: the transitions, [capacity, A, ...] by key; all of it, filled or not: its tensors stay where they are.
        batch_size: N.
        weighted: whether minibatches have weights, and TD errors are wanted.

    Raises:
        CompilationError: it cannot be compiled, or not here.
    """

    def __init__(self, update: FunctionalUpdate, memory: Mapping[Any, Tensor], batch_size: int, weighted: bool) -> None:
        self._update, self._weighted = update, weighted
        state = _stacked(update.state, stack_in_place)
        if any(tensor.device.type != "cpu" for tensor in tree_flatten(state)[0]):
            raise CompilationError("only updates on the CPU are")
        replicates = len(update.state)
        items = torch.zeros(batch_size, replicates, dtype=torch.int64)
        fixed = {"constants": _stacked(update.constants), "memory": dict(memory)}
        self._fixed = tree_flatten({"state": state, **fixed})[0]
        given = self._given(items, torch.ones(items.shape))
        scratch = tree_map(torch.clone, state)  # which the tracing may change
        inputs, self._names = tree_flatten(({"state": scratch, **fixed}, given))
        self._call = compile_native(self._all_replicates, inputs)

    def __call__(self, items: Tensor, weights: Tensor | None) -> UpdateResult:
        """Updates on the transitions at these places of the memory, [N, A], with these weights, [N, A]."""
        results = self._call([*self._fixed, *tree_flatten(self._given(items, weights))[0]])
        return UpdateResult(results[0], results[1].T if self._weighted else None)

    def _given(self, items: Tensor, weights: Tensor | None) -> Tree:
        """What is another one in each call."""
        drawn = {"items": items, "weights": weights} if self._weighted else {"items": items}
        return {"minibatch": drawn, "inputs": _stacked(self._update.inputs())}

    def _all_replicates(self, *tensors: Tensor) -> tuple[Tensor, ...]:
        fixed, given = tree_unflatten(tensors, self._names)
        minibatch = given["minibatch"]
        items = minibatch["items"]
        replicates = torch.arange(items.shape[1])
        batch = {key: field[items, replicates] for key, field in fixed["memory"].items()}
        if self._weighted:
            batch["priority_weight"] = minibatch["weights"]
        one = torch.vmap(self._one_replicate, in_dims=(0, 0, 0, 1))
        changes, results = one(fixed["state"], fixed["constants"], given["inputs"], batch)
        for group, change in changes.items():
            tree_map(lambda own, new: own.copy_(new), fixed["state"][group], change)
        return (results["loss"], results["td_error"]) if self._weighted else (results["loss"],)

    def _one_replicate(self, state: Tree, constants: Tree, inputs: Tree, batch: Tree) -> tuple[Tree, Tree]:
        transitions = TensorDict({}, batch_size=next(iter(batch.values())).shape[:1])
        for key, field in batch.items():
            transitions[key] = field
        return self._update.function(state, constants, inputs, transitions)


def _stacked(trees: Sequence[Tree], stack: Any = torch.stack) -> Tree:
    """The tensors of several trees of one structure, one for each replicate, as one tree of tensors [A, ...]."""
    leaves, structures = zip(*map(tree_flatten, trees), strict=True)
    stacked: Tree = tree_unflatten([stack(tensors) for tensors in zip(*leaves, strict=True)], structures[0])
    return stacked


class Adam(NamedTuple):
    """What a functional update needs of torch's Adam, the same for all replicates.

    Source: Kingma and Ba 2015, "Adam: A Method for Stochastic Optimization", Algorithm 1.
    """

    lr: float
    beta_1: float
    beta_2: float
    eps: float

    @classmethod
    def of(cls, optimizer: torch.optim.Optimizer) -> "Adam":
        """What an optimizer does.

        Raises:
            CompilationError: it is not plain Adam with one group of parameters.
        """
        if type(optimizer) is not torch.optim.Adam or len(optimizer.param_groups) != 1:
            raise CompilationError(f"the optimizer is {type(optimizer).__name__}, not Adam with one group")
        (group,) = optimizer.param_groups
        extras = [name for name in ("weight_decay", "amsgrad", "maximize", "decoupled_weight_decay") if group[name]]
        if extras:
            raise CompilationError(f"the optimizer uses {', '.join(extras)}")
        beta_1, beta_2 = group["betas"]
        return cls(group["lr"], beta_1, beta_2, group["eps"])

    @staticmethod
    def state_of(optimizer: torch.optim.Optimizer, parameters: Mapping[Any, Tensor]) -> Tree:
        """Its state, by `step`, `exp_avg` and `exp_avg_sq`, and by the parameters' names; it has made a step."""
        names = ("step", "exp_avg", "exp_avg_sq")
        return {name: {key: optimizer.state[each][name] for key, each in parameters.items()} for name in names}

    def step(self, parameters: Tree, gradients: Tree, state: Tree, lr: float | Tensor | None = None) -> tuple[Any, Any]:
        """One replicate's parameters and the optimizer's state after a step."""
        rate = self.lr if lr is None else lr
        moved: dict[Any, Tensor] = {}
        after: dict[str, dict[Any, Tensor]] = {name: {} for name in state}
        for key, value in parameters.items():
            gradient, step = gradients[key], state["step"][key] + 1
            average = state["exp_avg"][key].lerp(gradient, 1 - self.beta_1)
            square = torch.addcmul(state["exp_avg_sq"][key] * self.beta_2, gradient, gradient, value=1 - self.beta_2)
            taken = step.double()
            unbiased = average / (1 - self.beta_1**taken).to(average.dtype)
            scale = (square / (1 - self.beta_2**taken).to(square.dtype)).sqrt() + self.eps
            moved[key] = value - rate * unbiased / scale
            after["step"][key], after["exp_avg"][key], after["exp_avg_sq"][key] = step, average, square
        return moved, after
