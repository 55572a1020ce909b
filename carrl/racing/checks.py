"""Whether a minimum lap deserves its name: figures that would tell if it were not, each with its limit.

Units: m, s.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from carrl.racing.minimum_lap import STARTS, MinimumLap, checked_car, minimum_lap, point_mass_lap
from carrl.racing.replay import drifts
from carrl.racing.speed_profile import forward_backward

if TYPE_CHECKING:
    from carrl.sim.vehicle import VehicleModel
    from carrl.tracks.track import Track

GRIDS, PROFILE, SAME = 0.001, 0.005, 0.001
"""Greatest differences of lap times, as shares: of two grids, of another method, of other starts."""
AT_GRIP, AT_WALLS = 0.05, 0.01
"""Least shares of the time at the limit of grip, and at a wall."""
DRIFT, DISTANCE, DRIVES = 0.02, 5.0, 10
"""How far the simulator's car may be from the line, as a share of the distance driven open loop; over how many lengths
of the car, and from how many places."""


@dataclass(frozen=True)
class Check:
    """One of them.

    Attributes:
        name: what is looked at.
        value: that was found.
        limit: that it must not exceed, or not fall below.
        passed: whether it is so.
        says: the figures, for people.
    """

    name: str
    value: float
    limit: float
    passed: bool
    says: str


def check_lap(track: "Track", vehicle: "VehicleModel", lap: MinimumLap) -> list[Check]:
    """The checks of a car's minimum lap; those of grip are left out for linear tyres, whose grip has no limit.

    Raises:
        CarrlError: one of the other laps was not found.
    """
    car = checked_car(vehicle)
    finer = minimum_lap(track, car, lap.spacing / 2, lap.margin, coarser=lap)
    checks = [
        _at_most("two grids", abs(finer.lap_time / lap.lap_time - 1), GRIDS, f"{finer.lap_time:.3f} s on half the grid")
    ]
    if car.tyre == "brush":
        mass = point_mass_lap(track, car, lap.spacing, lap.margin)
        profile = forward_backward(mass.line, car)
        says = f"point mass {mass.lap_time:.3f} s, forward and backward along its line {profile:.3f} s"
        checks.append(_at_most("another method", abs(profile / mass.lap_time - 1), PROFILE, says))
        checks.append(_at_least("grip", lap.at_grip_limit or 0.0, AT_GRIP, "of the time at the limit of grip"))
    checks.append(_at_least("walls", lap.at_walls, AT_WALLS, "of the time at a wall"))
    others = [minimum_lap(track, car, lap.spacing, lap.margin, start).lap_time for start in STARTS[1:]]
    apart = max(abs(other / lap.lap_time - 1) for other in others)
    says = ", ".join(f"from the {start} {other:.3f} s" for start, other in zip(STARTS[1:], others, strict=True))
    checks.append(_at_most("three starts", apart, SAME, says))
    driven = drifts(finer.line, car, DISTANCE * car.length, DRIVES)
    worst = max(each.apart for each in driven)
    says = f"{worst:.3f} m apart at the most after {driven[0].distance:.3g} m open loop in the simulator"
    checks.append(_at_most("replay", worst / driven[0].distance, DRIFT, says))
    return checks


def _at_most(name: str, value: float, limit: float, says: str) -> Check:
    return Check(name, value, limit, value <= limit, says)


def _at_least(name: str, value: float, limit: float, says: str) -> Check:
    return Check(name, value, limit, value >= limit, says)
