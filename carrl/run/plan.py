"""What a run is to do: how long, and how often it is evaluated."""

from dataclasses import dataclass

from carrl.errors import ConfigError


@dataclass(frozen=True)
class Limits:
    """When a run ends.

    Attributes:
        episodes: once this many have ended.
        frames: once this many env steps are done.
    """

    episodes: int
    frames: int

    def __post_init__(self) -> None:
        """Raises ConfigError unless both allow at least one."""
        for name, value in vars(self).items():
            if value < 1:
                raise ConfigError(f"trainer.{name} is {value}; it must be at least 1")


@dataclass(frozen=True)
class EvaluationPlan:
    """How often the greedy policy is tried out.

    Attributes:
        interval: env steps between two greedy drives on the training track.
    """

    interval: int

    def __post_init__(self) -> None:
        """Raises ConfigError unless the interval is positive."""
        if self.interval < 1:
            raise ConfigError(f"evaluation.interval is {self.interval}; it must be at least 1 env step")
