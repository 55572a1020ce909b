"""The states of random generators, to be kept and to be put back."""

from collections.abc import Sequence

import torch
from torch import Tensor


def states_of(generators: Sequence[torch.Generator]) -> list[Tensor]:
    """Where each generator stands."""
    return [generator.get_state() for generator in generators]


def restore(generators: Sequence[torch.Generator], states: Sequence[Tensor]) -> None:
    """Puts each generator back to where it stood.

    Raises:
        ValueError, RuntimeError: there are more or fewer generators, or these are not such states.
    """
    for generator, state in zip(generators, states, strict=True):
        generator.set_state(state)
