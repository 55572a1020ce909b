"""Tensors that belong together, row by row."""

from collections.abc import Callable, Sequence
from typing import Any, Self

import torch
from torch import Tensor


def scalar(value: float) -> Tensor:
    """A number to calculate with again and again: an operation with it takes half as long as with a Python number.

    It lives on the CPU, float32 or int64, and goes with tensors on any device.
    """
    return torch.tensor(value)


class Rows:
    """A dataclass of tensors [N, ...], or of other `Rows`: one row for each car, in all of its fields alike.

    A field that a task does without is None, in all rows alike.

    Nobody writes to one that was made. It is not frozen, since that takes four times as long to make in each step, nor
    TensorDict's tensorclass, which takes some ten microseconds for each operation.
    """

    def map(self, function: Callable[..., Tensor], *others: Self) -> Self:
        """The function's value of every field of these rows and the others."""
        fields = zip(*(vars(each).values() for each in (self, *others)), strict=True)
        return type(self)(*(_mapped(function, own) for own in fields))

    def __getitem__(self, index: Any) -> Self:
        """The rows at these indices, or where this mask holds."""
        if isinstance(index, Tensor) and index.dtype is torch.bool and index.dim() == 1:
            index = index.nonzero()[:, 0]  # once, instead of for each field
        return self.map(lambda values: values[index])

    def replacing(self, wanted: Tensor, others: Self) -> Self:
        """These rows, but with the K `others` in the places that are `wanted`, [N] bool with K of them true."""
        index = wanted.nonzero()[:, 0]
        return self.map(lambda own, theirs: own.index_copy(0, index, theirs), others)

    @classmethod
    def stack(cls, moments: Sequence[Self]) -> Self:
        """The rows of T moments as [T, N, ...]."""
        first, *others = moments
        return first.map(lambda *values: torch.stack(values), *others)


def _mapped(function: Callable[..., Tensor], values: tuple[Any, ...]) -> Any:
    if isinstance(values[0], Rows):
        return values[0].map(function, *values[1:])
    return None if values[0] is None else function(*values)
