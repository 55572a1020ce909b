"""The one line that says that a road does not suit the car that is to drive it."""

import sys
from collections.abc import Sequence

from carrl.printable import printable
from carrl.sim.drivability import Car, unsuitable
from carrl.task.task import World
from carrl.tracks.centreline import gap_of
from carrl.tracks.track import Track


def warn_of_roads(tracks: Sequence[Track], world: World) -> None:
    """Prints one line on standard error if any of the tracks does not suit the car, with what is wrong of the first."""
    threshold = world.reward.near_wall.threshold if world.reward.near_wall.weight else 0.0
    car = Car.of(world.vehicle, world.sensor, threshold)
    found = [(track, phrases) for track in tracks if (phrases := _phrases(track, car))]
    if not found:
        return
    (first, phrases), count = found[0], len(tracks)
    subject = f"track '{first.name}' does" if count == 1 else f"{len(found)} of {count} tracks do"
    place = "" if count == 1 else f"track '{first.name}': "
    print(
        printable(
            f"warning: {subject} not suit the car; {place}{'; '.join(phrases)}; set vehicle.turn_radius, "
            "vehicle.body_radius, vehicle.speed and sensor.max_range to its size, see carrl track check"
        ),
        file=sys.stderr,
    )


def _phrases(track: Track, car: Car) -> list[str]:
    gap = gap_of(track.centreline.double().numpy())
    return [*([] if gap is None else [gap]), *unsuitable(track, car)]
