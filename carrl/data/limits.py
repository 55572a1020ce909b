"""What every collector may be asked for."""

from carrl.errors import ConfigError

MOST_STEPS = 2**16


def check_steps(steps_per_batch: int) -> None:
    """Raises ConfigError where a batch has no steps, or too many."""
    if not 1 <= steps_per_batch <= MOST_STEPS:
        raise ConfigError(
            f"collector.steps_per_batch is {steps_per_batch}; it must be at least 1 and at most {MOST_STEPS}"
        )
