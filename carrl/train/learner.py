"""Updates of all replicates: sample, update, note what was found.

Eagerly, an update is the algorithm's own, TorchRL's loss and torch's optimizer called as they are. Compiled, the same
is one native function for all replicates together, since the overhead of those calls is nearly all of the time of so
small an update; the eager way is the oracle.

Shapes: `A` replicates, `U` updates.
"""

import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.data import TensorDictReplayBuffer

from carrl.algorithms.algorithm import Algorithm, UpdateResult
from carrl.algorithms.common.compiled_update import CompiledUpdate
from carrl.algorithms.common.native import CompilationError
from carrl.data.replay_buffer import Minibatches, memory_of

MACHINE_CODE, COMPILED, EAGER = "machine code", "compiled", "eager"
"""The kinds of update. Their numbers differ by rounding: by 1e-7 after some hundred updates, and by more and more."""
DIVERGENCE = "divergence.json"
"""The file in a run's folder with the whole story of a loss that stopped being a number."""
_logger = logging.getLogger(__name__)
_Make = Callable[[int, Minibatches], UpdateResult]
"""Makes one or more of the updates of these minibatches, whose first one has this number; U of the result says how
many."""


@dataclass(frozen=True)
class Divergence:
    """The first update of a replicate whose loss was not finite.

    Attributes:
        update: its number, from 1.
        loss: before it.
        items: of the minibatch, places in the replay buffer.
    """

    update: int
    loss: float
    items: Sequence[int]


