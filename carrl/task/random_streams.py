"""Random generators, one for each part of each replicate; cars draw from their own replicate's.

So each replicate's cars fare as they would alone, whatever the others do.

Shapes: `N` cars, replicate by replicate.
"""

from collections.abc import Callable, Sequence
from typing import Any

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


class RandomStreams:
    """One generator for each replicate.

    Args:
        seeds: of each replicate's generator; None for a fresh one.
        share: cars of each replicate.
    """

    def __init__(self, seeds: Sequence[int | None], share: int) -> None:
        """Seeds the generators."""
        self._share = share
        self._generators = [torch.Generator() for _ in seeds]
        for generator, seed in zip(self._generators, seeds, strict=True):
            if seed is None:
                generator.seed()
            else:
                generator.manual_seed(seed)

    def seed(self, seed: int) -> None:
        """Begins anew with this seed for the first replicate, the next one for the second, and so on."""
        for offset, generator in enumerate(self._generators):
            generator.manual_seed(seed + offset)

    def state_dict(self) -> dict[str, Any]:
        """Where every generator stands."""
        return {"generators": states_of(self._generators)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes on from where the generators stood."""
        restore(self._generators, state["generators"])

    def __getstate__(self) -> dict[str, Any]:
        """For pickle, with the generators as plain bytes.

        Multiprocessing hands a tensor over in shared memory, by a file that torch 2.13 closes too early where the
        tensor is made while a generator is pickled: a process that is spawned with one dies.
        """
        states = [state.numpy().tobytes() for state in states_of(self._generators)]
        return {"share": self._share, "generators": states}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """From what `__getstate__` told of."""
        self._share = state["share"]
        states = [torch.frombuffer(bytearray(each), dtype=torch.uint8) for each in state["generators"]]
        self._generators = [torch.Generator() for _ in states]
        restore(self._generators, states)

    def integers(self, high: int) -> Tensor:
        """Whole numbers from 0 to `high` - 1, [N], int64."""
        return torch.cat([torch.randint(high, (self._share,), generator=each) for each in self._generators])

    def uniform(self, *columns: int, wanted: Tensor | None = None) -> Tensor:
        """Numbers from 0 to 1, [N, *columns], float64; zero for replicates none of whose cars is `wanted`, [N]."""
        return self._draw(torch.rand, columns, wanted)

    def normal(self, *columns: int, wanted: Tensor | None = None) -> Tensor:
        """Numbers of mean 0 and standard deviation 1, [N, *columns], float64; zero as in `uniform`."""
        return self._draw(torch.randn, columns, wanted)

    def _draw(self, draw: Callable[..., Tensor], columns: tuple[int, ...], wanted: Tensor | None) -> Tensor:
        numbers = torch.zeros(self._share * len(self._generators), *columns, dtype=torch.float64)
        is_wanted = torch.ones(len(numbers), dtype=torch.bool) if wanted is None else wanted
        shares = zip(self._generators, numbers.split(self._share), is_wanted.split(self._share), strict=True)
        for generator, own, own_wanted in shares:
            if own_wanted.any():
                own.copy_(draw(own.shape, dtype=torch.float64, generator=generator))
        return numbers


class CarStreams(RandomStreams):
    """A stream for each car, as N copies of the environment would have, drawn from for the wanted cars alone.

    Args:
        cars: how many, N.
    """

    def __init__(self, cars: int) -> None:
        """Makes a fresh generator for each."""
        super().__init__([None] * cars, share=1)

    def seed_each(self, seeds: Sequence[int | None], wanted: Tensor) -> None:
        """Begins anew for the `wanted` cars, [N] bool, with their seeds, if they have one."""
        for car in wanted.nonzero()[:, 0].tolist():
            seed = seeds[car]
            if seed is not None:
                self._generators[car].manual_seed(seed)

    def _draw(self, draw: Callable[..., Tensor], columns: tuple[int, ...], wanted: Tensor | None) -> Tensor:
        """Zero for cars that are not wanted; far quicker than to ask for each of them."""
        numbers = torch.zeros(len(self._generators), *columns, dtype=torch.float64)
        cars = torch.arange(len(numbers)) if wanted is None else wanted.nonzero()[:, 0]
        own = [draw((1, *columns), dtype=torch.float64, generator=self._generators[car]) for car in cars.tolist()]
        return numbers.index_copy_(0, cars, torch.cat(own)) if own else numbers
