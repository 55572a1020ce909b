"""Tries a task's terms before anything is built upon them, so that one that fails is named.

Shapes: `N` cars.
"""

import math
import traceback
from collections.abc import Callable
from typing import Any

from torch import Tensor

from carrl.errors import ConfigError, shown
from carrl.task.episode import ObservationContext
from carrl.task.random_streams import RandomStreams
from carrl.task.task import Task


def try_terms(task: Task) -> None:
    """Tries every term on two cars at a track's start, or on whole worlds, with random numbers of its own.

    Raises:
        ConfigError: a term fails, or its value has another shape than it should, or one that is not finite or, of an
            observation, outside of its bounds.
    """
    simulator, cars = task.simulator, task.trial_cars(RandomStreams([0], task.cars))
    state, place = task.begin_at(cars)
    count = len(state.step)
    ranges, streams = simulator.sense(state.cars), RandomStreams([0], count)
    seen = ObservationContext(state, ranges, simulator, task.action, streams, place=place)
    for part, (name, term) in zip(task.observation_parts, task.observation.terms.items(), strict=True):
        _check_value(f"observation.{name}", term, seen, (count, part.width), part.low, part.high)
    step = task.drive(state, state.last_action)
    for name, earns in task.reward.terms.items():
        _check_value(f"reward.{name}", earns, step, (count,), -math.inf, math.inf)
    for name, ends in task.end.terms.items():
        _check_value(f"end.{name}", ends, step, (count,), 0, 1)


def _check_value(
    name: str, term: Callable[..., Tensor], context: Any, shape: tuple[int, ...], low: float, high: float
) -> None:
    try:
        value = term(context)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from error
    except Exception as error:  # of a person's own code
        place = traceback.extract_tb(error.__traceback__)[-1]
        raise ConfigError(f"{name}: {type(error).__name__}: {error} ({place.filename}:{place.lineno})") from error
    wanted = "[N]" if len(shape) == 1 else f"[N, {shape[1]}]"
    found = list(value.shape) if isinstance(value, Tensor) else f"of type {type(value).__name__}"
    if found != list(shape):
        raise ConfigError(f"{name} gives {found} for {shape[0]} cars; it must give a tensor {wanted} for N cars")
    if not ((value >= low) & (value <= high) & value.isfinite()).all():
        values = shown(value.flatten().tolist())
        raise ConfigError(f"{name} gives {values}; its values must be finite and lie in {low}..{high}")
