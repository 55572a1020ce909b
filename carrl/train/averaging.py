"""Averages of networks' weights over their updates, which drive more evenly than the networks themselves.

Source: Polyak and Juditsky 1992, "Acceleration of stochastic approximation by averaging"; Izmailov et al. 2018,
"Averaging weights leads to wider optima and better generalization".
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import torch
from torch import Tensor, nn


class WeightAverages:
    """An exponential moving average of each weight of some networks, which are trained in place.

    Args:
        networks: trained side by side, by the same number of updates.
        horizon: updates after which a weight counts for 1/e of what it did. Until there were so many, all count alike.
    """

    def __init__(self, networks: Sequence[nn.Module], horizon: int) -> None:
        self._parameters = [weight for network in networks for weight in network.parameters()]
        self._averages = [weight.clone() for weight in self._weights]
        self._horizon, self._updates = horizon, 0

    @property
    def _weights(self) -> list[Tensor]:
        """Where they lie now: they move when updates are compiled."""
        return [weight.data for weight in self._parameters]

    def follow(self, updates: int) -> None:
        """Takes the weights in that there are after so many updates in all."""
        made, self._updates = updates - self._updates, updates
        if made > 0:
            share = max(made / updates, 1 - (1 - 1 / self._horizon) ** made)
            torch._foreach_lerp_(self._averages, self._weights, share)

    @contextmanager
    def in_place(self) -> Iterator[None]:
        """The networks have the averages as their weights, until the end of the `with` statement."""
        own = [weight.clone() for weight in self._weights]
        torch._foreach_copy_(self._weights, self._averages)
        try:
            yield
        finally:
            torch._foreach_copy_(self._weights, own)

    def state_dict(self) -> list[Tensor]:
        """The averages."""
        return self._averages

    def load_state_dict(self, state: Sequence[Tensor], updates: int) -> None:
        """Goes on from there, after so many updates in all."""
        torch._foreach_copy_(self._averages, list(state))
        self._updates = updates
