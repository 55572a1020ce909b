"""Worlds of the paper, to drive and search in."""

from typing import Any

from carrl.sim.sensor import Sensor
from carrl.sim.vehicle import Vehicle
from carrl.task.action import steer3
from carrl.task.observation import rays_only
from carrl.task.reward import paper_reward
from carrl.task.task import World
from carrl.tracks.circuits import Circuits
from carrl.tracks.track import Track


def make_world(track: Track | str = "paper", **parts: Any) -> World:
    """A track, and the paper's car, sensor, actions, observation and reward, but for the `parts` given."""
    track = track if isinstance(track, Track) else Track.load(track)
    usual = {
        "vehicle": Vehicle(),
        "sensor": Sensor(max_range=10.0),
        "action": steer3(),
        "observation": rays_only(),
        "reward": paper_reward(),
    }
    return World(circuits=Circuits.only(track), **{**usual, **parts})
