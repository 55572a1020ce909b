"""One part of each kind, none of them CarRL's; README.md says how they are used."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torchrl.objectives import DQNLoss

from carrl.algorithms.common.network import QNetwork
from carrl.algorithms.dqn.loss import make_dqn_loss
from carrl.sim.vehicle import POSE, Vehicle
from carrl.task.observation import Part
from carrl.tracks.centreline import Centreline
from carrl.tracks.track import Track


@dataclass(frozen=True)
class HeavyCar(Vehicle):
    """A car that takes a while to turn: its state has, besides the pose, how far it is turned.

    Attributes:
        inertia: share of the turn of the step before that is kept.
    """

    state_names = (*POSE, "turn")
    inertia: float = 0.3
    kernel = None  # no machine code: torch drives it

    def step(self, state: Tensor, control: Tensor) -> Tensor:
        """The states [N, 4] one step later."""
        turn = self.inertia * state[:, 3:] + (1 - self.inertia) * control
        return torch.cat([super().step(state[:, :3], turn), turn], dim=-1)


@dataclass(frozen=True)
class NearestWall:
    """The shortest reading, as an observation of its own."""

    def part(self, name, sensor, action):
        """One value in 0..1."""
        return Part(name, 1, 0.0, 1.0)

    def __call__(self, context) -> Tensor:
        """As a share of the sensor's range, [N, 1]."""
        return context.ranges.amin(dim=-1, keepdim=True) / context.simulator.sensor.max_range


@dataclass(frozen=True)
class Comfort:
    """A reward that jerks of the steering wheel cost.

    Attributes:
        weight: what a change from one full turn to straight on earns.
    """

    weight: float = -1.0

    def __call__(self, step) -> Tensor:
        """For each car, [N]."""
        return self.weight * (step.control("steer") - step.last_control("steer")).abs()


def make_tanh_network(width: int, *, observation_size: int, action_count: int, generator) -> QNetwork:
    """One hidden layer of so many tanh units."""
    layers = nn.Sequential(nn.Linear(observation_size, width), nn.Tanh(), nn.Linear(width, action_count))
    for parameter in layers.parameters():
        nn.init.uniform_(parameter, -0.1, 0.1, generator=generator)
    return QNetwork(layers)


def make_patient_loss(half_life: int, *, network: QNetwork) -> DQNLoss:
    """Double DQN whose discount halves a reward after so many steps."""
    return make_dqn_loss(0.5 ** (1 / half_life), "l2", double_dqn=True, network=network)


def read_polar(path: str, width: float = 9.0) -> Track:
    """A track from a text file with one radius a line, m, at even angles about the origin."""
    radii = np.loadtxt(path)
    angles = np.linspace(0, 2 * np.pi, len(radii), endpoint=False)
    points = radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    half = np.full(len(points), width / 2)
    return Track.from_centreline("polar", Centreline(points, half, half), gate_spacing=30.0)
