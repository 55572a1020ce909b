"""Action maps: what an agent chooses among, and which controls of the vehicle that means.

Shapes: `N` cars, `C` controls, `A` discrete actions.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import torch
from torch import Tensor
from torchrl.data import Bounded, Categorical, TensorSpec

from carrl.errors import ConfigError, shown
from carrl.sim.vehicle import VehicleModel


class ActionMap(Protocol):
    """From the actions of N agents to the controls of their cars."""

    @property
    def names(self) -> Sequence[str]:
        """What the actions are called; none where they are numbers."""

    @property
    def control_names(self) -> Sequence[str]:
        """Of the controls that it sets, C of them, in their order."""

    @property
    def spec(self) -> TensorSpec:
        """Of one car's action: `Categorical`, or `Bounded` for floats."""

    @property
    def features(self) -> int:
        """Values that `encode` makes of an action."""

    @property
    def first(self) -> Tensor:
        """What counts as the action before the first one of an episode; of the spec's shape and type."""

    def controls(self, action: Tensor) -> Tensor:
        """The controls [N, C], float32, each in [-1, 1]; of actions [N, ...] within the spec."""

    def encode(self, action: Tensor) -> Tensor:
        """An action as a network may read it, [N, `features`], float32."""


@dataclass(frozen=True)
class DiscreteActions:
    """Some actions, each of which is one setting of the controls.

    Attributes:
        names: what the actions are called, A of them; the first one counts as the one before an episode's first.
        settings: for each control of the vehicle its value in every action, A numbers in [-1, 1].
    """

    names: Sequence[str]
    settings: Mapping[str, Sequence[float]]

    def __post_init__(self) -> None:
        """Raises ConfigError unless there are actions, of different names, each with a value for every control."""
        if not self.names or len(set(self.names)) < len(self.names):
            raise ConfigError(f"action.names is {list(self.names)}; it must name at least one action, none twice")
        for control, values in self.settings.items():
            if len(values) != len(self.names) or not all(_is_setting(value) for value in values):
                raise ConfigError(
                    f"action.settings.{control} is {list(values)}; it must have a number within -1 and 1 "
                    f"for each of {', '.join(self.names)}"
                )

    @property
    def control_names(self) -> Sequence[str]:
        """Of the settings."""
        return tuple(self.settings)

    @cached_property
    def spec(self) -> TensorSpec:
        """Indices into `names`."""
        return Categorical(len(self.names), dtype=torch.int64)

    @property
    def features(self) -> int:
        """As many as there are actions."""
        return len(self.names)

    @property
    def first(self) -> Tensor:
        """The first one."""
        return torch.tensor(0)

    def controls(self, action: Tensor) -> Tensor:
        """The settings of the actions [N], int64.

        Raises:
            IndexError: there is no such action.
        """
        return self._table.to(action.device).index_select(0, action)

    def encode(self, action: Tensor) -> Tensor:
        """One-hot."""
        return (action[:, None] == torch.arange(len(self.names), device=action.device)).float()

    @cached_property
    def _table(self) -> Tensor:
        return torch.tensor(list(zip(*self.settings.values(), strict=True)), dtype=torch.float32)


