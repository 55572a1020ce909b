"""Random generators: one for each part of each replicate, and their states, to be kept and to be restored."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

_PARTS = ("env", "network", "exploration", "replay_buffer", "noise")
"""Each one's seed depends on its place."""


def part_generator(seed: int, part: str) -> torch.Generator:
    """A generator for one part of the replicate with this seed, so that no part's draws shift what another one draws.

    Raises:
        ValueError: there is no such part.
    """
    return torch.Generator().manual_seed(part_seed(seed, part))


def part_seed(seed: int, part: str) -> int:
    """The seed of one part.

    Raises:
        ValueError: there is no such part.
    """
    return int(np.random.SeedSequence(seed).generate_state(len(_PARTS))[_PARTS.index(part)])


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
