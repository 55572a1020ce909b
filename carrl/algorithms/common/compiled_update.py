"""An update of all replicates as one native function, whatever the algorithm.

Shapes: `A` replicates, `N` transitions of a minibatch.
"""

from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor
from torch.utils._pytree import tree_flatten, tree_map, tree_unflatten

from carrl.algorithms.algorithm import FunctionalUpdate, Tree, UpdateResult
from carrl.algorithms.common.native import CompilationError, compile_native

_ALIGNMENT = 16
"""Of tensors, in numbers of 4 bytes."""


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
        self._has_inputs = bool(tree_flatten(given["inputs"])[0])
        scratch = tree_map(torch.clone, state)  # which the tracing may change
        inputs, self._names = tree_flatten(({"state": scratch, **fixed}, given))
        self._call = compile_native(self._all_replicates, inputs)

    def __call__(self, items: Tensor, weights: Tensor | None) -> UpdateResult:
        """Updates on the transitions at these places of the memory, [N, A], with these weights, [N, A]."""
        drawn = [items] if weights is None else [items, weights]  # in the order of `_given`, without flattening it
        made = tree_flatten(_stacked(self._update.inputs()))[0] if self._has_inputs else []
        results = self._call([*self._fixed, *drawn, *made])
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


def stack_in_place(tensors: Sequence[Tensor]) -> Tensor:
    """One tensor [A, ...] of which each of these, alike in shape and type, is a row from now on.

    Whoever holds one of them, be it a module, a loss or an optimizer, goes on working with it as before. Tensors that
    are the rows of one already stay where they are, so several holders of the same ones share one stack.
    """
    first = tensors[0].detach()
    if all(_is_row(tensor, first, row) for row, tensor in enumerate(tensors)):
        return first.as_strided((len(tensors), *first.shape), (first.numel(), *first.stride()))
    stacked = torch.stack([tensor.detach() for tensor in tensors])
    for tensor, row in zip(tensors, stacked, strict=True):
        tensor.data = row
    return stacked


def stack_side_by_side(rows: Sequence[Sequence[Tensor]]) -> tuple[Tensor, list[int]]:
    """The stacks of several tensors in one piece of memory, as `stack_in_place` makes each of them.

    Args:
        rows: the tensors of each replicate, alike from one to the next.

    Returns:
        The memory, [M], and where in it each stack begins: as torch aligns tensors, the rest is padding. Stacks that
        lie so already stay where they are.
    """
    tensors = list(zip(*rows, strict=True))
    sizes = [len(rows) * each[0].numel() for each in tensors]
    begins = [0, *accumulate(-(-size // _ALIGNMENT) * _ALIGNMENT for size in sizes)]
    first = tensors[0][0]
    total, begin = begins.pop(), first.storage_offset()
    lie_so = all(
        own.is_contiguous() and _shares_memory(own, first) and own.storage_offset() == begin + place + row * own.numel()
        for each, place in zip(tensors, begins, strict=True)
        for row, own in enumerate(each)
    )
    if lie_so and first.untyped_storage().nbytes() >= (begin + total) * first.element_size():
        return first.detach().as_strided((total,), (1,)), begins
    memory = first.detach().new_zeros(total)
    for each, place, size in zip(tensors, begins, sizes, strict=True):
        stacked = memory[place : place + size].view(len(rows), *each[0].shape)
        for own, row in zip(each, stacked, strict=True):
            row.copy_(own.detach())
            own.data = row
    return memory, begins


def _shares_memory(one: Tensor, other: Tensor) -> bool:
    return one.untyped_storage().data_ptr() == other.untyped_storage().data_ptr()


def _is_row(tensor: Tensor, first: Tensor, row: int) -> bool:
    return (
        tensor.is_contiguous()
        and _shares_memory(tensor, first)
        and tensor.storage_offset() == first.storage_offset() + row * first.numel()
    )