class Learner:
    """Trains replicates side by side, each as it would be alone.

    Args:
        algorithm: that is trained.
        buffer: with the memories of all replicates.
        compiled: make the updates natively. Where that cannot be done, they run eagerly, and one line says why.
        frames_per_update: env steps of each replicate for one update of its networks.

    Attributes:
        compiling_since: the monotonic time since which updates are being compiled; None while they are not.
    """

    def __init__(
        self, algorithm: Algorithm, buffer: TensorDictReplayBuffer, *, compiled: bool, frames_per_update: int = 1
    ) -> None:
        """Compiles nothing yet: the buffer's shape is unknown while it is empty."""
        self._algorithm, self._buffer = algorithm, buffer
        self._compiles = compiled
        self._frames_per_update = frames_per_update
        self._frames_waiting = 0
        self._make: _Make | None = None
        self._kind: str | None = None if compiled else EAGER  # not known before it was tried
        self.updates = 0
        self.first_update_at: float | None = None
        self.compiling_since: float | None = None
        self._is_interrupted = False
        self.losses = torch.full([len(algorithm.seeds)], math.nan)
        self.divergences: dict[int, Divergence] = {}

    def state_dict(self) -> dict[str, Any]:
        """All that an update changes, but the buffer and the algorithm."""
        return {
            "updates": self.updates,
            "kind": self._kind,
            "frames_waiting": self._frames_waiting,
            "losses": self.losses,
            "sampler": self._buffer.sampler.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on from there; call it before the first update, and when the buffer is as it was."""
        self.updates, self.losses = state["updates"], state["losses"].clone()
        self._kind = state["kind"]
        self._frames_waiting = state["frames_waiting"]
        self._buffer.sampler.load_state_dict(state["sampler"])

    def learn(self, frames: int) -> None:
        """The updates for the next `frames` env steps, if there is a batch to sample, and what the steps bring about.

        Afterwards `losses` [A] are those before the last update, `updates` counts them all, and `first_update_at` is
        the monotonic time of the first one in the way that all later ones are made, compiled or not. `divergences`
        has an entry for each replicate whose loss has ever not been finite.
        """
        while frames > 0:
            count = min(frames, self._algorithm.steps_left)
            if len(self._buffer) >= self._buffer.batch_size:
                updates, self._frames_waiting = divmod(self._frames_waiting + count, self._frames_per_update)
                if updates:
                    self._update(updates)
            self._algorithm.count_steps(count)
            frames -= count

    @property
    def learns_for_the_first_time(self) -> bool:
        """Whether the next call of `learn` makes the first update, and compiles it, which can take half a minute."""
        return self.updates == 0 and len(self._buffer) >= self._buffer.batch_size

    def interrupt(self) -> None:
        """Ends a compilation that is going on, from a signal's handler; without one it does nothing.

        Raises:
            KeyboardInterrupt: there is one; `learn` raises it, too.
        """
        if self.compiling_since is not None:
            self._is_interrupted = True
            raise KeyboardInterrupt

    def _update(self, count: int) -> None:
        """The first update of all is eager, for it makes the optimizers' state; the second one compiles."""
        losses, sampled = [], []
        sampler, size, number = self._buffer.sampler, self._buffer.batch_size, self.updates
        for drawn in sampler.minibatches(self._buffer.storage, count, size):
            made = 0
            while made < len(drawn.items):
                if self._compiles and self._make is None and number > 0:
                    self._try_to_compile()
                result = (self._make or self._update_eagerly)(number, drawn.after(made))
                items = drawn.items[made : made + len(result.losses)]
                if drawn.weights is not None and result.td_errors is not None:
                    sampler.set_priorities(items[-1], result.td_errors[-1].sqrt())
                losses.append(result.losses)
                sampled.append(items)
                made, number = made + len(items), number + len(items)
                self.losses = result.losses[-1]
                if self.first_update_at is None and (self._make or not self._compiles):
                    self.first_update_at = time.monotonic()
        self._note_divergences(torch.cat(losses), torch.cat(sampled))
        self.updates += count

    def _update_eagerly(self, number: int, minibatches: Minibatches) -> UpdateResult:
        self._algorithm.prepare(number, self._buffer.batch_size)
        batch = self._buffer.storage.get((minibatches.items[0], minibatches.replicates[0]))
        if minibatches.weights is not None:
            batch["priority_weight"] = minibatches.weights[0]
        return _as_one_of_many(self._algorithm.update(batch))

    def _note_divergences(self, losses: Tensor, sampled: Tensor) -> None:
        """Looks for losses [U, A] that are not finite; the items sampled are [U, batch_size, A]."""
        broken = ~losses.isfinite()
        if not broken.any():
            return
        for index in broken.any(0).nonzero()[:, 0].tolist():
            first = int(broken[:, index].int().argmax())
            minibatch = sampled[first][:, index].tolist()
            divergence = Divergence(self.updates + first + 1, losses[first, index].item(), minibatch)
            self.divergences.setdefault(index, divergence)

    def _try_to_compile(self) -> None:
        self.compiling_since = time.monotonic()
        try:
            self._make, kind = self._compiled()
        except CompilationError as error:
            if not self._is_interrupted:
                _logger.warning("Updates run eagerly, many times slower, because they cannot be compiled: %s", error)
            self._compiles, kind = False, EAGER
        finally:
            self.compiling_since = None
        if self._is_interrupted:  # torchrl 0.14 makes an error of its own of a KeyboardInterrupt that is raised in it
            raise KeyboardInterrupt
        self._note_kind(kind)

    def _compiled(self) -> tuple[_Make, str]:
        """What makes updates, and its kind."""
        algorithm, buffer = self._algorithm, self._buffer
        memory, weighted = memory_of(buffer), buffer.sampler.is_weighted
        try:
            make = algorithm.machine_code(memory, buffer.batch_size)
        except CompilationError:
            native = [CompiledUpdate(update, memory, buffer.batch_size, weighted) for update in algorithm.functional()]

            def make_one(number: int, minibatches: Minibatches) -> UpdateResult:
                algorithm.prepare(number, buffer.batch_size)
                weights = None if minibatches.weights is None else minibatches.weights[0]
                return _as_one_of_many(native[algorithm.kind_of(number)](minibatches.items[0], weights))

            return make_one, COMPILED

        def make_all(number: int, minibatches: Minibatches) -> UpdateResult:
            algorithm.prepare(number + len(minibatches.items) - 1, buffer.batch_size)
            return make(number, minibatches.items, minibatches.weights)

        return make_all, MACHINE_CODE

    def _note_kind(self, kind: str) -> None:
        """Says where updates go on in another way than before, whose numbers differ in their last digits."""
        if self._kind not in (None, kind):
            _logger.warning(
                "The updates so far were %s, those from here on are %s: the run will not be, bit for bit, the one "
                "never stopped.",
                self._kind,
                kind,
            )
        self._kind = kind

    def divergence_report(self, index: int, network: nn.Module) -> dict[str, Any] | None:
        """What there is to say about a replicate's loss that stopped being a number, for JSON; None if it did not."""
        divergence = self.divergences.get(index)
        if divergence is None:
            return None
        minibatch: TensorDictBase = self._buffer.storage.get(torch.tensor(divergence.items))[:, index]
        return {
            "update": divergence.update,
            "loss": str(divergence.loss),
            "minibatch": {
                name: {"least": str(values.min().item()), "greatest": str(values.max().item())}
                for name, values in minibatch.exclude("index").flatten_keys(".").items()
            },
            "parameter_norms": {name: str(value.norm().item()) for name, value in network.named_parameters()},
            "items": list(divergence.items),
        }


def _as_one_of_many(result: UpdateResult) -> UpdateResult:
    return UpdateResult(result.losses[None], None if result.td_errors is None else result.td_errors[None])


def divergence_sentence(report: Mapping[str, Any]) -> str:
    """A report on a divergence, with its `seed`, in short."""
    reward = report["minibatch"]["next.reward"]
    norms = ", ".join(f"{float(norm):.3g}" for norm in report["parameter_norms"].values())
    place = f"at update {report['update']:,}" + (f", frame {report['frame']:,}," if "frame" in report else "")
    finite = all(math.isfinite(float(reward[name])) for name in ("least", "greatest"))
    remedy = "try a smaller optimizer.lr" if finite else "a term of the reward is not finite; repair it, and go on"
    return (
        f"the loss is {report['loss']} {place} of seed {report['seed']}: the rewards of its minibatch are "
        f"{reward['least']} to {reward['greatest']}, the norms of the parameters {norms} ({DIVERGENCE} has all of it); "
        f"{remedy}, also with resume=RUN"
    )
