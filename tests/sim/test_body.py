"""Bodies: rectangles against Shapely's polygons, in torch and in machine code, and discs as they were."""

import math
from dataclasses import dataclass

import pytest
import shapely
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from carrl.errors import ConfigError
from carrl.sim.drivability import Car
from carrl.sim.geometry import corners_beyond, rectangle_touches
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import CarState, Simulator
from carrl.sim.single_track import SingleTrack
from carrl.sim.vehicle import Disc, Rectangle, Vehicle
from carrl.tracks.track import Track
from tests.reference.swept_rectangle import swept_distance
from tests.sim.shapes import as_floats, random_poses, random_track, square_room
from tests.sim.steering import steer

UNDECIDED = 1e-3
"""Walls this near to the edge of the body, m, may fall to either side by the rounding of float32."""
numbers = st.floats(-15, 15)
points = st.tuples(numbers, numbers)


@dataclass(frozen=True)
class Truck(Vehicle):
    """A car with a long body."""

    length: float = 3.0
    width: float = 1.2

    @property
    def body(self):
        return Rectangle(self.length, self.width)


class CornerTruck(Truck):
    """One whose corners alone touch walls."""

    @property
    def body(self):
        return Rectangle(self.length, self.width, by_corners=True)


def touches(begin, end, heading, half_size, walls):
    begin, end = (torch.tensor([point], dtype=torch.float64) for point in (begin, end))
    return bool(rectangle_touches(begin, end, torch.tensor([heading], dtype=torch.float64), half_size, walls))


@settings(derandomize=True, deadline=None, max_examples=300)
@given(points, points, st.floats(-4, 4), st.floats(0.2, 4), st.floats(0.2, 4))
def test_a_moving_rectangle_touches_the_walls_that_shapely_finds_in_its_way(begin, way, heading, length, width):
    end = begin[0] + way[0] / 4, begin[1] + way[1] / 4
    walls = square_room(half_side=8.0, dtype=torch.float64)
    distance = swept_distance(begin, end, heading, length, width, as_floats(walls))
    if abs(distance) > 1e-9:
        assert touches(begin, end, heading, (length / 2, width / 2), walls) == (distance < 0)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(points, points, st.floats(-4, 4), st.floats(-4, 4))
def test_what_touches_does_not_depend_on_the_frame(begin, end, heading, turn):
    walls = square_room(half_side=9.0, dtype=torch.float64)
    if abs(swept_distance(begin, end, heading, 3.0, 1.0, as_floats(walls))) < 1e-6:
        return
    rotation = torch.tensor([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]], dtype=torch.float64)
    turned = [tuple((rotation @ torch.tensor(point, dtype=torch.float64)).tolist()) for point in (begin, end)]
    assert touches(begin, end, heading, (1.5, 0.5), walls) == touches(
        *turned, heading + turn, (1.5, 0.5), walls @ rotation.T
    )


def test_a_rectangle_that_stands_still_touches_what_is_inside_and_not_what_is_beside_it():
    wall = torch.tensor([[[1.0, 0.55], [4.0, 0.55]]], dtype=torch.float64)
    assert not touches((0, 0), (0, 0), 0.0, (1.5, 0.5), wall)
    assert touches((0, 0), (0, 0), 0.0, (1.5, 0.6), wall)
    assert touches((0, 0), (0, 0), math.pi / 4, (1.5, 0.5), wall)  # the corner reaches further than the side
    inside = torch.tensor([[[-0.1, 0.0], [0.1, 0.1]]], dtype=torch.float64)
    assert touches((0, 0), (0, 0), 0.0, (1.5, 0.5), inside)


def test_a_fast_rectangle_jumps_over_no_wall():
    wall = torch.tensor([[[50.0, -1.0], [50.0, 1.0]]], dtype=torch.float64)
    assert touches((0, 0), (100, 0), 0.0, (1.5, 0.5), wall)
    assert not touches((0, 3), (100, 3), 0.0, (1.5, 0.5), wall)


@pytest.mark.parametrize("seed", range(3))
def test_the_machine_code_and_the_torch_code_find_what_shapely_finds(seed):
    track, truck = random_track(seed), Truck(time_step=0.3)
    simulators = [Simulator(track, truck, Sensor(rays=1), compiled=compiled) for compiled in (True, False)]
    cars = CarState.at(random_poses(track, 120, seed))
    controls = steer(torch.arange(120) % 3)
    compiled, plain = (simulator.step(cars, controls) for simulator in simulators)
    begin, after, walls = cars.state.double().tolist(), compiled.cars.state.double().tolist(), as_floats(track.walls)
    collided = 0
    for car in range(120):
        distance = swept_distance(begin[car][:2], after[car][:2], after[car][2], truck.length, truck.width, walls)
        if abs(distance) > UNDECIDED:
            assert compiled.collided[car] == plain.collided[car] == (distance < 0)
            collided += int(distance < 0)
    assert 10 < collided < 110


