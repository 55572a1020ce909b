"""Worlds of the paper, to drive and search in."""

from typing import Any

from carrl.env.action import steer3
from carrl.env.observation import rays_only
from carrl.env.reward import paper_reward
from carrl.env.world import World
from carrl.sim.circuits import Circuits
from carrl.sim.sensor import Sensor
from carrl.sim.track import Track
from carrl.sim.vehicle import Vehicle


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
