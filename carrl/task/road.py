"""What the driver is told of the road, as a map would tell it: how the car stands to the centreline, what bends follow.

Shapes: `N` cars.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from carrl.config import is_whole_number
from carrl.errors import ConfigError
from carrl.sim.places import Place
from carrl.sim.sensor import Sensor
from carrl.task.action import ActionMap
from carrl.task.checks import number
from carrl.task.episode import ObservationContext
from carrl.task.motion import WIDE, check_unit
from carrl.task.observation import Part

MOST_CURVATURES, MOST_SECONDS = 1000, 3600


class RoadTerm:
    """Needs to know where on the road the car is."""

    needs: ClassVar[tuple[str, ...]] = ("place",)

    @staticmethod
    def _place(context: ObservationContext) -> Place:
        if context.place is None:
            raise ConfigError("a term asks where on the road the car is, which this episode does not keep")
        return context.place


@dataclass(frozen=True)
class HeadingError(RoadTerm):
    """The heading against the direction of the centreline, left positive.

    Attributes:
        unit: what counts as 1, rad.
    """

    unit: float = math.pi

    def __post_init__(self) -> None:
        """Raises ConfigError for a unit that is not positive."""
        check_unit(self.unit, "HeadingError")

    def part(self, name: str, sensor: Sensor, action: ActionMap) -> Part:
        """One value, up to half a turn to either side."""
        most = 1.000001 * math.pi / self.unit  # float32 rounds pi up
        return Part(name, 1, -most, most)

    def __call__(self, context: ObservationContext) -> Tensor:
        """In the unit."""
        return self._place(context).heading_error[:, None] / self.unit


@dataclass(frozen=True)
class TrackPosition(RoadTerm):
    """The offset from the centreline: -1 at the right edge of the road, 0 in the middle, 1 at the left edge."""

    def part(self, name: str, sensor: Sensor, action: ActionMap) -> Part:
        """One value, which is beyond 1 for a car in a wall."""
        return Part(name, 1, -WIDE, WIDE)

    def __call__(self, context: ObservationContext) -> Tensor:
        """By the width of the road on that side."""
        return self._place(context).side[:, None]


@dataclass(frozen=True)
class Curvatures(RoadTerm):
    """How the road bends ahead, at places that the car reaches at its present speed after some seconds.

    Attributes:
        count: of the places.
        from_s: when it reaches the first of them, s.
        spacing_s: from one to the next, s; they are at least 1 m apart, for cars at rest, too.
        radius: of a bend to the left that counts as 1, m.
    """

    count: int = 10
    from_s: float = 1.0
    spacing_s: float = 0.2
    radius: float = 10.0

    def __post_init__(self) -> None:
        """Raises ConfigError for a value out of its range."""
        if not (is_whole_number(self.count) and 1 <= self.count <= MOST_CURVATURES):
            raise ConfigError(
                f"observation: count of Curvatures is {self.count}; it must be a whole number from 1 to "
                f"{MOST_CURVATURES}"
            )
        number("observation: from_s of Curvatures", self.from_s, 0, MOST_SECONDS, f"0 to {MOST_SECONDS} seconds")
        number("observation: spacing_s of Curvatures", self.spacing_s, 0, MOST_SECONDS, f"0 to {MOST_SECONDS} seconds")
        check_unit(self.radius, "Curvatures (its radius)")

    def part(self, name: str, sensor: Sensor, action: ActionMap) -> Part:
        """As many values as places."""
        return Part(name, self.count, -WIDE, WIDE)

    def __call__(self, context: ObservationContext) -> Tensor:
        """The radius over that of the road, left positive, [N, count]."""
        speed = context.value("speed").double().nan_to_num(0, 0, 0)
        places, track = context.simulator.places, context.state.cars.track
        begin, spacing = self.from_s * speed, self.spacing_s * speed
        station = self._place(context).station
        return places.curvatures(track, station, begin, spacing, self.count) * self.radius
