"""What is simulated and what counts: all that an evaluation needs but the policy."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from carrl.sim.sensor import Sensor
from carrl.sim.simulator import Simulator
from carrl.sim.vehicle import VehicleModel
from carrl.task.action import ActionMap, check_fits
from carrl.task.observation import Observation
from carrl.task.reward import Reward
from carrl.task.task import Task
from carrl.tracks.circuits import Circuits
from carrl.tracks.track import Track

SENSOR_SEED = 0
"""Of what a noisy sensor reads in an evaluation, so that the same policy drives the same way again."""


@dataclass(frozen=True)
class World:
    """The parts that make tasks alike, wherever they are driven.

    Attributes:
        circuits: to learn on, and to try networks out on.
        vehicle: the car.
        sensor: its rays.
        action: what an agent chooses among.
        observation: what it is told.
        reward: what a step earns.
    """

    circuits: Circuits
    vehicle: VehicleModel
    sensor: Sensor
    action: ActionMap
    observation: Observation
    reward: Reward

    def __post_init__(self) -> None:
        """Raises ConfigError unless the actions fit the vehicle."""
        check_fits(self.action, self.vehicle)

    @property
    def track(self) -> Track:
        """The first track to learn on: the only one, if there is one."""
        return self.circuits.training[0]

    @property
    def observation_size(self) -> int:
        """Values of an observation."""
        return sum(part.width for part in self.observation.parts(self.sensor, self.action))

    def simulator(self, tracks: Track | Sequence[Track], device: torch.device | str = "cpu") -> Simulator:
        """The car and its rays on these tracks."""
        return Simulator(tracks, self.vehicle, self.sensor, device)

    def evaluation_task(self, simulator: Simulator, cars: int) -> Task:
        """Episodes of so many cars, without a limit of steps."""
        return Task(
            simulator, cars, [SENSOR_SEED], action=self.action, observation=self.observation, reward=self.reward
        )
