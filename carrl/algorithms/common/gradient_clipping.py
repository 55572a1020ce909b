"""How large a gradient may be.

Shapes: a gradient is a list of tensors, one for each parameter of one agent's network.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from carrl.errors import ConfigError

_EPSILON = 1e-6
"""What `torch.nn.utils.clip_grad_norm_` adds to a norm before it divides by it."""


def make_gradient_clipping(max_norm: float | None) -> "GradientClipping | None":
    """What scales a gradient that is too large down, each replicate's for itself; None for no limit, as in the paper.

    Args:
        max_norm: of the gradient over all parameters, such as 10, which most exceed in an ordinary run with the squared
            TD error; None for no limit.

    Raises:
        ConfigError: the limit is not positive.
    """
    return None if max_norm is None else GradientClipping(max_norm)


@dataclass(frozen=True)
class GradientClipping:
    """Scales a gradient down where its norm over all parameters exceeds a limit.

    Source: Pascanu et al. 2013, "On the difficulty of training recurrent neural networks", Algorithm 1.

    Attributes:
        max_norm: the limit.
    """

    max_norm: float

    def __post_init__(self) -> None:
        """Raises ConfigError unless the limit is a positive number."""
        if not 0 < self.max_norm < math.inf:
            raise ConfigError(f"gradient_clipping.max_norm is {self.max_norm}; it must be a positive number")

    def clipped(self, gradient: Sequence[Tensor]) -> list[Tensor]:
        """What `torch.nn.utils.clip_grad_norm_` makes of it, as new tensors, so that it can be traced."""
        norm = torch.stack([torch.linalg.vector_norm(each) for each in gradient]).norm()
        share = (self.max_norm / (norm + _EPSILON)).clamp(max=1)
        return [each * share for each in gradient]
