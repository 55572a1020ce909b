"""Random numbers from outside for code that draws its own."""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

_DRAWS = (torch.Tensor.normal_, torch.randn_like)
"""How torch's normal distribution and TorchRL 0.14's losses draw normal numbers."""


class GivenNoise(TorchFunctionMode):
    """While it is on, what is drawn from the standard normal distribution are these numbers, in their order.

    TorchRL's losses draw from torch's own generator, which replicates would share, and which no compiled function can
    be given. Under `torch.vmap`, such draws are refused; given ones are inputs like others.

    Args:
        numbers: of each draw, of its shape.
    """

    def __init__(self, numbers: Sequence[Tensor]) -> None:
        super().__init__()
        self._left = list(numbers)

    def __torch_function__(
        self, function: Callable[..., Any], types: Any, args: Sequence[Any] = (), kwargs: Any = None
    ) -> Any:
        """Answers draws, and calls all else."""
        if function not in _DRAWS:
            return function(*args, **(kwargs or {}))
        drawn = self._left.pop(0)
        if drawn.shape != args[0].shape:
            raise RuntimeError(f"numbers of shape {list(args[0].shape)} are drawn, {list(drawn.shape)} are given")
        return drawn
