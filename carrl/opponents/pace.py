"""How fast opponents drive: a share of what is possible, drawn for each of them and each episode.

Shapes: `B` worlds, `M` opponents of each.
"""

from torch import Tensor

from carrl.errors import ConfigError
from carrl.sim.others import Others
from carrl.sim.simulator import CarState
from carrl.task.checks import number


def check_pace(pace: float, spread: float) -> None:
    """Raises ConfigError unless all paces that can be drawn are possible."""
    number("opponents.pace", pace, 0.01, 1, "a share between 0.01 and 1")
    number("opponents.spread", spread, 0, 1, "a share between 0 and 1")
    if spread >= pace:
        raise ConfigError(f"opponents.spread is {spread}; it must be less than the pace, {pace}")


def drawn_pace(pace: float, spread: float, draws: Tensor) -> Tensor:
    """Of each opponent, from a random number in 0..1: [B, M], float32, at most 1."""
    return (pace + spread * (2 * draws - 1)).clamp(max=1.0).float()


def opponents_of(cars: CarState) -> Others:
    """The others of these cars.

    Raises:
        ConfigError: there are none.
    """
    if cars.others is None:
        raise ConfigError("there are no opponents in this state; reset the environment")
    return cars.others


def paces_of(others: Others) -> Tensor:
    """What opponents have drawn, [B, M].

    Raises:
        ConfigError: these are none.
    """
    if others.pace is None:
        raise ConfigError("the others of this state are no opponents; reset the environment")
    return others.pace
