"""Drives a policy on many tracks, from many places each, some tracks at a time so that memory stays bounded."""

from collections.abc import Iterator, Sequence

from carrl.evaluation.rollout import Drive, Policy, drive
from carrl.task.world import World
from carrl.tracks.track import Track

CARS_AT_ONCE = 256
"""As many tracks are driven together as this many cars allow, but at least one."""


class Survey:
    """Laps of several tracks with the car, sensors and reward of a world.

    Args:
        world: that says how a car drives; its own tracks do not matter.
        tracks: to be driven.
        starts: places on each track, spread evenly from its start line on.
    """

    def __init__(self, world: World, tracks: Sequence[Track], starts: int) -> None:
        self._world, self._starts = world, starts
        together = max(1, CARS_AT_ONCE // max(1, starts))
        groups = [tracks[begin : begin + together] for begin in range(0, len(tracks), together)]
        self._simulators = [world.simulator(group) for group in groups]

    def drive(self, policy: Policy, world: World | None = None) -> list[list[Drive]]:
        """The drives of each track; a policy that sees something else needs a world of its own, with the same car.

        Raises:
            ConfigError: fewer than one start place.
        """
        return list(self._drives(policy, world or self._world))

    def _drives(self, policy: Policy, world: World) -> Iterator[list[Drive]]:
        for simulator in self._simulators:
            drives = drive(world, simulator, policy, self._starts)
            for begin in range(0, len(drives), self._starts):
                yield drives[begin : begin + self._starts]
