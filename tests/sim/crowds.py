"""Rays of cars in a crowd against the scalar oracle: `python -m tests.sim.crowds 1000000` for so many of them."""

import math
import sys

import numpy as np
import torch

from carrl.sim.kinematic import Kinematic
from carrl.sim.sensor import Sensor
from carrl.sim.traffic import Traffic
from tests.reference.scalar_rays import ray_distance
from tests.reference.scalar_traffic import car_distance, is_inside, sides
from tests.sim.shapes import as_floats, straight_road_track

LENGTH, WIDTH = Kinematic().length, Kinematic().width
TOLERANCE = 1e-3


def check_random_rays(rays: int, mount: float, count: int) -> None:
    """Compares so many rays, each of a car in a world of 8 on a road, with the oracle."""
    track, random = straight_road_track(), np.random.default_rng(rays)
    sensor = Sensor(rays=rays, field_of_view=300.0, max_range=30.0, mount=mount)
    traffic = Traffic(track, Kinematic(), sensor, cars_per_world=8)
    worlds, walls = -(-count // (8 * rays)), as_floats(track.walls)
    spread = random.choice([6.0, 20.0, 60.0], (worlds, 1))
    stations = random.uniform(0, track.length, (worlds, 1)) + spread * random.uniform(-1, 1, (worlds, 8))
    offset, heading = random.uniform(-1, 1, worlds * 8), random.uniform(-math.pi, math.pi, worlds * 8)
    cars = traffic.start(
        torch.from_numpy(stations.flatten()), None, torch.from_numpy(offset), torch.from_numpy(heading)
    )
    ranges, on_car = traffic.look(cars)
    poses, seen = cars.pose.double().tolist(), 0
    for row, (x, y, heading) in enumerate(poses):
        x, y = x + mount * math.cos(heading), y + mount * math.sin(heading)
        mates = [poses[other] for other in range(row // 8 * 8, row // 8 * 8 + 8) if other != row]
        near = [wall for wall in walls if math.hypot(wall[0][0] - x, wall[0][1] - y) < 40.0]
        cars_near = [sides(pose, LENGTH, WIDTH) for pose in mates]
        covered = any(is_inside(x, y, pose, LENGTH, WIDTH) for pose in mates)
        for ray, turn in enumerate(sensor.angles.double().tolist()):
            wall = ray_distance(x, y, heading + turn, near, 30.0)
            car = 0.0 if covered else car_distance(x, y, heading + turn, cars_near, 30.0)
            assert abs(float(ranges[row, ray]) - min(wall, car)) < TOLERANCE
            if abs(wall - car) > TOLERANCE:
                assert bool(on_car[row, ray]) == (car < wall)
                seen += car < wall
    assert seen > count / 20


if __name__ == "__main__":
    check_random_rays(19, 1.5, int(sys.argv[1]))
    print(f"{int(sys.argv[1]):,} rays, none off by more than {TOLERANCE:g} m")
