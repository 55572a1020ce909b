"""When the target network follows the trained one."""

from torchrl.objectives import DQNLoss, HardUpdate

from carrl.errors import ConfigError


def make_hard_update(period: int, *, loss: DQNLoss) -> HardUpdate:
    """Copies the network into the target network at every `period`-th call of `step`: calls C, 2C, 3C and so on.

    TorchRL 0.14's `HardUpdate(value_network_update_interval=n)` copies at every n+1-th call, hence the minus one;
    `test_target_network_changes_exactly_at_steps_c_2c_3c` pins it.

    Source: the paper, Algorithm 1 and Table I (C).

    Raises:
        ConfigError: the period is less than 1.
    """
    if period < 1:
        raise ConfigError(f"target_updater.period is {period}; it must be at least 1 env step")
    return HardUpdate(loss, value_network_update_interval=period - 1)
