"""When the target network follows the trained one."""

import sys

from torchrl.objectives import DQNLoss, HardUpdate, LossModule, SoftUpdate

from carrl.errors import ConfigError


class PeriodicHardUpdate(HardUpdate):
    """Copies the network into the target network at env steps C, 2C, 3C and so on.

    TorchRL 0.14's `HardUpdate(value_network_update_interval=n)` copies at every n+1-th call of `step`, hence the minus
    one; `test_target_network_changes_exactly_at_steps_c_2c_3c` pins it.

    Source: the paper, Algorithm 1 and Table I (C).
    """

    def __init__(self, loss: LossModule, period: int) -> None:
        super().__init__(loss, value_network_update_interval=period - 1)

    @property
    def steps_left(self) -> int:
        """Env steps from now to the next copy, 1 or more."""
        return self.value_network_update_interval + 1 - self.counter

    def step(self, count: int = 1) -> None:
        """Counts env steps, at most as many as are left, and copies if none is left then."""
        self.counter += count - 1
        super().step()

    def follow(self) -> None:
        """Nothing after a single update: the copies keep to env steps."""

    def state_dict(self) -> dict[str, int]:
        """How far the next copy is."""
        return {"counter": self.counter}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Goes on counting from there.

        Raises:
            ValueError: no counter of this period can stand there.
        """
        if not 0 <= state["counter"] <= self.value_network_update_interval:
            raise ValueError(f"the counter is {state['counter']}")
        self.counter = state["counter"]


class SoftTargetUpdate(SoftUpdate):
    """Moves the target network a share of its way to the network after every update.

    Source: Lillicrap et al. 2016, "Continuous control with deep reinforcement learning", section 3 (tau).
    """

    steps_left = sys.maxsize
    """Env steps to the next copy: there is none."""

    def __init__(self, loss: LossModule, tau: float) -> None:
        super().__init__(loss, tau=tau)

    def step(self, count: int = 1) -> None:
        """Nothing at env steps: the target follows the updates."""

    def follow(self) -> None:
        """Moves the target network, after each update."""
        super().step()

    def state_dict(self) -> dict[str, int]:
        """Nothing but the loss's own parameters moves."""
        return {}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Nothing to put back."""


TargetUpdater = PeriodicHardUpdate | SoftTargetUpdate


def make_hard_update(period: int, *, loss: DQNLoss) -> PeriodicHardUpdate:
    """A hard update of the loss's target network every `period` env steps.

    Args:
        period: env steps between two copies (Table I, C); learning from logs, where there are none, each update counts
            as one.
        loss: whose target network follows.

    Raises:
        ConfigError: the period is less than 1.
    """
    if period < 1:
        raise ConfigError(f"target_updater.period is {period}; it must be at least 1 env step")
    return PeriodicHardUpdate(loss, period)


def make_soft_update(tau: float, *, loss: DQNLoss) -> SoftTargetUpdate:
    """A soft update of the loss's target network after every update: target += tau * (network - target).

    Args:
        tau: share of the way that the target network moves, at most 0.5; it is about 1 / tau updates behind.
        loss: whose target network follows.

    Raises:
        ConfigError: tau is no share of at most a half.
    """
    if not 0 < tau <= 0.5:
        raise ConfigError(
            f"target_updater.tau is {tau}; it must be more than 0 and at most 0.5, "
            "and to follow faster there is target_updater=hard"
        )
    return SoftTargetUpdate(loss, tau)
