"""What the Gymnasium environments take for actions: whole numbers that mean one of the three, and nothing else.

Shapes: `N` cars.
"""

from typing import Any

import numpy as np
from gymnasium.error import InvalidAction

from carrl.errors import ConfigError, shown
from carrl.sim.vehicle import Action

_ACTIONS = "0 forward, 1 left or 2 right"


class ActionError(ConfigError, InvalidAction):
    """Actions that there are none of: CarRL's error and Gymnasium's in one."""


def action_number(action: Any) -> int:
    """One action as an int: of Python, NumPy or torch, also an array or tensor without dimensions, but no bool.

    Raises:
        ActionError: it is something else.
    """
    value = action if type(action) in (int, np.int64) else _scalar(action)
    if not 0 <= value < len(Action):
        raise ActionError(f"action is {shown(action)}; it must be the whole number {_ACTIONS}")
    return int(value)


def action_array(actions: Any, cars: int) -> np.ndarray:
    """The actions of N cars in an array of their own, [N], int64.

    Raises:
        ActionError: they are of another shape or no whole numbers, or there is no such action.
    """
    try:
        given = np.asarray(actions)
    except (TypeError, ValueError) as error:  # such as a tensor on another device, or rows of several lengths
        raise ActionError(f"actions is {shown(actions)}, no array; it must be {_wanted(cars)}") from error
    if given.dtype.kind not in "iu" or given.shape != (cars,):
        raise ActionError(f"actions is an array {list(given.shape)} of {given.dtype}; it must be {_wanted(cars)}")
    if given.min() < 0 or given.max() >= len(Action):
        car = ((given < 0) | (given >= len(Action))).argmax()
        raise ActionError(f"actions[{car}] is {given[car]}; actions must be {_wanted(cars)}")
    return given.astype(np.int64)


def _scalar(action: Any) -> int:
    """A whole number of another type; -1 if it is none."""
    try:
        given = np.asarray(action)
    except (TypeError, ValueError):
        return -1
    return int(given) if given.dtype.kind in "iu" and given.ndim == 0 else -1


def _wanted(cars: int) -> str:
    return f"{cars} numbers in an array [{cars}], each the whole number {_ACTIONS}"
