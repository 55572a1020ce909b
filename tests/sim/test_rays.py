"""The distance sensors: against numbers worked by hand, a scalar oracle and the symmetries of the plane."""

import math
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from carrl.errors import ConfigError
from carrl.sim.geometry import ray_distances
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import CarState, Simulator
from carrl.sim.vehicle import Vehicle
from carrl.tracks.track import Track, builtin_names
from tests.reference.scalar_rays import ray_distance
from tests.sim.shapes import as_floats, random_poses, random_track, square_room

exactly = settings(derandomize=True, deadline=None, max_examples=60)
coordinates = st.floats(-9.5, 9.5, width=32)
angles = st.floats(-math.pi, math.pi)


def cast(x: float, y: float, *directions: float, walls: torch.Tensor, max_range: float = 20.0) -> torch.Tensor:
    return ray_distances(torch.tensor([[x, y]]), torch.tensor([directions]), walls, max_range)[0]


def assert_equal_to_the_oracle(track: Track, pose_count: int, sensor: Sensor, seed: int) -> None:
    poses = random_poses(track, pose_count, seed)
    walls = as_floats(track.walls)
    expected = torch.tensor(
        [
            [ray_distance(x, y, heading + angle, walls, sensor.max_range) for angle in sensor.angles.tolist()]
            for x, y, heading in poses.tolist()
        ]
    )
    assert (expected < sensor.max_range).float().mean() > 0.2, "too few rays meet a wall to be a test"
    for compiled in (True, False):
        ranges = Simulator(track, Vehicle(), sensor, compiled=compiled).sense(CarState.at(poses))
        assert ranges.dtype == torch.float32
        assert (ranges >= 0).all()
        assert (ranges <= sensor.max_range).all()
        torch.testing.assert_close(ranges, expected, atol=1e-4, rtol=0)


@pytest.mark.parametrize("seed", range(20))
def test_ranges_equal_the_scalar_oracle_on_a_random_track(seed: int):
    sensor = Sensor(rays=3 + seed % 7, field_of_view=90.0 + 10 * seed, max_range=15.0 + 5 * seed)
    assert_equal_to_the_oracle(random_track(seed), 200, sensor, seed)


@pytest.mark.parametrize("name", builtin_names())
def test_ranges_equal_the_scalar_oracle_on_a_builtin_track(name: str):
    assert_equal_to_the_oracle(Track.load(name), 300, Sensor(), seed=1)


@pytest.mark.parametrize("name", ["Spa", "Austin", "Norisring", "Budapest", "Oschersleben"])
def test_ranges_equal_the_scalar_oracle_on_a_real_circuit(real_circuits: Path, name: str):
    track = Track.load(real_circuits / f"{name}.csv")
    assert_equal_to_the_oracle(track, 200, Sensor(rays=5, field_of_view=150.0, max_range=200.0), seed=2)


def test_ranges_in_a_square_room_are_those_worked_by_hand():
    ranges = cast(4.0, 0.0, 0.0, math.pi / 2, math.pi, math.pi / 4, -math.pi / 2, walls=square_room(10.0))
    torch.testing.assert_close(ranges, torch.tensor([6.0, 10.0, 14.0, 6 * math.sqrt(2), 10.0]))


def test_the_first_ray_points_to_the_right_of_the_heading_and_the_last_to_the_left():
    room = square_room(10.0)
    torch.testing.assert_close(Sensor(3, 180.0, turn=-30.0).angles, torch.tensor([-2, -0.5, 1]) * math.pi / 3)
    torch.testing.assert_close(Sensor(1, turn=90.0).angles, torch.tensor([math.pi / 2]))
    angles = Sensor(rays=3, field_of_view=180.0).angles
    assert angles.tolist() == pytest.approx([-math.pi / 2, 0, math.pi / 2])
    ranges = ray_distances(torch.tensor([[2.0, 5.0]]), angles[None], room, 100.0)[0]
    torch.testing.assert_close(ranges, torch.tensor([15.0, 8.0, 5.0]))


def test_a_single_ray_points_straight_ahead():
    assert Sensor(rays=1).angles.tolist() == [0.0]


def test_a_wall_beyond_the_range_reads_the_full_range():
    assert cast(0.0, 0.0, 0.0, walls=square_room(10.0), max_range=9.99).item() == pytest.approx(9.99)
    assert cast(0.0, 0.0, 0.0, walls=square_room(10.0), max_range=10.01).item() == 10.0


def test_a_wall_behind_the_car_is_not_seen():
    wall = torch.tensor([[[-1.0, -5.0], [-1.0, 5.0]]])
    assert cast(0.0, 0.0, 0.0, walls=wall).item() == 20.0


@pytest.mark.parametrize("offset", [0.0, 0.5])
def test_a_ray_parallel_to_a_wall_reports_the_full_range(offset: float):
    wall = torch.tensor([[[1.0, offset], [5.0, offset]]])
    assert cast(0.0, 0.0, 0.0, walls=wall).item() == 20.0


def test_a_car_on_a_wall_reads_zero_across_it():
    assert cast(10.0, 0.0, 0.0, 0.7, walls=square_room(10.0)).tolist() == [0.0, 0.0]


