"""Follow-the-gap: a driver by rule that steers for the deepest gap beside the nearest wall, as F1TENTH racers do.

Shapes: `B` cars, `R` rays, `W` rays that look ahead.
"""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional

from carrl.errors import ConfigError
from carrl.evaluation.rollout import Policy
from carrl.sim.driven import DrivenCar
from carrl.sim.sensor import Sensor
from carrl.task.action import ContinuousActions
from carrl.task.observation import rays_only
from carrl.task.task import World

BEAM = 4.7 / 1079
"""Angle between neighbours of the 1,080 beams of the survey's scanner, rad."""
AHEAD, BUBBLE, LEAST_GAP = 405, 160, 5
"""Beams on either side of the heading that count; that are closed on either side of the nearest wall; and that a gap
must have more of."""
SMOOTHED, AVERAGED = 3, 80
"""Beams of the means of which the nearest wall is taken, and the deepest point of the gap."""
FURTHEST = 10.0
"""What lies further off counts as so far, m."""
GAIN = math.pi / 1080 / BEAM
"""Share of the direction of the deepest point that the wheels turn: half, of the angle that it would be at if the beams
went all the way round, as the survey has it."""
MOST_STEERING = 0.4
"""rad."""
CORNER, CORNER_SPEED, SPEED = 0.174, 3.0, 5.0
"""With the wheels turned further than so much, rad, it drives slower, m/s."""


def follow_the_gap_of(world: World) -> tuple[World, Policy]:
    """The driver for a world's car and sensor: the world as it sees it, and what it does there.

    Raises:
        ConfigError: the car is not told a steering angle and a speed, or no ray looks ahead.
    """
    vehicle = world.vehicle
    if vehicle.control_names != ("steer", "speed") or not isinstance(vehicle, DrivenCar):
        raise ConfigError(
            "follow_the_gap tells a car how far to steer and how fast to drive; this one has "
            f"{', '.join(vehicle.control_names)}. Choose vehicle=single_track vehicle.preset=f1tenth"
        )
    if not looks_ahead(world.sensor).any():
        raise ConfigError("follow_the_gap needs rays that look ahead; change sensor.turn or sensor.field_of_view")
    driver = FollowTheGap(world.sensor, vehicle.max_steering, vehicle.max_speed)
    return replace(world, observation=rays_only(), action=ContinuousActions(vehicle.control_names)), driver


@dataclass(frozen=True)
class FollowTheGap:
    """Closes what is near the nearest wall, and steers for the deepest point of what is left.

    Where there is a gap on both sides of it, the left one is taken. The numbers above are the survey's, of its scanner;
    with another one they stand for the same angles.

    Attributes:
        sensor: of the car.
        max_steering: of its front wheels, rad.
        max_speed: m/s.

    Source: Sezer and Gokasan 2012, "A novel obstacle avoidance algorithm: Follow the Gap Method"; with the numbers of
    Evans et al. 2024, "Unifying F1TENTH Autonomous Racing: Survey, Methods and Benchmarks".
    """

    sensor: Sensor
    max_steering: float
    max_speed: float

    def __call__(self, readings: Tensor) -> Tensor:
        """Steering and speed as shares of the car's, [B, 2], of the rays' readings, [B, R]."""
        bubble, least = self._rays(BUBBLE), self._rays(LEAST_GAP)
        ahead = looks_ahead(self.sensor)
        ranges = _means(readings[:, ahead] * self.sensor.max_range, max(1, self._rays(SMOOTHED)))
        ranges = ranges.clamp(max=FURTHEST)
        nearest = ranges.argmin(dim=1, keepdim=True)
        beam = torch.arange(ranges.shape[1], device=ranges.device)
        left, right = beam >= nearest + bubble, beam < nearest - bubble
        gap = torch.where(left.sum(dim=1, keepdim=True) > least, left, right)
        depths = _means(torch.where(gap, ranges, 0.0), max(1, self._rays(AVERAGED)))
        best = torch.where(gap, depths, -1.0).argmax(dim=1)
        angle = GAIN * self.sensor.angles.to(ranges)[ahead][best]
        steering = angle.clamp(-MOST_STEERING, MOST_STEERING)
        speed = torch.where(steering.abs() > CORNER, CORNER_SPEED, SPEED)
        return torch.stack([steering / self.max_steering, speed / self.max_speed], dim=1)

    def _rays(self, beams: int) -> int:
        """So many beams of the survey's scanner, in rays of this sensor."""
        if self.sensor.rays == 1:
            return 0
        return round(beams * BEAM * (self.sensor.rays - 1) / math.radians(self.sensor.field_of_view))


def looks_ahead(sensor: Sensor) -> Tensor:
    """Which of its rays count, [R], bool."""
    return sensor.angles.abs() < AHEAD * BEAM


def _means(ranges: Tensor, count: int) -> Tensor:
    """Means of so many neighbours, [B, W]; there is nothing, 0, beyond the ends."""
    padded = functional.pad(ranges, (count // 2, (count - 1) // 2))
    return functional.avg_pool1d(padded[:, None], count, stride=1)[:, 0]
