"""What a person does at the keyboard or with a gamepad, as actions: of three names, or numbers of a car with pedals."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from carrl.errors import ConfigError
from carrl.task.action import ActionMap

if TYPE_CHECKING:
    import pygame

TURN, CENTRE = 2.0, 4.0
"""How fast a key held turns the wheel, and how fast it comes back, full turns to one side per second."""
DEAD_ZONE = 0.08
"""Of a stick: nearer to its middle it is in the middle."""
STEERING_AXIS, THROTTLE_AXIS, BRAKE_AXIS, XBOX_BRAKE_AXIS = 0, 5, 4, 2
"""Of SDL's joysticks: the left stick and the triggers; the left trigger of Xbox pads has a number of its own."""
CONTROLS = ("steer", "pedal", "throttle", "brake", "speed")
"""That a person can use."""


class Driver(Protocol):
    """Hears of events and says what to do."""

    @property
    def help(self) -> Sequence[str]:
        """What the keys do, a line each; a tab parts key and meaning."""

    def take(self, event: "pygame.event.Event") -> bool:
        """Heeds an event; whether it was one that drives."""

    def next_action(self) -> Any:
        """Of the next step, as the environment takes it."""


class KeysDriver:
    """Left, right and straight on, as actions of these names.

    Raises:
        ConfigError: there are no such actions.
    """

    help: Sequence[str] = (
        "left, A\tturn left",
        "right, D\tturn right",
        "no key\tstraight on",
    )

    def __init__(self, actions: ActionMap) -> None:
        import pygame

        self._straight_on, left, right = (_action_named(actions, name) for name in ("forward", "left", "right"))
        self._steering = {
            pygame.K_UP: self._straight_on,
            pygame.K_LEFT: left,
            pygame.K_a: left,
            pygame.K_RIGHT: right,
            pygame.K_d: right,
        }
        self._held: list[int] = []
        self._tapped: int | None = None

    def take(self, event: "pygame.event.Event") -> bool:
        """Heeds the keys that steer."""
        import pygame

        if event.type not in (pygame.KEYDOWN, pygame.KEYUP) or event.key not in self._steering:
            return False
        action = self._steering[event.key]
        if event.type == pygame.KEYUP:
            self._held = [held for held in self._held if held != action]
            return False
        self._tapped = action
        self._held.append(action)
        return True

    def next_action(self) -> int:
        """The key pressed last of those still held; a key that was only tapped counts for one step."""
        action = self._held[-1] if self._held else self._tapped
        self._tapped = None
        return self._straight_on if action is None else action


class PedalsDriver:
    """A wheel that turns while a key is held, and pedals; or the stick and triggers of a gamepad.

    Args:
        control_names: of the car, in the order of its actions.
        time_step: of the car, s.

    Raises:
        ConfigError: a person cannot use one of the controls.
    """

    help: Sequence[str] = (
        "left, right\tsteer; or A and D, or the left stick",
        "up\taccelerate; or W, or the right trigger",
        "down\tbrake; or S, or the left trigger",
    )

    def __init__(self, control_names: Sequence[str], time_step: float) -> None:
        import pygame

        unknown = [name for name in control_names if name not in CONTROLS]
        if unknown:
            raise ConfigError(
                f"the car has the control {unknown[0]!r}, which no key moves; cars with {', '.join(CONTROLS)} can be "
                "driven by hand"
            )
        self._names, self._time_step = tuple(control_names), time_step
        self._keys = {
            **dict.fromkeys((pygame.K_LEFT, pygame.K_a), "left"),
            **dict.fromkeys((pygame.K_RIGHT, pygame.K_d), "right"),
            **dict.fromkeys((pygame.K_UP, pygame.K_w), "throttle"),
            **dict.fromkeys((pygame.K_DOWN, pygame.K_s), "brake"),
        }
        self._held: set[str] = set()
        self._tapped: set[str] = set()
        self._wheel = 0.0
        self._axes = {"steer": 0.0, "throttle": 0.0, "brake": 0.0}
        self._pads: list[Any] = []
        pygame.joystick.init()
        for index in range(pygame.joystick.get_count()):
            self._add_pad(index)

    def take(self, event: "pygame.event.Event") -> bool:
        """Heeds keys, sticks and triggers, and gamepads that are plugged in."""
        import pygame

        if event.type == pygame.JOYDEVICEADDED:
            self._add_pad(event.device_index)
        elif event.type == pygame.JOYAXISMOTION:
            return self._take_axis(event)
        elif event.type == pygame.KEYDOWN and event.key in self._keys:
            self._held.add(self._keys[event.key])
            self._tapped.add(self._keys[event.key])
            return True
        elif event.type == pygame.KEYUP and event.key in self._keys:
            self._held.discard(self._keys[event.key])
        return False

    def next_action(self) -> np.ndarray:
        """A number for each control, [C], float32; a key that was only tapped counts for one step."""
        pressed, self._tapped = self._held | self._tapped, set()
        self._wheel = self._turned(("left" in pressed) - ("right" in pressed))
        throttle, brake = (max(float(pedal in pressed), self._axes[pedal]) for pedal in ("throttle", "brake"))
        controls = {
            "steer": self._axes["steer"] or self._wheel,
            "pedal": throttle - brake,
            "throttle": 2 * throttle - 1,
            "brake": 2 * brake - 1,
            "speed": throttle - brake,
        }
        return np.array([controls[name] for name in self._names], dtype=np.float32)

    def _turned(self, side: int) -> float:
        """The wheel a step later: turned on to a side, 1 is left, or back towards the middle."""
        if side:
            back = CENTRE - TURN if side * self._wheel < 0 else 0.0
            return float(np.clip(self._wheel + side * (TURN + back) * self._time_step, -1, 1))
        way = CENTRE * self._time_step
        return 0.0 if abs(self._wheel) <= way else self._wheel - np.sign(self._wheel) * way

    def _take_axis(self, event: "pygame.event.Event") -> bool:
        """A stick to the left is below 0; a trigger is at -1 where it is released."""
        pads = {pad.get_instance_id(): pad.get_name() for pad in self._pads}
        name = pads.get(getattr(event, "instance_id", None), "")
        brake_axis = XBOX_BRAKE_AXIS if "xbox" in name.lower().replace("-", "") else BRAKE_AXIS
        if event.axis == STEERING_AXIS:
            self._axes["steer"] = 0.0 if abs(event.value) < DEAD_ZONE else -float(np.clip(event.value, -1, 1))
            return bool(self._axes["steer"])
        if event.axis in (THROTTLE_AXIS, brake_axis):
            pedal, down = "throttle" if event.axis == THROTTLE_AXIS else "brake", (event.value + 1) / 2
            self._axes[pedal] = 0.0 if down < DEAD_ZONE else float(min(down, 1.0))
            return bool(self._axes[pedal])
        return False

    def _add_pad(self, index: int) -> None:
        import pygame

        self._pads.append(pygame.joystick.Joystick(index))


def driver_of(actions: ActionMap, time_step: float) -> Driver:
    """What drives a car with these actions.

    Raises:
        ConfigError: a person cannot.
    """
    return KeysDriver(actions) if actions.names else PedalsDriver(actions.control_names, time_step)


def _action_named(actions: ActionMap, name: str) -> int:
    names = list(actions.names)
    if name not in names:
        raise ConfigError(f"the run's car has no action '{name}' ({', '.join(names)}); drive another")
    return names.index(name)
