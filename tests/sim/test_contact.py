"""Cars that touch a wall and go on: where that leaves them, what remains of their speed, and that they get away."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from carrl.sim.contact import slide
from carrl.sim.geometry import path_clearance, rectangle_touches
from carrl.sim.kinematic import Kinematic
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import CarState, Simulator
from carrl.sim.vehicle import Disc, Rectangle, Vehicle
from carrl.tracks.track import Track
from tests.sim.shapes import random_track, square_room, straight_road_track
from tests.sim.steering import tensors

CAR = Rectangle(4.0, 2.0)
FLOOR = torch.tensor([[[-50.0, 0.0], [50.0, 0.0]]])
"""A wall along the x axis; cars are above it."""


def pose(x: float, y: float, degrees: float) -> Tensor:
    return torch.tensor([[x, y, math.radians(degrees)]])


def put_by(body: Disc | Rectangle, before: Tensor, after: Tensor, walls: Tensor = FLOOR) -> tuple[list[float], float]:
    """Where one car is left, and the direction of the wall, in degrees."""
    left, direction = slide(before, after, walls.double()[None], body)
    x, y, heading = left[0].double().tolist()
    return [x, y, math.degrees(heading)], math.degrees(direction.item())


# Where a car is left


def test_a_disc_goes_no_further_down_than_where_it_touches():
    """From 3 m above the wall down by 4 and right by 4: a disc of 1 m touches halfway; the rest is along the wall."""
    place, direction = put_by(Disc(1.0), pose(0, 3, -45), pose(4, -1, -45))
    assert place == pytest.approx([4, 1.02, 0], abs=0.001)
    assert direction == pytest.approx(0, abs=1e-5)


def test_the_direction_along_the_wall_is_the_one_nearer_to_the_heading():
    assert put_by(Disc(1.0), pose(0, 3, -135), pose(-4, -1, -135))[1] % 360 == pytest.approx(180)
    turned_round = FLOOR.flip(1)
    assert put_by(Disc(1.0), pose(0, 3, -45), pose(4, -1, -45), turned_round)[1] == pytest.approx(0, abs=1e-5)


def test_a_rectangle_that_meets_a_wall_at_an_angle_is_turned_along_it():
    """At 30 degrees its corner is 2 sin 30 + 1 cos 30 = 1.866 m below its middle: from 3 m it has 1.134 m to go down.

    Along the wall its side then has 0.866 m left, and it goes on as far as it would have gone without the wall.
    """
    way = 4 * math.cos(math.radians(30)), 4 * math.sin(math.radians(30))
    place, direction = put_by(CAR, pose(0, 3, -30), pose(way[0], 3 - way[1], -30))
    down = 3 - 2 * math.sin(math.radians(30)) - math.cos(math.radians(30))
    assert place == pytest.approx([way[0], 3 - down, 0], abs=0.001)
    assert direction == pytest.approx(0, abs=1e-5)


def test_a_tail_that_swings_into_the_wall_pushes_the_car_off_it():
    """A car along the wall that turns away from it, by so much that its tail would be in it."""
    place, _ = put_by(CAR, pose(0, 1.02, 0), pose(1, 1.03, 6))
    assert place == pytest.approx([1, 1.02, 0], abs=0.001)


def test_a_car_that_meets_a_wall_head_on_is_turned_along_it():
    place, direction = put_by(CAR, pose(0, 2.5, -90), pose(0, 0.5, -90))
    assert place[:2] == pytest.approx([0, 2], abs=0.001)
    assert place[2] == pytest.approx(direction)
    assert math.sin(math.radians(direction)) == pytest.approx(0, abs=1e-5)


@pytest.mark.parametrize("degrees", [-88.0, -90.0, -92.0])
def test_a_car_that_meets_a_wall_squarely_is_turned_in_the_driving_direction(degrees):
    assert put_by(CAR, pose(0, 2.5, degrees), pose(0, 0.5, degrees))[1] == pytest.approx(0)
    assert abs(put_by(CAR, pose(0, 2.5, degrees), pose(0, 0.5, degrees), FLOOR.flip(1))[1]) == pytest.approx(180)


def test_no_speed_leads_through_a_thin_wall():
    for body in (Disc(0.5), Rectangle(2.0, 1.0)):
        place, _ = put_by(body, pose(0, 3, -80), pose(50, -300, -80))
        assert place[1] > 0.4


def test_in_a_corner_a_car_is_pushed_out_of_both_walls():
    """Into the lower right corner of a room, along its diagonal; turned along one wall it is in the other one."""
    room = square_room(10.0)
    place, _ = put_by(CAR, pose(7, -7, -45), pose(9, -9, -45), room)
    assert math.degrees(math.radians(place[2])) % 90 == pytest.approx(0, abs=1e-3)
    middle, heading = torch.tensor([place[:2]]).double(), torch.tensor([math.radians(place[2])]).double()
    assert not rectangle_touches(middle, middle, heading, (2.0, 1.0), room.double())
    assert abs(place[0]) < 9 and abs(place[1]) < 9


def test_where_there_is_no_room_a_car_stays_where_it_was():
    """In a lane as wide as the car, closed ahead."""
    lane = torch.tensor([[[0.0, 1.01], [9.0, 1.01]], [[9.0, 1.01], [9.0, -1.01]], [[0.0, -1.01], [9.0, -1.01]]])
    place, _ = put_by(CAR, pose(6.5, 0, 0), pose(8, 0, 0), lane)
    assert place == pytest.approx([6.5, 0, 0])


def test_a_car_that_is_no_number_stays_where_it_was():
    place, _ = put_by(CAR, pose(0, 3, -30), pose(math.nan, 1, -30))
    assert place == pytest.approx([0, 3, -30])


# What remains of the motion

MOTION = Kinematic.state_names


def motion(**values: float) -> Tensor:
    return torch.tensor([[values.get(name, 0.0) for name in MOTION]])


def test_the_speed_along_the_wall_remains_and_the_car_neither_slips_nor_turns():
    """20 m/s, 0.2 rad to the left of a heading that is 0.5 rad to the right of the wall: cos 0.3."""
    before = motion(heading=-0.5, speed=20.0, slip=0.2, yaw_rate=1.0, steering=0.1, acceleration=1.0)
    before[:, MOTION.index("lateral_acceleration")] = 3.0
    touched = torch.tensor([[7.0, 8.0, 0.0]])
    after = Kinematic().after_contact(before, touched, torch.zeros(1), kept=0.9)
    speed = 0.9 * 20 * math.cos(0.3)
    expected = motion(x=7.0, y=8.0, speed=speed, steering=0.1, acceleration=1 + (speed - 20) / 0.1)
    torch.testing.assert_close(after, expected)


def test_nothing_remains_of_a_speed_into_the_wall_or_backwards():
    states = torch.cat([motion(heading=-math.pi / 2, speed=20.0), motion(heading=0.5, slip=2.0, speed=20.0)])
    after = Kinematic().after_contact(states, torch.zeros(2, 3), torch.zeros(2), kept=1.0)
    assert after[:, MOTION.index("speed")].tolist() == pytest.approx([0, 0], abs=1e-5)


def test_a_car_of_one_speed_keeps_it():
    after = Vehicle().after_contact(torch.ones(1, 3), torch.tensor([[1.0, 2.0, 3.0]]), torch.zeros(1), kept=0.5)
    assert after.tolist() == [[1, 2, 3]]


# In the simulator


def sliding(track: Track, vehicle=None, compiled: bool = True) -> Simulator:
    return Simulator(track, vehicle or Kinematic(), Sensor(), compiled=compiled, slide=0.9)


def test_only_cars_that_touch_are_put_elsewhere():
    track = straight_road_track()
    slides, ends = sliding(track), Simulator(track, Kinematic(), Sensor())
    cars = slides.start(torch.linspace(0, 190, 8), heading=torch.linspace(-1.5, 1.5, 8), speed=torch.full((8,), 30.0))
    control = torch.zeros(8, 2)
    ours, theirs = slides.step(cars, control), ends.step(cars, control)
    assert torch.equal(ours.collided, theirs.collided)
    free = ~theirs.collided
    assert free.any() and theirs.collided.any()
    for one, other in zip(tensors(ours), tensors(theirs), strict=True):
        assert torch.equal(one[free], other[free])
    torch.testing.assert_close(ours.ranges, slides.sense(ours.cars))


def test_gates_count_on_the_way_that_a_car_really_drove():
    """A car that grazes the wall in the very step in which it passes a gate."""
    track = straight_road_track()
    simulator = sliding(track)
    gate = simulator.routes.gates_of(0)[0].item()
    cars = simulator.start(torch.tensor([gate - 1.0]), offset=torch.tensor([1.0]), speed=torch.tensor([30.0]))
    cars.state[:, 1] = track.gates[0, 0, 1] - simulator.vehicle.body.half_width - 0.01
    cars.state[:, 2] = 0.02
    outcome = simulator.step(cars, torch.zeros(1, 2))
    assert outcome.collided.all()
    assert outcome.cars.state[0, 0] > gate
    assert outcome.gates_passed.tolist() == outcome.cars.gates_passed.tolist() == outcome.cars.next_gate.tolist() == [1]


@pytest.mark.parametrize("vehicle", [Vehicle(), Kinematic()], ids=["disc", "rectangle"])
@pytest.mark.parametrize("name", ["oval", "paper", 0, 1])
def test_compiled_and_plain_slide_alike_and_leave_no_car_in_a_wall(name, vehicle):
    track = random_track(name) if isinstance(name, int) else Track.load(name)
    compiled, plain = (sliding(track, vehicle, each) for each in (True, False))
    generator = torch.Generator().manual_seed(3)
    speed = None if isinstance(vehicle, Vehicle) else 20 * torch.rand(200, generator=generator)
    cars = compiled.start(track.length * torch.rand(200, generator=generator), speed=speed)
    body, touched = vehicle.body, 0
    station = compiled.place(cars).station
    for _ in range(60):
        control = 2 * torch.rand(200, len(vehicle.control_names), generator=generator) - 1
        control[:, 1:] = control[:, 1:].abs()
        ours, theirs = compiled.step(cars, control), plain.step(cars, control)
        same = ours.collided == theirs.collided
        assert same.float().mean() > 0.98
        torch.testing.assert_close(ours.cars.state[same], theirs.cars.state[same], atol=2e-3, rtol=1e-3)
        cars, touched = ours.cars, touched + int(ours.collided.sum())
        place = compiled.place(replace(cars, station=station))
        station = place.station
        assert (place.side.abs() < 1.2).all()
        places, headings = cars.state[:, :2].double(), cars.state[:, 2].double()
        walls = track.walls.double()
        if isinstance(body, Disc):
            assert (path_clearance(places, places, walls) > body.radius - 1e-5).all()
        else:
            half_size = body.length / 2 - 1e-4, body.width / 2 - 1e-4
            assert not rectangle_touches(places, places, headings, half_size, walls).any()
    assert touched > 100


def driven_on(simulator: Simulator, cars: CarState, steps: int) -> tuple[CarState, Tensor]:
    """Cars that steer to the side where there is more room, at 5 m/s, and the way that they drive, [B], m."""
    speed, way = simulator.vehicle.state_names.index("speed"), torch.zeros(len(cars.state))
    for _ in range(steps):
        ranges = simulator.sense(cars)
        turn = 3 * (ranges[:, 4:].sum(1) - ranges[:, :3].sum(1)) / ranges.sum(1)
        pedal = torch.where(cars.state[:, speed] < 5, 0.5, -0.5)
        after = simulator.step(cars, torch.stack([turn.clamp(-1, 1), pedal], dim=1)).cars
        way += (after.pose - cars.pose)[:, :2].norm(dim=1)
        cars = after
    return cars, way


@pytest.mark.parametrize("name", ["oval", "paper", "serpentine"])
def test_cars_without_reverse_get_away_from_head_on_contact(name):
    """Driven into the walls to the left and to the right, anywhere on the road, and then on by a rule."""
    simulator = sliding(Track.load(name))
    stations = torch.linspace(0, simulator.track.length, 25)[:-1].repeat(2)
    across = torch.tensor([1.0, -1.0]).repeat_interleave(24) * math.pi / 2
    cars = simulator.start(stations, heading=across, speed=torch.full((48,), 10.0))
    touched = torch.zeros(48, dtype=torch.bool)
    for _ in range(10):
        outcome = simulator.step(cars, torch.tensor([[0.0, 1.0]]).expand(48, 2))
        cars, touched = outcome.cars, touched | outcome.collided
    assert touched.all()
    faces_forward = simulator.place(cars).heading_error.abs() < math.pi / 2
    assert faces_forward.float().mean() > 0.8
    after, way = driven_on(simulator, cars, 300)
    assert (way > 100).all()
    assert (after.gates_passed > cars.gates_passed)[faces_forward].all()


def test_a_car_that_steers_into_a_wall_slides_along_it_and_loses_speed():
    """A tenth of it in each step of contact, while it drives on for as long as its speed lets it."""
    simulator = sliding(straight_road_track())
    cars = simulator.start(torch.tensor([10.0]), offset=torch.tensor([1.0]), speed=torch.tensor([30.0]))
    speed, speeds = simulator.vehicle.state_names.index("speed"), []
    for _ in range(20):
        outcome = simulator.step(cars, torch.tensor([[1.0, 0.0]]))
        speeds.append(outcome.cars.state[0, speed].item())
        assert (outcome.cars.state[0, 0] - cars.state[0, 0]).item() > 0.05 * speeds[-1]
        cars = outcome.cars
    assert speeds[-1] < 10
    assert speeds == sorted(speeds, reverse=True)
