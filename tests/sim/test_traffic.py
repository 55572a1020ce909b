"""Worlds of several cars: what their rays see of each other, where they touch, and that none passes through another."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from carrl.errors import ConfigError
from carrl.render import car as drawn
from carrl.sim.kinematic import Kinematic
from carrl.sim.others import PARTS
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import CarState, Simulator
from carrl.sim.traffic import Traffic
from carrl.sim.traffic_kernel import meet
from carrl.sim.vehicle import HULL, Bicycle, Disc, Rectangle, Vehicle
from carrl.tracks.track import Track
from tests.reference.scalar_traffic import gap_between, least_gap, overlaps
from tests.sim.crowds import check_random_rays
from tests.sim.shapes import straight_road_track
from tests.sim.steering import steer

LENGTH, WIDTH = Kinematic().length, Kinematic().width


def straight_traffic(cars=2, vehicle=None, sensor=None, **options):
    return Traffic(
        straight_road_track(width=30.0),
        vehicle or Kinematic(),
        sensor or Sensor(rays=3),
        cars_per_world=cars,
        **options,
    )


def touching(traffic, begin, end):
    """What `meet` finds for cars that go from poses [K, 3] to poses [K, 3]."""
    pair = (np.array(poses, np.float32) for poses in (begin, end))
    return meet(traffic._outline, *pair, len(begin))


# Rays


@pytest.mark.parametrize(("rays", "mount"), [(7, 0.0), (19, 1.5)])
def test_rays_meet_the_other_cars_where_the_oracle_does(rays, mount):
    check_random_rays(rays, mount, 2000)


def test_a_ray_sees_the_rear_of_the_car_ahead_and_the_car_ahead_does_not_see_back():
    traffic = straight_traffic(sensor=Sensor(rays=3, max_range=50.0))
    ranges, on_car = traffic.look(traffic.start(torch.tensor([10.0, 30.0])))
    torch.testing.assert_close(ranges[0, 1], torch.tensor(20 - LENGTH / 2))
    assert on_car.tolist() == [[False, True, False], [False, False, False]]
    assert ranges[1, 1] == 50.0


def test_cars_of_other_worlds_are_not_seen():
    traffic = straight_traffic(sensor=Sensor(rays=3, max_range=50.0))
    cars = traffic.start(torch.tensor([10.0, 100.0, 30.0, 120.0]))
    assert not traffic.look(cars)[1].any()
    alone = Simulator(traffic.track, traffic.vehicle, traffic.sensor)
    assert torch.equal(traffic.sense(cars), alone.sense(cars))


def test_a_ray_that_begins_in_another_car_reads_nothing():
    traffic = straight_traffic(sensor=Sensor(rays=5))
    ranges, on_car = traffic.look(traffic.start(torch.tensor([10.0, 11.0])))
    assert (ranges == 0).all()
    assert on_car.all()


def test_what_is_seen_of_a_disc_is_the_car_that_is_drawn_for_it():
    assert (drawn._HULL_REACH, drawn._TYRE_REACH) == HULL
    assert Disc(0.5).outline == Rectangle(0.95, 0.59)
    traffic = straight_traffic(vehicle=Vehicle(), sensor=Sensor(rays=1))
    ranges, _ = traffic.look(traffic.start(torch.tensor([10.0, 15.0])))
    torch.testing.assert_close(ranges[0], torch.tensor([5 - 0.475]))


def test_rays_see_the_cars_where_they_are_after_all_have_moved():
    traffic = straight_traffic(4)
    cars = traffic.start(torch.tensor([10.0, 17.0, 24.0, 100.0]), speed=torch.tensor([20.0, 22.0, 24.0, 5.0]))
    outcome = traffic.step(cars, torch.zeros(4, 2))
    assert not outcome.contact.touched.any()
    ranges, on_car = traffic.look(outcome.cars)
    assert torch.equal(outcome.ranges, ranges)
    assert torch.equal(outcome.on_car, on_car)


# Touching


def random_crossings(count: int, seed: int = 0):
    """Pairs of ways that bring two cars over each other in the middle: poses before and after, [count, 2, 3]."""
    random = np.random.default_rng(seed)
    time = random.uniform(0.05, 0.95, (count, 1, 1))
    ways = random.uniform(-1, 1, (count, 2, 2)) * 10 ** random.uniform(0.3, 3, (count, 1, 1))
    there = random.uniform(-0.7, 0.7, (count, 2, 2))
    heading = random.uniform(-math.pi, math.pi, (count, 2, 1))
    begin, end = there - time * ways, there + (1 - time) * ways
    return np.concatenate([begin, heading], -1), np.concatenate([end, heading], -1)


def test_no_two_cars_pass_through_each_other_at_any_speed():
    begin, end = random_crossings(18_000)
    traffic = straight_traffic()
    apart = overlaps(begin, LENGTH, WIDTH) == 0
    begin, end = begin[apart].astype(np.float32), end[apart].astype(np.float32)
    assert len(begin) >= 10_000
    states, share, other, _, _, _ = meet(traffic._outline, begin.reshape(-1, 3), end.reshape(-1, 3), 2)
    shares, after = share.reshape(-1, 2), states.reshape(-1, 2, 3)
    assert (other.reshape(-1, 2) == [1, 0]).all()
    assert (shares.min(axis=1) < 0.96).all()
    assert (overlaps(after, LENGTH, WIDTH) == 0).all()
    for index in range(0, len(begin), 100):
        ways = list(zip(begin[index].tolist(), end[index].tolist(), strict=True))
        assert least_gap(ways, shares[index].tolist(), LENGTH, WIDTH) > -0.01


def test_cars_whose_ways_do_not_cross_drive_them_to_the_end():
    random, traffic = np.random.default_rng(1), straight_traffic()
    begin = np.concatenate([random.uniform(-8, 8, (150, 2, 2)), random.uniform(-3, 3, (150, 2, 1))], -1)
    end = begin + np.concatenate([random.uniform(-6, 6, (150, 2, 2)), np.zeros((150, 2, 1))], -1)
    begin, end = begin.astype(np.float32), end.astype(np.float32)
    states, _, other, *_ = meet(traffic._outline, begin.reshape(-1, 3), end.reshape(-1, 3), 2)
    free = 0
    for index in range(len(begin)):
        ways = list(zip(begin[index].tolist(), end[index].tolist(), strict=True))
        gap = least_gap(ways, (1, 1), LENGTH, WIDTH)
        if gap > 0.2:
            free += 1
            assert (other[2 * index : 2 * index + 2] == -1).all()
            assert (states[2 * index : 2 * index + 2] == end[index]).all()
        elif gap < -0.2 and gap_between(*begin[index].tolist(), LENGTH, WIDTH) > 0:
            assert (other[2 * index : 2 * index + 2] >= 0).all()
    assert 20 < free < 130


def test_whoever_runs_into_the_others_rear_is_at_fault_and_stops_there():
    state, share, other, part, at_fault, closing = touching(
        straight_traffic(), [[0, 0, 0], [10, 0.3, 0]], [[12, 0, 0], [12, 0.3, 0]]
    )
    assert other.tolist() == [1, 0]
    assert [PARTS[each] for each in part] == ["front", "rear"]
    assert at_fault.tolist() == [True, False]
    assert closing.tolist() == pytest.approx([10, 10])
    free = 10 - LENGTH
    assert share.tolist() == pytest.approx([free / 10, 1], abs=2e-3)
    assert state[1].tolist() == pytest.approx([12, 0.3, 0])
    assert state[1, 0] - state[0, 0] >= LENGTH  # the one behind stopped, and the other one drove on


def test_of_two_that_meet_head_on_both_are_at_fault_and_of_one_that_stands_still_only_the_other():
    *_, part, at_fault, closing = touching(
        straight_traffic(), [[0, 0, 0], [20, 0, math.pi]], [[9, 0, 0], [11, 0, math.pi]]
    )
    assert part.tolist() == [1, 1]
    assert at_fault.tolist() == [True, True]
    assert closing.tolist() == pytest.approx([18, 18])
    *_, at_fault, _ = touching(straight_traffic(), [[0, 0, 0], [8, 0, math.pi]], [[9, 0, 0], [8, 0, math.pi]])
    assert at_fault.tolist() == [True, False]


def test_who_drives_with_the_front_into_a_side_is_at_fault_and_for_side_by_side_nobody_is():
    *_, part, at_fault, _ = touching(
        straight_traffic(), [[0, 0, 0], [0, -8, math.pi / 2]], [[1, 0, 0], [0, -1, math.pi / 2]]
    )
    assert [PARTS[each] for each in part] == ["right", "front"]
    assert at_fault.tolist() == [False, True]
    *_, part, at_fault, _ = touching(straight_traffic(), [[0, 0, 0], [0.5, 3, 0]], [[2, 0.8, 0], [2.5, 2.2, 0]])
    assert [PARTS[each] for each in part] == ["left", "right"]
    assert not at_fault.any()


def test_cars_side_by_side_that_would_touch_by_turning_do_not_turn_and_drive_on():
    state, _, other, *_ = touching(straight_traffic(), [[0, 0, 0], [0, 1.7, 0]], [[2, 0, 0.3], [2, 1.7, 0]])
    assert other.tolist() == [1, 0]
    assert state[:, 2].tolist() == [0, 0]
    assert state[:, 0].tolist() == [2, 2]


def test_of_three_in_a_row_the_first_stops_where_it_touches_the_second_and_that_one_behind_the_third():
    state, share, other, *_ = touching(
        straight_traffic(3), [[0, 0, 0], [10, 0, 0], [20, 0, 0]], [[30, 0, 0], [22, 0, 0], [20, 0, 0]]
    )
    met = (10 - LENGTH) / (30 - 12)  # the share of the step after which the first reaches the second
    assert share.tolist() == pytest.approx([met, (10 - LENGTH) / 12, 1], abs=2e-3)
    assert state[:, 0].tolist() == pytest.approx([30 * met, 20 - LENGTH, 20], abs=0.03)
    assert other.tolist() == [1, 0, 1]


def test_a_car_that_is_nowhere_touches_nothing_and_is_not_seen():
    traffic = straight_traffic()
    state, _, other, *_ = touching(traffic, [[0, 0, 0], [math.nan, 0, 0]], [[9, 0, 0], [math.nan, 0, 0]])
    assert other.tolist() == [-1, -1]
    assert state[0].tolist() == [9, 0, 0]
    cars = CarState.at(torch.tensor([[10.0, 0.0, 0.0], [math.nan, 0.0, 0.0]]).repeat(1, 3))
    assert not traffic.look(cars)[1][0].any()


@pytest.mark.parametrize(
    "vehicle", [Vehicle(speed=40.0), Bicycle(speed=40.0), Kinematic()], ids=lambda each: type(each).__name__
)
def test_cars_that_drive_at_random_in_a_crowd_never_overlap(vehicle):
    traffic = Traffic(square_track(), vehicle, Sensor(rays=1), cars_per_world=5, slide=0.9, bump=0.9)
    generator = torch.Generator().manual_seed(0)
    speed = torch.full((20,), 20.0) if "speed" in vehicle.state_names else None
    cars = traffic.start(torch.arange(20) % 5 * 9.0, speed=speed)
    length, width = vehicle.body.outline.length, vehicle.body.outline.width
    touched = 0
    for _ in range(60):
        control = 2 * torch.rand(20, len(vehicle.control_names), generator=generator) - 1
        if speed is not None:
            control[:, 1] = 0.5
        outcome = traffic.step(cars, control)
        cars, touched = outcome.cars, touched + int(outcome.contact.touched.sum())
        for world in cars.pose.double().view(4, 5, 3).tolist():
            for one in range(5):
                for two in range(one):
                    assert gap_between(world[one], world[two], length, width) >= 0
    assert touched > 10


def square_track():
    return straight_road_track(straight=60.0, width=14.0)


def test_a_push_takes_and_gives_half_of_the_difference_in_speed():
    traffic = straight_traffic(vehicle=Kinematic(max_acceleration=1e-6, max_braking=1e-6), bump=1.0)
    cars = traffic.start(torch.tensor([10.0, 10.0 + LENGTH + 0.5]), speed=torch.tensor([30.0, 20.0]))
    outcome = traffic.step(cars, torch.zeros(2, 2))
    torch.testing.assert_close(outcome.cars.state[:, 3], torch.tensor([25.0, 25.0]), atol=1e-3, rtol=0)
    assert outcome.contact.at_fault.tolist() == [True, False]
    torch.testing.assert_close(outcome.contact.closing_speed, torch.tensor([10.0, 10.0]), atol=1e-2, rtol=0)


def test_gates_count_as_far_as_a_car_has_come():
    traffic = straight_traffic(vehicle=Vehicle(speed=200.0))
    gate = float(traffic.track.gate_stations[0])
    cars = traffic.start(torch.tensor([gate - 12.0, gate - 3.0]))
    cars = replace(cars, next_gate=torch.zeros(2, dtype=torch.int64))
    still = replace(cars, state=cars.state.clone())
    turned = still.state.clone()
    turned[1, 2] = math.pi  # it comes back towards the other one
    outcome = traffic.step(replace(cars, state=turned), steer(torch.tensor([0, 0])))
    assert outcome.contact.touched.all()
    assert outcome.gates_passed.tolist() == [0, 0]
    assert outcome.cars.next_gate.tolist() == [0, 0]


# The whole


def test_cars_far_from_each_other_drive_as_each_would_alone():
    track = straight_road_track()
    traffic, alone = (
        Traffic(track, Vehicle(), Sensor(), cars_per_world=4),
        Simulator(track, Vehicle(), Sensor()),
    )
    cars = traffic.start(torch.arange(8) * track.length / 8)
    for action in (0, 1, 2, 0, 0):
        control = steer(torch.full((8,), action))
        ours, theirs = traffic.step(cars, control), alone.step(cars, control)
        for name in ("state", "next_gate", "gates_passed"):
            assert torch.equal(getattr(ours.cars, name), getattr(theirs.cars, name))
        for name in ("ranges", "collided", "gates_passed"):
            assert torch.equal(getattr(ours, name), getattr(theirs, name))
        assert not ours.contact.touched.any()
        cars = ours.cars


def test_the_machine_code_and_the_torch_code_of_the_walls_serve_alike():
    track = straight_road_track(width=8.0)
    cars = None
    outcomes = []
    for compiled in (True, False):
        traffic = Traffic(track, Vehicle(), Sensor(), cars_per_world=3, compiled=compiled)
        cars = traffic.start(torch.tensor([5.0, 6.5, 8.0, 50.0, 51.5, 60.0]))
        outcomes.append(traffic.step(cars, steer(torch.tensor([0, 1, 2, 0, 0, 0]))))
    torch.testing.assert_close(outcomes[0].ranges, outcomes[1].ranges, atol=1e-4, rtol=0)
    assert torch.equal(outcomes[0].on_car, outcomes[1].on_car)
    assert torch.equal(outcomes[0].contact.other, outcomes[1].contact.other)


@pytest.mark.parametrize("count", [1, 0, 65])
def test_a_world_has_from_2_to_64_cars(count):
    with pytest.raises(ConfigError, match=r"env\.cars_per_world is .*; it must be from 2 to 64"):
        straight_traffic(count)


def test_rows_that_are_no_whole_worlds_are_refused():
    traffic = straight_traffic(3)
    with pytest.raises(ValueError, match="whole worlds"):
        traffic.sense(traffic.start(torch.tensor([10.0, 30.0])))


def test_walls_end_the_sight_of_cars_behind_them():
    track = Track.load("oval")
    traffic = Traffic(track, Vehicle(), Sensor(max_range=100.0), cars_per_world=2)
    cars = traffic.start(torch.tensor([0.0, track.length / 2]))
    _, on_car = traffic.look(cars)
    assert not on_car.any()
