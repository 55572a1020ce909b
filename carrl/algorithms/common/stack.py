"""Many agents' tensors in one, so that one call computes for all of them.

Shapes: `A` agents.
"""

from collections.abc import Sequence

import torch
from torch import Tensor


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


def _is_row(tensor: Tensor, first: Tensor, row: int) -> bool:
    return (
        tensor.is_contiguous()
        and tensor.untyped_storage().data_ptr() == first.untyped_storage().data_ptr()
        and tensor.storage_offset() == first.storage_offset() + row * first.numel()
    )
