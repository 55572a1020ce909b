"""What training asks of an algorithm, and all that it knows of one.

Shapes: `A` replicates, one for each seed, trained side by side; `N` transitions of a minibatch, `F` of any number;
`B` cars, of which each replicate drives the next B / A; `O` values of an observation.
"""

import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn

from carrl.algorithms.common.native import CompilationError
from carrl.log.schema import Column
from carrl.task.task import World

Tree = Mapping[Any, Any]
"""Tensors by name, in groups that may have groups in them."""
Policy = Callable[[Tensor], Tensor]
"""Observations [B, O] to actions [B, ...]."""
Figures = Mapping[str, float]
"""What is measured of one replicate, by name."""


class UpdateResult(NamedTuple):
    """What an update found.

    Attributes:
        losses: before it, [A]; of actors and critics that of the critics.
        td_errors: squared, by which a prioritised memory samples, [N, A]; None where nobody asked.
    """

    losses: Tensor
    td_errors: Tensor | None


class FunctionalUpdate(NamedTuple):
    """An update of one replicate as a function of named tensors, of however many networks, optimizers and losses.

    Attributes:
        function: `(state, constants, inputs, batch) -> (changes, results)`, each a tree. `changes` has the groups of
            `state` that the update replaces; `results` has `loss` [] and `td_error` [N].
        state: what updates change, of each replicate: the very tensors that others go on working with.
        constants: what they read besides, of each replicate.
        inputs: gives what `prepare` made anew for the next update, of each replicate: learning rates, and random
            numbers, as the compiled function itself draws none.
    """

    function: Callable[[Tree, Tree, Tree, TensorDictBase], tuple[Tree, Tree]]
    state: Sequence[Tree]
    constants: Sequence[Tree]
    inputs: Callable[[], Sequence[Tree]]


ManyUpdates = Callable[[int, Tensor, Tensor | None], UpdateResult]
"""Makes updates of all replicates, one after the other.

It is given the first one's number, the places of the minibatches in the memory [U, N, A], and how much they count
[U, N, A] or None, and returns losses [U, A] and squared TD errors [U, N, A].
"""


class CollectPolicy(TensorDictModuleBase):
    """How cars are driven while an algorithm learns: writes `action` and the algorithm's own columns of the log.

    A copy in another process, made by the same configuration, acts alike once it has loaded `shared_state`.
    """

    @property
    @abstractmethod
    def device(self) -> torch.device:
        """Where it acts."""

    @abstractmethod
    def shared_state(self) -> dict[str, Any]:
        """All that changes in it but its random generators, on the CPU."""

    @abstractmethod
    def load_shared_state(self, state: Mapping[str, Any]) -> None:
        """Acts from now on as the policy with this state; only the random numbers stay its own."""


class Algorithm(ABC):
    """Replicates of one algorithm that learn side by side, each as it would alone.

    Attributes:
        seeds: of the replicates.
        networks: the replicates' acting networks, which checkpoints keep.
        collect_policy: drives the cars of all replicates.
        greedy_policy: does so without exploration.
        log_columns: what `collect_policy` adds to a transition in the log.
    """

    seeds: Sequence[int]
    networks: Sequence[nn.Module]
    collect_policy: CollectPolicy
    greedy_policy: Policy
    log_columns: Sequence[Column] = ()

    def check_memory(self, weighted: bool) -> None:  # noqa: B027 (most have nothing against it)
        """Raises ConfigError if the weights of a replay memory that has such would not do what they are for."""

    @property
    def steps_left(self) -> int:
        """Env steps that may be counted at once, 1 or more; after them something happens between two updates."""
        return sys.maxsize

    def count_steps(self, steps: int) -> None:  # noqa: B027
        """Counts env steps of each replicate, or updates where there are none, at most `steps_left`.

        It is called after the updates that belong to these steps.
        """

    def prepare(self, update: int, batch_size: int) -> None:  # noqa: B027
        """Gets ready for an update, by its number from 0, on so many transitions: learning rates, random numbers."""

    def kind_of(self, update: int) -> int:
        """Which of the updates that `functional` names the one with this number from 0 is; the first one is 0."""
        return 0

    @abstractmethod
    def update(self, batch: TensorDictBase) -> UpdateResult:
        """Makes an update from minibatches [N, A], as torch and TorchRL have it; they may have a `priority_weight`."""

    @abstractmethod
    def functional(self) -> Sequence[FunctionalUpdate]:
        """The same update to be compiled, on the tensors that are there now; `update` was called before.

        Where some updates move less than others there are several, all with the same state.

        Raises:
            CompilationError: there is none.
        """

    def machine_code(self, memory: Mapping[Any, Tensor], batch_size: int) -> ManyUpdates:
        """The same update written by hand, on the tensors that are there now; `update` was called before.

        It needs no C++ compiler, and many of them are one call.

        Args:
            memory: the transitions, [capacity, A, ...] by key; its tensors stay where they are.
            batch_size: N.

        Raises:
            CompilationError: there is none for such networks and losses.
        """
        raise CompilationError(f"{type(self).__name__} has no machine code of its own")

    def figures(self) -> Figures:
        """What it adds to the table of episodes, the same for all replicates."""
        return {}

    @abstractmethod
    def measure(self, transitions: TensorDictBase) -> list[Figures]:
        """How learning goes, of each replicate, on transitions just collected, [F, A]."""

    @abstractmethod
    def measure_logged(self, transitions: TensorDictBase) -> list[Figures]:
        """How learning goes, of each replicate, on logged transitions [F], where there is no simulator to ask."""

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """All that updates and env steps change."""

    @abstractmethod
    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on from there; call it before the first update. Networks keep their memory, whose views others hold.

        Raises:
            ValueError, RuntimeError: it is the state of something else.
        """


class Recipe(Protocol):
    """How an algorithm is made of a run's configuration; what `algorithm._target_` names."""

    def build(self, config: Mapping[str, Any], world: World, seeds: Sequence[int], device: torch.device) -> Algorithm:
        """The algorithm with a replicate for each seed."""

    def make_network(self, config: Mapping[str, Any], world: World) -> nn.Module:
        """A network to load a checkpoint into."""

    def greedy_policy(self, network: nn.Module) -> Policy:
        """What such a network does without exploration.

        Where it has more to say for a log of its drives it also has the methods `log_columns`, of the actions' names,
        and `logged`, which gives the values of these columns for observations [B, O], by their keys.
        """
