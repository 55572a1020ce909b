"""F1TENTH's own simulator on a map of a track, one car at a time, as `scripts/bench sim` measures it.

Of f1tenth_gym, which is not on PyPI: https://github.com/f1tenth/f1tenth_gym; its folder `gym` has to be on PYTHONPATH,
with the packages gym and pyglet that it imports.
"""

import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from carrl.sim.sensor import Sensor
from carrl.sim.single_track import SingleTrack
from carrl.tracks import ros_map
from carrl.tracks.track import Track

RESOLUTION = 0.05
"""m a pixel, as of its own maps."""


def make_drive(
    track: Track, pose: Tensor, vehicle: SingleTrack, sensor: Sensor, whole: bool
) -> Callable[[float, float], None]:
    """A function of a steering angle, rad, and a speed, m/s, that drives the car on, and back to its pose at a wall.

    Args:
        track: whose walls are drawn on its map.
        pose: where it begins, x m, y m, heading rad, [3].
        vehicle: whose parameters it has.
        sensor: whose rays it casts.
        whole: whether its environment is stepped; else physics and scan of a car alone.
    """
    from f110_gym.envs.base_classes import RaceCar

    fov, start = math.radians(sensor.field_of_view), pose.double().numpy()
    with tempfile.TemporaryDirectory() as folder:
        ros_map.write(Path(folder) / "map.png", track, RESOLUTION)
        env = _make_env(f"{folder}/map", vehicle) if whole else None
        RaceCar.scan_simulator = None  # cars share the first one's, and the environment's has 1,080 rays
        car = RaceCar(_parameters(vehicle), seed=0, time_step=vehicle.time_step, num_beams=sensor.rays, fov=fov)
        car.set_map(f"{folder}/map.yaml", ".png")
    car.scan_simulator.max_range = sensor.max_range

    def drive(angle: float, speed: float) -> None:
        if car.check_ttc(car.update_pose(angle, speed)):
            car.reset(start)

    def drive_env(angle: float, speed: float) -> None:
        if env.step(np.array([[angle, speed]]))[2]:
            env.reset(start[None])

    if env is None:
        car.reset(start)
        return drive
    env.sim.agents[0] = car
    env.reset(start[None])
    return drive_env


def _make_env(path: str, vehicle: SingleTrack) -> Any:
    from f110_gym.envs.f110_env import F110Env

    return F110Env(map=path, map_ext=".png", params=_parameters(vehicle), num_agents=1, timestep=vehicle.time_step)


def _parameters(car: SingleTrack) -> dict[str, float]:
    """By its names."""
    limits = {"s": car.max_steering, "sv": car.steering_rate}
    return {
        **{f"{name}_min": -value for name, value in limits.items()},
        **{f"{name}_max": value for name, value in limits.items()},
        **{"mu": car.friction, "C_Sf": car.front_stiffness, "C_Sr": car.rear_stiffness, "h": car.height},
        **{"lf": car.front_axle, "lr": car.rear_axle, "m": car.mass, "I": car.yaw_inertia},
        **{"v_switch": car.power_speed, "a_max": car.max_acceleration, "v_min": car.min_speed, "v_max": car.max_speed},
        **{"length": car.length, "width": car.width},
    }