@dataclass(frozen=True)
class ContinuousActions:
    """Every control on its own, as a number within -1 and 1.

    Attributes:
        control_names: of the vehicle's controls, C of them; none: all that it has, as `fitted` finds out.
        ranges: the values of some controls that the numbers -1 and 1 stand for; of the others -1 and 1 themselves.
    """

    control_names: Sequence[str] = ()
    ranges: Mapping[str, Sequence[float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raises ConfigError for a range that is none, or of a control that is not among those named."""
        for control, values in self.ranges.items():
            if not (isinstance(values, Sequence) and len(values) == 2 and all(map(_is_setting, values))):
                raise ConfigError(
                    f"action.ranges.{control} is {shown(values)}; it must be two numbers within -1 and 1, such as "
                    "[0.0, 0.5]"
                )
            if values[0] >= values[1]:
                raise ConfigError(f"action.ranges.{control} is {list(values)}; the first number must be the lower one")
            if self.control_names and control not in self.control_names:
                raise ConfigError(
                    f"action.ranges has {control!r}; the vehicle is controlled by {', '.join(self.control_names)}"
                )

    @property
    def names(self) -> Sequence[str]:
        """None."""
        return ()

    @cached_property
    def spec(self) -> TensorSpec:
        """Within -1 and 1, [C]."""
        return Bounded(-1.0, 1.0, shape=(len(self.control_names),), dtype=torch.float32)

    @property
    def features(self) -> int:
        """As many as there are controls."""
        return len(self.control_names)

    @property
    def first(self) -> Tensor:
        """All at 0."""
        return torch.zeros(len(self.control_names))

    def controls(self, action: Tensor) -> Tensor:
        """The actions [N, C], cut off at -1 and 1, in the ranges of their controls."""
        action = action.clamp(-1, 1)
        if not self.ranges:
            return action
        low, high = self._bounds.to(action)
        return low + (high - low) * (action + 1) / 2

    @cached_property
    def _bounds(self) -> Tensor:
        """What -1 and 1 stand for, [2, C]."""
        return torch.tensor([self.ranges.get(name, (-1.0, 1.0)) for name in self.control_names]).T

    def encode(self, action: Tensor) -> Tensor:
        """The action itself."""
        return action


def make_table(settings: Mapping[str, Sequence[float]]) -> DiscreteActions:
    """Every combination of some settings of each control, the first of each first, named such as `left_brake`.

    Args:
        settings: for each control of the vehicle the values that it can have, in [-1, 1].

    Raises:
        ConfigError: a control has no value, one that is out of its range, or one twice.
    """
    for control, values in settings.items():
        if not values or len(set(values)) < len(values) or not all(_is_setting(value) for value in values):
            raise ConfigError(
                f"action.settings.{control} is {list(values)}; it must be numbers within -1 and 1, at least one, none "
                "twice"
            )
    rows = list(itertools.product(*settings.values()))
    names = ["_".join(map(_setting_name, settings, row)) for row in rows]
    return DiscreteActions(names, {control: [row[place] for row in rows] for place, control in enumerate(settings)})


_WORDS = {"steer": ("right", "straight", "left"), "pedal": ("brake", "coast", "drive")}
"""What a control does below 0, at 0 and above."""


def _setting_name(control: str, value: float) -> str:
    """Such as left, or left_30 for three tenths of it."""
    below, middle, above = _WORDS.get(control, (f"{control}_minus", f"{control}_0", control))
    if value == 0:
        return middle
    share = abs(round(100 * value))
    return (below if value < 0 else above) + ("" if share == 100 else f"_{share}")


def steer3() -> DiscreteActions:
    """The paper's: straight on, full left, full right."""
    return DiscreteActions(("forward", "left", "right"), {"steer": (0.0, 1.0, -1.0)})


def in_words(actions: ActionMap) -> str:
    """What an action may be, such as "0 forward, 1 left or 2 right"."""
    if not actions.names:
        return f"a number within -1 and 1 for each of {', '.join(actions.control_names)}"
    *others, last = (f"{number} {name}" for number, name in enumerate(actions.names))
    return f"{', '.join(others)} or {last}" if others else last


def fitted(action: ActionMap, vehicle: VehicleModel) -> ActionMap:
    """The actions with all controls of the vehicle, if they name none.

    Raises:
        ConfigError: they do not set just those that the vehicle has.
    """
    if isinstance(action, ContinuousActions) and not action.control_names:
        return replace(action, control_names=vehicle.control_names)
    check_fits(action, vehicle)
    return action


def check_fits(action: ActionMap, vehicle: VehicleModel) -> None:
    """Raises ConfigError unless the actions set just the controls that the vehicle has, in their order."""
    names = tuple(action.control_names)
    if names != vehicle.control_names:
        raise ConfigError(
            f"action sets {', '.join(names) or 'nothing'}; the vehicle {type(vehicle).__name__} is controlled by "
            f"{', '.join(vehicle.control_names)}, in this order{_remedy(action, vehicle)}"
        )


def _remedy(action: ActionMap, vehicle: VehicleModel) -> str:
    """The rest of a sentence that says how a car with pedals is controlled, to one who chose to steer alone."""
    if not action.names or len(vehicle.control_names) == 1:
        return ""
    return "; set action=continuous where the algorithm allows it, or action=table with action.settings of these"


def _is_setting(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and -1 <= value <= 1
