"""What the Gymnasium environments take for actions: those of the action map, and nothing that only looks like one.

Shapes: `N` cars, `C` controls.
"""

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.error import InvalidAction
from torch import Tensor

from carrl.errors import ConfigError, shown
from carrl.task.action import ActionMap, in_words


class ActionError(ConfigError, InvalidAction):
    """Actions that there are none of: CarRL's error and Gymnasium's in one."""


def action_space(actions: ActionMap) -> gymnasium.Space[Any]:
    """Of one car: discrete, or a number for each control."""
    if actions.names:
        return gymnasium.spaces.Discrete(len(actions.names))
    return gymnasium.spaces.Box(-1.0, 1.0, (len(actions.control_names),), np.float32)


def one_action(action: Any, actions: ActionMap) -> Tensor:
    """The action of one car, [1] or [1, C]: of Python, NumPy or torch, but no bool.

    Raises:
        ActionError: there is no such action.
    """
    if type(action) in (int, np.int64):  # the usual case, quickly
        given = np.array([action])
    else:
        try:
            given = np.asarray(action)[None]
        except (TypeError, ValueError):
            given = np.array(None)
    if not _is_action(given, (1,), actions).all():
        raise ActionError(f"action is {shown(action)}; it must be {_wanted(actions)}")
    return _as_tensor(given, actions)


def many_actions(given: Any, cars: int, actions: ActionMap) -> Tensor:
    """A copy of the actions of N cars, [N] or [N, C].

    Raises:
        ActionError: they are of another shape or type, or there is no such action.
    """
    try:
        array = np.asarray(given)
    except (TypeError, ValueError) as error:  # such as a tensor on another device, or rows of several lengths
        raise ActionError(f"actions is {shown(given)}, no array; it must be {_all_wanted(cars, actions)}") from error
    are_actions = _is_action(array, (cars,), actions)
    if not are_actions.shape:
        raise ActionError(
            f"actions is an array {list(array.shape)} of {array.dtype}; it must be {_all_wanted(cars, actions)}"
        )
    if not are_actions.all():
        car = are_actions.argmin()
        raise ActionError(f"actions[{car}] is {array[car]}; actions must be {_all_wanted(cars, actions)}")
    return _as_tensor(array, actions)


def _is_action(given: np.ndarray, cars: tuple[int], actions: ActionMap) -> np.ndarray:
    """Which of the cars have an action, [N]; a single False where they are of another shape or type."""
    if actions.names:
        fits = given.dtype.kind in "iu" and given.shape == cars
        return (given >= 0) & (given < len(actions.names)) if fits else np.array(False)
    fits = given.dtype.kind in "iuf" and given.shape == (*cars, len(actions.control_names))
    return (np.abs(given) <= 1).all(axis=-1) if fits else np.array(False)  # nan fails it, too


def _as_tensor(given: np.ndarray, actions: ActionMap) -> Tensor:
    return torch.from_numpy(given.astype(np.int64 if actions.names else np.float32))


def _wanted(actions: ActionMap) -> str:
    return f"the whole number {in_words(actions)}" if actions.names else in_words(actions)


def _all_wanted(cars: int, actions: ActionMap) -> str:
    shape = [cars] if actions.names else [cars, len(actions.control_names)]
    return f"{cars} numbers in an array {shape}, each {_wanted(actions)}"
