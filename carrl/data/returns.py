"""What the network is to predict: the reward of a step and the value after it, or the rewards of several steps first.

Shapes: `T` time steps, `N` cars of each of `A` agents.
"""

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase

from carrl.errors import ConfigError

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
        steps: n.
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
        time, cars, agents = (
            torch.arange(extent, device=done.device).view(shape)
            for extent, shape in zip(steps.shape, ([-1, 1, 1], [-1, 1], [-1]), strict=False)
        )
        summed = known[:complete].clone()
        summed["next"] = known["next"][time + steps[..., 0] - 1, cars, agents]
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
        if not isinstance(pending, dict) or "action" not in pending:
            raise ValueError("the pending steps have no actions")
        extents = pending["action"].shape
        if len(extents) != 3 or extents[0] >= self._steps:
            raise ValueError(
                f"{list(extents)} time steps, cars and agents are pending in returns of {self._steps} steps"
            )
        self._pending = TensorDict(pending, batch_size=extents).unflatten_keys("/")