def corners_are_beyond(begin, end, heading, walls):
    begin, end = (torch.tensor([point], dtype=torch.float64) for point in (begin, end))
    return bool(corners_beyond(begin, end, torch.tensor([heading], dtype=torch.float64), (1.5, 0.5), walls))


def test_corners_touch_no_wall_that_pokes_between_them_and_any_that_they_are_beyond():
    spike = torch.tensor([[[-9.0, 2.0], [0.0, 0.3]], [[0.0, 0.3], [9.0, 2.0]]], dtype=torch.float64)
    assert touches((0, 0), (0, 0), 0.0, (1.5, 0.5), spike)
    assert not corners_are_beyond((0, 0), (0, 0), 0.0, spike)
    assert not corners_are_beyond((0, 0), (0, 0.05), 0.0, spike)  # its corners reach 0.55, and the walls are at 0.58
    assert corners_are_beyond((0, 0), (0, 0.1), 0.0, spike)
    ahead = torch.tensor([[[5.0, -9.0], [5.0, 9.0]]], dtype=torch.float64)
    assert not corners_are_beyond((3, 0), (3.49, 0), 0.0, ahead)
    for far in (3.51, 4.9, 5.1, 6.4, 6.6, 30.0):
        assert corners_are_beyond((3, 0), (far, 0), 0.0, ahead)


@pytest.mark.parametrize("compiled", [True, False])
def test_corners_are_beyond_walls_where_shapely_finds_them_off_the_road(compiled):
    track, truck = Track.load("oval"), CornerTruck()
    rings = [shapely.Polygon(wall.double().tolist()) for wall in (track.left_wall, track.right_wall)]
    road = rings[0].symmetric_difference(rings[1])
    simulator = Simulator(track, truck, Sensor(rays=3), compiled=compiled)
    place, beside, heading = torch.rand(3, 400, generator=torch.Generator().manual_seed(0))
    cars = simulator.start(place * track.length, offset=2 * beside - 1, heading=6 * heading)
    outcome = simulator.step(cars, steer(torch.arange(400) % 3))
    for (x, y, angle), collided in zip(outcome.cars.pose.double().tolist(), outcome.collided.tolist(), strict=True):
        turned = shapely.affinity.rotate(shapely.box(-1.5, -0.6, 1.5, 0.6), angle, (0, 0), use_radians=True)
        corners = shapely.points(shapely.affinity.translate(turned, x, y).exterior.coords[:4])
        assert collided == (not shapely.contains(road, corners).all())
    assert 20 < outcome.collided.sum() < 380
    assert not outcome.gates_passed[outcome.collided].any()
    assert torch.equal(outcome.ranges, simulator.sense(outcome.cars))


def test_cars_whose_corners_alone_touch_walls_do_not_slide():
    with pytest.raises(ConfigError, match=r"vehicle.contact is 'corners'; where end lets cars slide .* must be 'body'"):
        Simulator(Track.load("oval"), SingleTrack("f1tenth", contact="corners"), Sensor(), slide=0.9)


@pytest.mark.parametrize("truck", [Truck(), CornerTruck()])
def test_a_car_that_is_nowhere_has_collided_whatever_its_body(truck):
    for compiled in (True, False):
        simulator = Simulator(random_track(0), truck, Sensor(rays=1), compiled=compiled)
        outcome = simulator.step(CarState.at(torch.tensor([[math.nan, 0.0, 0.0]])), steer(torch.tensor([0])))
        assert outcome.collided.all()


def test_cars_start_by_half_their_width_beside_the_centreline_and_a_road_must_be_as_wide():
    track = random_track(1)
    starts = torch.arange(50) * track.length / 50
    beside = {}
    for vehicle in (Truck(width=1.0), Vehicle(body_radius=0.5)):
        simulator = Simulator(track, vehicle, Sensor())
        beside[type(vehicle)] = simulator.start(starts, offset=torch.ones(50)).pose
        assert Car.of(vehicle, Sensor(), 0.1).body_radius == 0.5
    torch.testing.assert_close(beside[Truck], beside[Vehicle])


def test_bodies_say_how_far_they_reach_and_refuse_what_is_no_size():
    assert Vehicle(body_radius=0.7).body == Disc(0.7)
    assert (Disc(0.7).half_width, Disc(0.7).reach) == (0.7, 0.7)
    assert (Rectangle(4.0, 3.0).half_width, Rectangle(4.0, 3.0).reach) == (1.5, 2.5)
    for wrong in (0.0, -1.0, math.nan, math.inf, "wide", True):
        with pytest.raises(ConfigError, match=r"body\.width is .*; it must be a number between"):
            Rectangle(3.0, wrong)
