"""F1TENTH's own simulator on a map of a track, one car at a time, as `scripts/bench sim` measures it.

Of f1tenth_gym, which is not on PyPI: https://github.com/f1tenth/f1tenth_gym; its folder `gym` has to be on PYTHONPATH,
with the package gym that it imports. Its environment is left out: physics and scan of a car are all that is timed.
"""

import math
import tempfile
from collections.abc import Callable
from pathlib import Path

from torch import Tensor

from carrl.sim.sensor import Sensor
from carrl.sim.single_track import SingleTrack
from carrl.tracks import ros_map
from carrl.tracks.track import Track

RESOLUTION = 0.05
"""m a pixel, as of its own maps."""


def make_race_car(track: Track, pose: Tensor, vehicle: SingleTrack, sensor: Sensor) -> Callable[[float, float], None]:
    """A function of a steering angle, rad, and a speed, m/s, that drives the car on, and back to its pose at a wall.

    Args:
        track: whose walls are drawn on its map.
        pose: where it begins, x m, y m, heading rad, [3].
        vehicle: whose parameters it has.
        sensor: whose rays it casts.
    """
    from f110_gym.envs.base_classes import RaceCar

    fov = math.radians(sensor.field_of_view)
    car = RaceCar(_parameters(vehicle), seed=0, time_step=vehicle.time_step, num_beams=sensor.rays, fov=fov)
    with tempfile.TemporaryDirectory() as folder:
        ros_map.write(Path(folder) / "map.png", track, RESOLUTION)
        car.set_map(str(Path(folder) / "map.yaml"), ".png")
    car.scan_simulator.max_range = sensor.max_range
    start = pose.double().numpy()
    car.reset(start)

    def drive(angle: float, speed: float) -> None:
        if car.check_ttc(car.update_pose(angle, speed)):
            car.reset(start)

    return drive


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