def test_a_wall_without_length_is_not_seen():
    wall = torch.tensor([[[3.0, 0.0], [3.0, 0.0]]])
    assert cast(0.0, 0.0, 0.0, walls=wall).item() == 20.0


def test_the_nearest_of_several_walls_is_reported_whatever_their_order():
    walls = torch.tensor([[[x, -1.0], [x, 1.0]] for x in (7.0, 3.0, 5.0)])
    assert all(cast(0.0, 0.0, 0.0, walls=walls[order]).item() == 3.0 for order in ([0, 1, 2], [1, 2, 0], [2, 0, 1]))


def test_no_ray_slips_through_the_joint_of_two_walls():
    generator = torch.Generator().manual_seed(0)
    corner_angle = torch.arange(17, dtype=torch.float64) * 2 * math.pi / 17
    corners = 12 * torch.stack([corner_angle.cos(), corner_angle.sin()], dim=1)
    walls = torch.stack([corners, corners.roll(-1, 0)], dim=1)
    for dtype in (torch.float32, torch.float64):
        origins = (14 * torch.rand(2000, 2, generator=generator, dtype=torch.float64) - 7).to(dtype)
        to_corner = corners - origins[:, None].double()
        aim = torch.atan2(to_corner[..., 1], to_corner[..., 0]).to(dtype)
        ranges = ray_distances(origins, aim, walls, 100.0)
        torch.testing.assert_close(ranges.double(), to_corner.norm(dim=-1), atol=1e-4, rtol=0)


@exactly
@given(coordinates, coordinates, angles, angles, st.floats(-500, 500), st.floats(-500, 500))
def test_turning_and_moving_car_and_room_together_leaves_the_ranges_equal(x, y, heading, turn, dx, dy):
    rotation = torch.tensor([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]], dtype=torch.float64)
    shift = torch.tensor([dx, dy], dtype=torch.float64)
    room, origin = square_room(dtype=torch.float64), torch.tensor([[x, y]], dtype=torch.float64)
    directions = heading + Sensor().angles.double()[None]
    before = ray_distances(origin, directions, room, 100.0)
    after = ray_distances(origin @ rotation.T + shift, directions + turn, room @ rotation.T + shift, 100.0)
    torch.testing.assert_close(after, before, atol=1e-6, rtol=0)


@settings(exactly, max_examples=15)
@given(st.integers(0, 19), st.floats(0.1, 3.0), st.floats(-100, 100), st.floats(-100, 100))
def test_turning_and_moving_car_and_track_together_leaves_the_ranges_equal(seed, turn, dx, dy):
    rotation = torch.tensor([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]], dtype=torch.float64)
    shift = torch.tensor([dx, dy], dtype=torch.float64)
    track = random_track(seed)
    walls, pose = track.walls.double(), random_poses(track, 50, seed).double()
    directions = pose[:, 2:] + Sensor().angles.double()
    before = ray_distances(pose[:, :2], directions, walls, 30.0)
    after = ray_distances(pose[:, :2] @ rotation.T + shift, directions + turn, walls @ rotation.T + shift, 30.0)
    torch.testing.assert_close(after, before, atol=1e-6, rtol=0)


@pytest.mark.parametrize("compiled", [True, False])
@settings(exactly, max_examples=15)
@given(st.integers(0, 19), st.integers(1, 40))
def test_many_cars_at_once_read_what_each_reads_alone(compiled, seed, count):
    simulator = Simulator(random_track(seed), Vehicle(), Sensor(), compiled=compiled)
    poses = random_poses(simulator.track, count, seed)
    alone = torch.cat([simulator.sense(CarState.at(pose[None])) for pose in poses])
    assert torch.equal(simulator.sense(CarState.at(poses)), alone)


@exactly
@given(st.lists(st.tuples(*[st.floats(-50, 50, width=32)] * 4), min_size=1, max_size=8), angles, st.floats(0.01, 1e4))
def test_ranges_stay_between_zero_and_the_full_range_for_any_walls(ends, heading, max_range):
    walls = torch.tensor(ends).view(-1, 2, 2)
    ranges = ray_distances(torch.zeros(1, 2), heading + Sensor().angles[None], walls, max_range)
    assert ranges.dtype == torch.float32
    assert (ranges >= 0).all()
    assert (ranges <= torch.tensor(max_range)).all()


@pytest.mark.parametrize(
    ("parameter", "value"),
    [
        ("rays", 0),
        ("rays", -1),
        ("rays", 2.5),
        ("rays", "7"),
        ("field_of_view", 0.0),
        ("field_of_view", 360.0),
        ("field_of_view", math.nan),
        ("field_of_view", "wide"),
        ("max_range", 0.0),
        ("max_range", -1.0),
        ("max_range", math.inf),
        ("max_range", None),
    ],
)
def test_a_sensor_that_cannot_be_built_is_refused_by_name_and_value(parameter: str, value: object):
    with pytest.raises(ConfigError, match=rf"^sensor\.{parameter} is {value}; it must "):
        Sensor(**{parameter: value})
