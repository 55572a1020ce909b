"""Drives a policy on many tracks, from many places each, some tracks at a time so that memory stays bounded."""

from collections.abc import Iterator, Sequence

from carrl.run.build import World
from carrl.run.evaluation import Drive, Policy, drive
from carrl.sim.simulator import Simulator
from carrl.sim.track import Track

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
        self._reward, self._starts = world.reward, starts
        together = max(1, CARS_AT_ONCE // max(1, starts))
        groups = [tracks[begin : begin + together] for begin in range(0, len(tracks), together)]
        self._simulators = [Simulator(group, world.vehicle, world.sensor) for group in groups]

    def drive(self, policy: Policy) -> list[list[Drive]]:
        """The drives of each track.

        Raises:
            ConfigError: fewer than one start place.
        """
        return list(self._drives(policy))

    def _drives(self, policy: Policy) -> Iterator[list[Drive]]:
        for simulator in self._simulators:
            drives = drive(simulator, self._reward, policy, self._starts)
            for begin in range(0, len(drives), self._starts):
                yield drives[begin : begin + self._starts]
