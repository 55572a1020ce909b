"""The replay memory: what goes into it, over how many steps, and what an update draws from it.

Shapes: `A` replicates, which fill their memories side by side; `T` time steps, `N` cars of each replicate.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import (
    LazyTensorStorage,
    RandomSampler,
    Storage,
    TensorDictReplayBuffer,
    TensorDictRoundRobinWriter,
    TensorSpec,
)

from carrl.errors import ConfigError
from carrl.task.random_streams import restore, states_of

STEPS = "steps_to_next_obs"
"""How many steps lie between an observation and the next one, as TorchRL's losses want to know it."""


class NStepReturns:
    """Makes n-step transitions out of single steps, n - 1 time steps later.

    A transition's reward becomes r_0 + gamma r_1 + ... + gamma^(n - 1) r_(n-1), and what comes after it, "next", is
    that of the last of these steps. Where the episode ends earlier, terminated or truncated, so does the sum. The
    loss then discounts what follows by gamma^k for the k steps in `steps_to_next_obs` [..., 1].

    TorchRL 0.14's `MultiStep` sums alike (a test compares them), but drops what a batch cannot complete, and leaves
    `terminated` to the first step, so that the loss would bootstrap from the end of an episode.

    Source: Sutton and Barto 2018, "Reinforcement Learning: An Introduction", eq. 7.1.

    Args:
        steps: n, of each car, whose rewards are summed before the network's value counts; 1 in the paper.
        gamma: the loss's discount.

    Raises:
        ConfigError: fewer than one step.
    """

    def __init__(self, steps: int, *, gamma: float) -> None:
        """Begins with no steps pending."""
        if steps < 1:
            raise ConfigError(f"returns.steps is {steps}; it must be at least 1")
        self._steps, self._gamma = steps, gamma
        self._pending: TensorDictBase | None = None

    def __call__(self, transitions: TensorDictBase) -> TensorDictBase:
        """The transitions that the next time steps [T, N, A] complete, in the order of time."""
        known = transitions if self._pending is None else torch.cat([self._pending, transitions])
        complete = max(0, len(known) - self._steps + 1)
        self._pending = known[complete:].clone()
        return self._summed(known, complete)

    def _summed(self, known: TensorDictBase, complete: int) -> TensorDictBase:
        """The first so many of the known time steps, looking ahead."""
        rewards, done = known["next", "reward"], known["next", "done"]
        going_on = torch.ones_like(done[:complete])
        reward, steps = torch.zeros_like(rewards[:complete]), torch.zeros_like(done[:complete], dtype=torch.int64)
        for ahead in range(self._steps):
            reward += torch.where(going_on, self._gamma**ahead * rewards[ahead : ahead + complete], 0)
            steps += going_on
            going_on &= ~done[ahead : ahead + complete]
        time, cars, replicates = (
            torch.arange(extent, device=done.device).view(shape)
            for extent, shape in zip(steps.shape, ([-1, 1, 1], [-1, 1], [-1]), strict=False)
        )
        summed = known[:complete].clone()
        summed["next"] = known["next"][time + steps[..., 0] - 1, cars, replicates]
        summed["next", "reward"] = reward
        summed[STEPS] = steps
        return summed

    def state_dict(self) -> dict[str, Any]:
        """The steps that wait for those after them, [less than n, N, A] each."""
        return {"pending": None if self._pending is None else self._pending.flatten_keys("/").to_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes on with them.

        Raises:
            ValueError: there are too many.
        """
        pending = state["pending"]
        if pending is None:
            self._pending = None
            return
        if not isinstance(pending, dict) or "observation" not in pending:
            raise ValueError("the pending steps have no observations")
        extents = pending["observation"].shape[:-1]
        if len(extents) != 3 or extents[0] >= self._steps:
            raise ValueError(
                f"{list(extents)} time steps, cars and replicates are pending in returns of {self._steps} steps"
            )
        self._pending = TensorDict(pending, batch_size=extents).unflatten_keys("/")


_LEAST_ERROR = 1e-6
"""What is added to a TD error, so that no transition is never sampled."""


class Minibatches(NamedTuple):
    """Places in the memories: `storage[items, replicates]` are the samples of so many updates, U.

    Attributes:
        items: [U, batch_size, A], int64.
        replicates: [U, batch_size, A], int64.
        weights: by which the losses count, [U, batch_size, A]; None where they count alike.
    """

    items: Tensor
    replicates: Tensor
    weights: Tensor | None = None

    def after(self, made: int) -> "Minibatches":
        """Those that are left after so many updates."""
        weights = None if self.weights is None else self.weights[made:]
        return Minibatches(self.items[made:], self.replicates[made:], weights)


class AgentSampler(RandomSampler):
    """Uniform with replacement, for every replicate from its own memory and with its own generator.

    Args:
        generators: one for each replicate.
    """

    is_weighted = False
    """Whether minibatches have weights, and TD errors are to be noted."""

    def __init__(self, generators: Sequence[torch.Generator]) -> None:
        self._generators = list(generators)
        self._replicates = torch.arange(len(self._generators))

    @property
    def replicates(self) -> int:
        """How many replicates' memories there are."""
        return len(self._generators)

    def sample(self, storage: Storage, batch_size: int) -> tuple[tuple[Tensor, Tensor], dict[str, Any]]:
        """Indices of items and replicates, [batch_size, A] each, such that storage[items, replicates] is the sample."""
        drawn = [torch.randint(len(storage), (batch_size,), generator=each) for each in self._generators]
        items = torch.stack(drawn, dim=1).to(storage.device)
        return (items, self._replicates.to(storage.device).expand_as(items)), {}

    def minibatches(self, storage: Storage, count: int, batch_size: int) -> Iterator[Minibatches]:
        """Those of the next `count` updates, as many at once as can be drawn before one of these is made."""
        samples, _ = self.sample(storage, count * batch_size)
        yield Minibatches(*(index.unflatten(0, (count, batch_size)) for index in samples))

    def state_dict(self) -> dict[str, Any]:
        """Where every generator stands."""
        return {"generators": states_of(self._generators)}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Goes on from where the generators stood."""
        restore(self._generators, state_dict["generators"])


class PrioritizedAgentSampler(AgentSampler):
    """For every replicate in proportion to |TD error|^alpha, with replacement.

    A transition that was never learnt from has the greatest priority so far. Weights make up for the sampling, by the
    exponent beta, with 1 in full; only their ratios count.

    TorchRL 0.14.1's `PrioritizedSampler` needs its C++ extension, which is built for another torch than 2.13 and does
    not load. A running sum over the memory takes 0.2 ms at 131,072 transitions, less than one eager update.

    Source: Schaul et al. 2016, "Prioritized Experience Replay", sections 3.3 and 3.4.

    Args:
        generators: one for each replicate.
        capacity: of each replicate's memory, transitions.
        alpha: exponent of the priorities; with 0 all transitions are alike.
        beta: exponent of the weights.
    """

    is_weighted = True

    def __init__(self, generators: Sequence[torch.Generator], capacity: int, alpha: float, beta: float) -> None:
        super().__init__(generators)
        self._alpha, self._beta = alpha, beta
        self._priorities = torch.zeros(self.replicates, capacity, dtype=torch.float64)
        self._greatest = torch.ones(self.replicates, dtype=torch.float64)

    def sample(self, storage: Storage, batch_size: int) -> tuple[tuple[Tensor, Tensor], dict[str, Any]]:
        """As `AgentSampler` does, and the weights under `priority_weight`, [batch_size, A]."""
        drawn = [torch.rand(batch_size, dtype=torch.float64, generator=each) for each in self._generators]
        sums = self._priorities[:, : len(storage)].cumsum(-1)
        items = torch.searchsorted(sums, torch.stack(drawn) * sums[:, -1:], right=True).clamp(max=len(storage) - 1)
        chosen = self._priorities.gather(-1, items)
        weights = (chosen / chosen.amin(-1, keepdim=True)) ** -self._beta
        items = items.T.contiguous().to(storage.device)
        return (items, self._replicates.to(storage.device).expand_as(items)), {
            "priority_weight": weights.T.contiguous().float().to(storage.device)
        }

    def minibatches(self, storage: Storage, count: int, batch_size: int) -> Iterator[Minibatches]:
        """Those of the next updates, each drawn when the one before has set its priorities."""
        for _ in range(count):
            (items, replicates), info = self.sample(storage, batch_size)
            yield Minibatches(items[None], replicates[None], info["priority_weight"][None])

    def extend(self, index: Tensor) -> None:
        """Gives new transitions the greatest priority so far; called by the buffer."""
        self._priorities[:, index] = self._greatest[:, None]

    def set_priorities(self, items: Tensor, td_errors: Tensor) -> None:
        """Notes how large the TD errors of transitions were: both [batch_size, A]."""
        priorities = ((td_errors.abs().double().cpu() + _LEAST_ERROR) ** self._alpha).T
        self._priorities.scatter_(-1, items.cpu().T, priorities)
        self._greatest = self._greatest.maximum(priorities.amax(-1))

    def state_dict(self) -> dict[str, Any]:
        """Where every generator stands, and the priorities of what is in the memory."""
        filled = int(self._priorities[0].count_nonzero())
        return super().state_dict() | {"priorities": self._priorities[:, :filled], "greatest": self._greatest}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Goes on from there; call it when the memory is as it was."""
        super().load_state_dict(state_dict)
        priorities = state_dict["priorities"]
        self._priorities.zero_()
        self._priorities[:, : priorities.shape[1]] = priorities
        self._greatest = state_dict["greatest"].clone()


KEYS = (
    "observation",
    "action",
    ("next", "observation"),
    ("next", "reward"),
    ("next", "done"),
    ("next", "terminated"),
)
"""What the loss reads of a transition; nothing else is kept, but `STEPS` of one over several steps."""
MOST_TRANSITIONS = 2**27
"""Of a memory: about 10 GB with the default sensor."""


def make_replay_buffer(
    capacity: int, batch_size: int, *, device: torch.device | str, generators: Sequence[torch.Generator]
) -> TensorDictReplayBuffer:
    """A ring of the latest `capacity` transitions of every replicate, of which `batch_size` are sampled at a time.

    An item is one transition of each replicate, a TensorDict of batch size [A]; a sample is [batch_size, A].

    Args:
        capacity: transitions kept of each replicate.
        batch_size: transitions in an update.
        device: where transitions are kept.
        generators: one for each replicate, for sampling.

    Raises:
        ConfigError: the batch is empty or larger than the memory, or the memory is too large.
    """
    _check_sizes(capacity, batch_size)
    return _make_buffer(capacity, batch_size, device, AgentSampler(generators))


def make_prioritized_replay_buffer(
    capacity: int,
    batch_size: int,
    alpha: float,
    beta: float,
    *,
    device: torch.device | str,
    generators: Sequence[torch.Generator],
) -> TensorDictReplayBuffer:
    """The buffer of `make_replay_buffer`, but transitions that surprised the network are sampled more often.

    Args:
        capacity: transitions kept of each replicate.
        batch_size: transitions in an update.
        alpha: a transition's share of the samples is |TD error|^alpha, 0 to 1; 0 for all alike.
        beta: how far weights in the loss make up for that, 0 to 1; 1 for in full.
        device: where transitions are kept.
        generators: one for each replicate, for sampling.

    Raises:
        ConfigError: the batch is empty or larger than the memory, or alpha or beta lies outside 0..1.
    """
    for name, value in (("alpha", alpha), ("beta", beta)):
        if not 0 <= value <= 1:
            raise ConfigError(f"replay_buffer.{name} is {value}; it must lie in 0..1")
    _check_sizes(capacity, batch_size)
    return _make_buffer(capacity, batch_size, device, PrioritizedAgentSampler(generators, capacity, alpha, beta))


def memory_of(buffer: TensorDictReplayBuffer) -> dict[Any, Tensor]:
    """What a buffer that is not empty keeps of transitions, [capacity, A, ...] by key: all of it, filled or not."""
    memory = buffer.storage._storage
    return {key: memory[key] for key in (*KEYS, *([STEPS] if STEPS in memory else []))}


def _check_sizes(capacity: int, batch_size: int) -> None:
    if not 1 <= batch_size <= capacity:
        raise ConfigError(
            f"replay_buffer.batch_size is {batch_size} and capacity is {capacity}; it must be 1 to capacity transitions"
        )
    if capacity > MOST_TRANSITIONS:
        raise ConfigError(f"replay_buffer.capacity is {capacity}; it may be at most {MOST_TRANSITIONS} transitions")


def _make_buffer(
    capacity: int, batch_size: int, device: torch.device | str, sampler: AgentSampler
) -> TensorDictReplayBuffer:
    return TensorDictReplayBuffer(
        # "compilable": the length and the cursor are plain numbers, not shared memory, which may be full
        storage=LazyTensorStorage(capacity, device=device, compilable=True),
        writer=TensorDictRoundRobinWriter(compilable=True),
        sampler=sampler,
        batch_size=batch_size,
    )


def contents_of(buffer: TensorDictReplayBuffer) -> dict[str, Any]:
    """The transitions in the ring, [items, A] each, and the place of the next one; not what is not yet filled."""
    items = len(buffer)
    fields = buffer.storage._storage.select(*memory_of(buffer))[:items].flatten_keys("/").to_dict() if items else {}
    return {"fields": fields, "cursor": buffer.writer._cursor}


def restore_contents(buffer: TensorDictReplayBuffer, contents: dict[str, Any], action_spec: TensorSpec) -> None:
    """Fills an empty buffer with the contents of another one of the same capacity.

    Raises:
        ValueError: these are no such contents.
    """
    fields, cursor, capacity = contents["fields"], contents["cursor"], buffer.storage.max_size
    wanted = {"/".join(key) if isinstance(key, tuple) else key for key in KEYS}
    if fields and fields.keys() - {STEPS} != wanted:
        raise ValueError("the transitions in the memory lack something, or have more than is kept")
    items = len(fields["action"]) if fields else 0
    if items > capacity or cursor not in (range(capacity) if items == capacity else [items]):
        raise ValueError(f"{items} transitions with the cursor at {cursor} do not fit a ring of {capacity}")
    if items:
        transitions = TensorDict(fields, batch_size=[items, buffer.sampler.replicates]).unflatten_keys("/")
        action = transitions["action"]
        if not action_spec.expand(action.shape).is_in(action):
            raise ValueError("there are actions that no car has")
        buffer.extend(transitions.select(*KEYS, *([STEPS] if STEPS in fields else [])))
    buffer.writer._cursor = cursor
