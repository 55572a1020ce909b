"""Collisions, gates, laps and progress."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import LineString, Point, Polygon
from torch import Tensor

from carrl.sim.geometry import path_clearance
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import CarState, Outcome, Simulator
from carrl.sim.vehicle import Vehicle
from carrl.tracks.track import Track, builtin_names
from tests.reference.scalar_collision import path_distance, segment_distance
from tests.sim.shapes import as_floats, random_poses, random_track, straight_road_track
from tests.sim.steering import FORWARD, LEFT, RIGHT, steer, tensors, tensors_of

exactly = settings(derandomize=True, deadline=None, max_examples=50)
STRAIGHT_ON = steer(torch.tensor([FORWARD]))
SLOW_AND_AGILE = Vehicle(speed=10.0, time_step=0.05, turn_radius=3.0)
UNDECIDED = 1e-3
"""Distances this close to the body radius, m, may fall to either side by the rounding of float32."""


@pytest.fixture(scope="module", params=[True, False], ids=["compiled", "plain"])
def compiled(request) -> bool:
    return request.param


def simulator_of(track: Track, vehicle: Vehicle = SLOW_AND_AGILE, compiled: bool = True) -> Simulator:
    return Simulator(track, vehicle, Sensor(rays=1), compiled=compiled)


def car(x: float, y: float, heading: float, next_gate: int = 0) -> CarState:
    return replace(CarState.at(torch.tensor([[x, y, heading]])), next_gate=torch.tensor([next_gate]))


def drive(simulator: Simulator, stations: Tensor, metres: float, way: int = 1) -> list[Outcome]:
    """Steers cars along the centreline, forward (`way` 1) or against the driving direction (-1)."""
    track, vehicle = simulator.track, simulator.vehicle
    state = simulator.start(stations)
    if way < 0:
        state = replace(state, state=state.pose + torch.tensor([0, 0, math.pi]))
    at, outcomes = stations.double(), []
    for _ in range(math.ceil(metres / vehicle.step_length)):
        at = track.station_near(state.pose[:, :2], at - 2.0, at + 2.0)
        aim = track.pose_at(at + way * 3.0)[:, :2] - state.pose[:, :2]
        bearing = torch.atan2(aim[:, 1], aim[:, 0]) - state.pose[:, 2]
        bearing = torch.remainder(bearing + math.pi, 2 * math.pi) - math.pi
        action = torch.where(bearing > 0, LEFT, RIGHT)
        action = torch.where(bearing.abs() < vehicle.yaw_per_step / 2, FORWARD, action)
        outcomes.append(simulator.step(state, steer(action)))
        state = outcomes[-1].cars
    return outcomes


# Collisions


def test_the_collision_oracle_agrees_with_shapely():
    generator = torch.Generator().manual_seed(0)
    for ends in (10 * torch.rand(500, 4, 2, generator=generator, dtype=torch.float64)).round(decimals=1).tolist():
        begin, end, first, last = map(tuple, ends)
        for path, wall in [
            ((begin, end), (first, last)),
            ((begin, begin), (first, last)),
            ((begin, end), (last, last)),
        ]:
            expected = LineString(path).distance(LineString(wall))
            assert segment_distance(*path, *wall) == pytest.approx(expected, abs=1e-9)


def test_clearance_is_zero_across_a_wall_and_the_nearest_distance_otherwise():
    wall = torch.tensor([[[0.0, 0.0], [4.0, 0.0]]])
    begins = torch.tensor([[2.0, 3.0], [2.0, 3.0], [-3.0, 4.0], [7.0, 4.0], [1.0, 5.0], [-1.0, 2.0]])
    ends = torch.tensor([[2.0, -3.0], [2.0, 1.0], [-3.0, -4.0], [7.0, 4.0], [3.0, 2.0], [5.0, 2.0]])
    torch.testing.assert_close(path_clearance(begins, ends, wall), torch.tensor([0.0, 1.0, 3.0, 5.0, 2.0, 2.0]))


def test_a_path_through_the_joint_of_two_walls_has_no_clearance():
    walls = torch.tensor([[[-3.0, 3.0], [0.0, 0.0]], [[0.0, 0.0], [3.0, 3.0]]])
    assert path_clearance(torch.tensor([[0.0, 500.0]]), torch.tensor([[0.0, -500.0]]), walls).item() == 0.0


@exactly
@given(st.integers(0, 19), st.floats(-1, 5), st.floats(0.05, 2.0))
def test_nothing_tunnels_at_any_speed(compiled: bool, seed, magnitude, body_radius):
    vehicle = Vehicle(speed=min(10**magnitude, 1e4), body_radius=body_radius)
    simulator = simulator_of(random_track(seed), vehicle, compiled=compiled)
    poses = random_poses(simulator.track, 60, seed)
    outcome = simulator.step(CarState.at(poses), steer(torch.zeros(60, dtype=torch.int64)))
    walls = as_floats(simulator.track.walls)
    ways = zip(poses[:, :2].tolist(), outcome.cars.pose[:, :2].tolist(), strict=True)
    distance = torch.tensor([path_distance(begin, end, walls) for begin, end in ways])
    decided = (distance - body_radius).abs() > UNDECIDED
    assert decided.float().mean() > 0.9
    assert torch.equal(outcome.collided[decided], (distance < body_radius)[decided])


@pytest.mark.parametrize("speed", [10.0, 300.0, 1e4])
def test_nothing_tunnels_on_a_real_circuit(compiled: bool, real_circuits: Path, speed: float):
    simulator = simulator_of(Track.load(real_circuits / "Norisring.csv"), Vehicle(speed=speed), compiled=compiled)
    poses = random_poses(simulator.track, 200, seed=0)
    outcome = simulator.step(CarState.at(poses), steer(torch.zeros(200, dtype=torch.int64)))
    walls = as_floats(simulator.track.walls)
    ways = zip(poses[:, :2].tolist(), outcome.cars.pose[:, :2].tolist(), strict=True)
    distance = torch.tensor([path_distance(begin, end, walls) for begin, end in ways])
    decided = (distance - 0.5).abs() > UNDECIDED
    assert torch.equal(outcome.collided[decided], (distance < 0.5)[decided])


@pytest.mark.parametrize("speed", [10.0, 100.0, 1e4])
@pytest.mark.parametrize("name", builtin_names())
def test_a_car_that_never_collided_is_on_the_road_whatever_it_did(compiled: bool, name: str, speed: float):
    track = Track.load(name)
    simulator = simulator_of(track, Vehicle(speed=speed), compiled=compiled)
    rings = [Polygon(side.double().numpy()) for side in (track.left_wall, track.right_wall)]
    road = rings[0].symmetric_difference(rings[1])
    generator = torch.Generator().manual_seed(0)
    state, alive = simulator.start(torch.rand(64, generator=generator) * track.length), torch.ones(64, dtype=torch.bool)
    for _ in range(30):
        outcome = simulator.step(state, steer(torch.randint(0, 3, (64,), generator=generator)))
        state, alive = outcome.cars, alive & ~outcome.collided
        assert all(road.contains(Point(x, y)) for x, y in state.pose[alive, :2].tolist())
    assert not alive.all()


@pytest.mark.parametrize(("y", "collided"), [(0.0, False), (4.49, False), (4.51, True), (-4.49, False), (-4.51, True)])
def test_coming_within_the_body_radius_of_a_wall_collides(compiled: bool, y: float, collided: bool):
    outcome = simulator_of(straight_road_track(width=10.0), compiled=compiled).step(car(50.0, y, 0.0), STRAIGHT_ON)
    assert outcome.collided.item() is collided


def test_a_step_out_through_one_wall_and_the_next_collides_though_it_ends_far_away(compiled: bool):
    outcome = simulator_of(straight_road_track(), Vehicle(speed=1e4), compiled=compiled).step(
        car(50.0, 0.0, math.pi / 2), STRAIGHT_ON
    )
    assert outcome.cars.pose[0, 1].item() == pytest.approx(1000.0)
    assert outcome.collided.item()


# Gates


def test_a_gate_counts_once_when_crossed_forward_and_the_following_one_counts_next(compiled: bool):
    track = straight_road_track()
    gate_x = track.gates[0, :, 0].mean().item()
    simulator = simulator_of(track, compiled=compiled)
    before = simulator.step(car(gate_x - 1.2, 1.0, 0.0), STRAIGHT_ON)
    assert (before.gates_passed.item(), before.cars.next_gate.item()) == (0, 0)
    outcome = simulator.step(car(gate_x - 0.2, 1.0, 0.0), STRAIGHT_ON)
    assert outcome.gates_passed.item() == 1
    assert (outcome.cars.next_gate.item(), outcome.cars.gates_passed.item()) == (1, 1)
    after = simulator.step(outcome.cars, STRAIGHT_ON)
    assert (after.gates_passed.item(), after.cars.gates_passed.item()) == (0, 1)


def test_going_back_and_forth_over_a_gate_earns_nothing_more(compiled: bool):
    track = straight_road_track()
    gate_x = track.gates[0, :, 0].mean().item()
    simulator, state = simulator_of(track, compiled=compiled), car(gate_x - 0.2, 0.0, 0.0)
    earned = []
    for turn in range(20):
        back_and_forth = torch.tensor([[gate_x - 0.2, 0.0, 0.0], [gate_x + 0.2, 0.0, math.pi]])[turn % 2]
        outcome = simulator.step(replace(state, state=back_and_forth[None]), STRAIGHT_ON)
        state = outcome.cars
        earned.append(outcome.gates_passed.item())
    assert earned == [1] + [0] * 19


def test_a_gate_crossed_backward_does_not_count_even_if_it_is_the_next(compiled: bool):
    track = straight_road_track()
    gate_x = track.gates[0, :, 0].mean().item()
    outcome = simulator_of(track, compiled=compiled).step(car(gate_x + 0.2, 0.0, math.pi), STRAIGHT_ON)
    assert outcome.gates_passed.item() == 0


def test_crossing_the_line_of_a_gate_beyond_its_ends_does_not_count(compiled: bool):
    track = straight_road_track(width=10.0)
    gate_x = track.gates[0, :, 0].mean().item()
    for y in (-8.0, 8.0, 30.0):  # outside the road, clear of the walls
        outcome = simulator_of(track, compiled=compiled).step(car(gate_x - 0.2, y, 0.0), STRAIGHT_ON)
        assert not outcome.collided.item()
        assert outcome.gates_passed.item() == 0


@pytest.mark.parametrize("next_gate", range(4))
def test_several_gates_crossed_in_one_step_count_in_order_from_the_next_one(compiled: bool, next_gate: int):
    track = straight_road_track(gate_count=32)
    xs = track.gates[:4, :, 0].mean(dim=1).tolist()
    begin, end = xs[0] - 1, xs[2] + 1
    vehicle = Vehicle(speed=end - begin, time_step=1.0)
    outcome = simulator_of(track, vehicle, compiled=compiled).step(car(begin, 0.0, 0.0, next_gate), STRAIGHT_ON)
    assert not outcome.collided.item()
    assert outcome.gates_passed.item() == 3 - next_gate
    assert outcome.cars.next_gate.item() == 3


def test_the_last_gate_and_the_first_count_together_in_one_step(compiled: bool):
    track = straight_road_track(gate_count=32)
    first_x = track.gates[0, :, 0].mean().item()
    vehicle = Vehicle(speed=first_x + 4, time_step=1.0)
    outcome = simulator_of(track, vehicle, compiled=compiled).step(car(-2.0, 0.0, 0.0, next_gate=31), STRAIGHT_ON)
    assert outcome.gates_passed.item() == 2
    assert outcome.cars.next_gate.item() == 1


def test_a_step_that_collides_passes_no_gate(compiled: bool):
    track = straight_road_track(gate_count=32)
    gate_x = track.gates[0, :, 0].mean().item()
    grazing = simulator_of(track, compiled=compiled).step(car(gate_x - 0.2, 4.6, 0.0), STRAIGHT_ON)
    far = simulator_of(track, Vehicle(speed=1e4), compiled=compiled).step(car(gate_x - 0.2, 0.0, 0.0), STRAIGHT_ON)
    for outcome in (grazing, far):
        assert outcome.collided.item()
        assert outcome.gates_passed.item() == 0
        assert (outcome.cars.next_gate.item(), outcome.cars.gates_passed.item()) == (0, 0)


@exactly
@given(st.integers(0, 10**6), st.floats(1, 1500), st.integers(3, 150))
def test_the_count_of_gates_equals_that_of_one_crossing_at_a_time(compiled: bool, seed, speed, gate_count):
    track = straight_road_track(gate_count=gate_count)
    simulator = simulator_of(track, Vehicle(speed=speed, body_radius=0.01), compiled=compiled)
    generator = torch.Generator().manual_seed(seed)
    start = simulator.start(track.length * torch.rand(30, generator=generator))
    turned = replace(start, state=start.pose + 0.1 * torch.randn(30, 3, generator=generator))
    outcome = simulator.step(turned, steer(torch.zeros(30, dtype=torch.int64)))
    gates = as_floats(track.gates)
    for index in (~outcome.collided).nonzero().flatten().tolist():
        begin, end = turned.pose[index, :2].tolist(), outcome.cars.pose[index, :2].tolist()
        count = 0
        while count < gate_count:
            left, right = gates[(turned.next_gate[index].item() + count) % gate_count]
            forward = (left[1] - right[1]) * (end[0] - begin[0]) - (left[0] - right[0]) * (end[1] - begin[1]) > 0
            if not (forward and LineString([begin, end]).intersects(LineString([left, right]))):
                break
            count += 1
        assert outcome.gates_passed[index].item() == count


# Laps and progress


@pytest.mark.parametrize("name", builtin_names())
def test_a_lap_passes_every_gate_once_in_order_from_any_start(name: str):
    track = Track.load(name)
    stations = torch.tensor([0.0, 0.05, 1.0, 0.4, 0.77, 0.999]) * track.length
    outcomes = drive(simulator_of(track), stations, track.length + 3.0)
    assert not any(outcome.collided.any() for outcome in outcomes)
    passed = torch.stack([outcome.gates_passed for outcome in outcomes])
    following = torch.stack([outcome.cars.next_gate for outcome in outcomes])
    steps_per_gate = track.length / track.gate_count / SLOW_AND_AGILE.step_length
    for index, first in enumerate(track.next_gate(stations).tolist()):
        passing = passed[:, index].nonzero().flatten()[: track.gate_count]
        in_order = [(first + count) % track.gate_count for count in range(1, track.gate_count + 1)]
        assert following[passing, index].tolist() == in_order
        assert (passed[:, index] <= 1).all()
        assert passing.diff().min() > 0.9 * steps_per_gate
        assert passing.diff().max() < 1.1 * steps_per_gate


def test_a_second_lap_passes_every_gate_once_more():
    track = Track.load("oval")
    outcomes = drive(simulator_of(track), torch.tensor([10.0]), 2 * track.length)
    assert outcomes[-1].cars.gates_passed.item() == 2 * track.gate_count


@pytest.mark.parametrize("name", builtin_names())
def test_driving_the_wrong_way_round_earns_nothing_in_a_whole_lap(name: str):
    track = Track.load(name)
    stations = torch.tensor([0.0, 0.3, 0.6, 0.9]) * track.length
    simulator = simulator_of(track)
    outcomes = drive(simulator, stations, track.length + 3.0, way=-1)
    assert not any(outcome.collided.any() for outcome in outcomes)
    assert all((outcome.gates_passed == 0).all() for outcome in outcomes)
    most = max(simulator.progress(outcome.cars, stations).max().item() for outcome in outcomes)
    assert most <= 1 / track.gate_count + 1e-6


@pytest.mark.parametrize("name", builtin_names())
def test_progress_starts_at_zero_grows_with_the_way_and_is_one_after_a_lap(name: str):
    track = Track.load(name)
    simulator = simulator_of(track)
    stations = torch.tensor([0.0, 0.1, 0.47, 0.8, 0.9999], dtype=torch.float64) * track.length
    assert simulator.progress(simulator.start(stations), stations).tolist() == pytest.approx([0] * 5, abs=1e-6)
    states = [outcome.cars for outcome in drive(simulator, stations, track.length + 1.0)]
    progress = torch.stack([simulator.progress(state, stations) for state in states])
    driven = simulator.vehicle.step_length * torch.arange(1, len(states) + 1)[:, None] / track.length
    sample = 0.2 / track.length  # the search along the centreline goes in steps of about 0.1 m
    assert (progress.diff(dim=0) >= -sample).all()
    assert (progress <= 1).all()
    assert (progress[-1] == 1).all()
    under_way = progress < 1
    assert (progress - driven)[under_way].abs().max() < 0.02
    lap_ends = torch.stack([state.gates_passed for state in states]) >= track.gate_count
    assert not under_way[lap_ends].any()
    # A start less than 0.1 m before a gate has it behind, so its lap ends that much beyond the start.
    assert (~under_way & ~lap_ends).sum(dim=0).max() <= 1


def test_progress_half_way_round_is_a_half():
    track = Track.load("oval")
    state = simulator_of(track).start(torch.tensor([0.0]))
    half_way = replace(state, state=track.pose_at(torch.tensor([track.length / 2])), gates_passed=torch.tensor([4]))
    assert simulator_of(track).progress(half_way, torch.tensor([0.0])).item() == pytest.approx(0.5, abs=1e-3)


def test_progress_counts_only_as_far_as_the_gates_vouch():
    track = Track.load("oval")
    start = simulator_of(track).start(torch.tensor([0.0]))
    teleported = replace(start, state=track.pose_at(torch.tensor([track.length / 2])))
    assert simulator_of(track).progress(teleported, torch.tensor([0.0])).item() <= 1 / track.gate_count


def test_progress_is_measured_on_its_own_stretch_where_the_road_comes_close_to_itself():
    track = Track.load("serpentine")
    points = track.pose_at(torch.arange(0.0, track.length, 2.0))
    simulator = simulator_of(track)
    stations = torch.arange(0.0, track.length, 2.0)
    gate_gap = track.length / track.gate_count
    passed = (stations.double() / gate_gap).floor().long()
    state = replace(CarState.at(points), next_gate=passed % track.gate_count, gates_passed=passed)
    share = simulator.progress(state, torch.zeros(len(stations)))
    torch.testing.assert_close(share * track.length, stations.double(), atol=0.1, rtol=0)


@pytest.mark.parametrize("count", [1, 7, 8, 16])
def test_a_car_started_at_a_gate_has_it_behind_and_the_following_one_ahead(count: int):
    track = straight_road_track(gate_count=count)
    assert track.next_gate(track.gate_stations).tolist() == [(gate + 1) % count for gate in range(count)]
    assert track.next_gate(torch.tensor([0.0, track.length, -1.0])).tolist() == [0, 0, count - 1]


def test_a_car_started_just_short_of_a_gate_on_a_real_circuit_has_not_passed_its_line_unseen(real_circuits: Path):
    for file in ("MoscowRaceway", "Norisring", "Spa", "MexicoCity"):
        track = Track.load(real_circuits / f"{file}.csv")
        for short in torch.linspace(0, 1, 41, dtype=torch.float64):
            stations = track.gate_stations - short
            position, gates = track.pose_at(stations)[:, :2], track.gates
            across, reach = gates[:, 1] - gates[:, 0], position - gates[:, 0]
            is_short_of_line = across[:, 0] * reach[:, 1] - across[:, 1] * reach[:, 0] < 0
            counts_next = track.next_gate(stations) == torch.arange(track.gate_count)
            assert (is_short_of_line | ~counts_next).all()


# The simulator as a function


def test_the_same_call_twice_gives_the_same_result_and_leaves_its_inputs_alone(compiled: bool):
    simulator = Simulator(Track.load("paper"), Vehicle(), Sensor(), compiled=compiled)
    state = simulator.start(torch.linspace(0, 200, 16))
    kept = state.map(torch.clone)
    action = torch.arange(16) % 3
    first = simulator.step(state, steer(action))
    simulator.step(first.cars, steer(action))
    second = simulator.step(state, steer(action))
    assert all(map(torch.equal, tensors(first), tensors(second)))
    assert all(map(torch.equal, tensors_of(state), tensors_of(kept)))


@exactly
@given(st.integers(0, 19), st.integers(1, 20), st.floats(1, 2000))
def test_cars_side_by_side_fare_as_each_does_alone(compiled: bool, seed, count, speed):
    simulator = Simulator(random_track(seed), Vehicle(speed=speed), Sensor(), compiled=compiled)
    generator = torch.Generator().manual_seed(seed)
    state = simulator.start(simulator.track.length * torch.rand(count, generator=generator))
    action = torch.randint(0, 3, (count,), generator=generator)
    together = simulator.step(state, steer(action))
    for index in range(count):
        alone = simulator.step(state[index : index + 1], steer(action[index : index + 1]))
        assert all(torch.equal(a[index], b[0]) for a, b in zip(tensors(together), tensors(alone), strict=True))


def test_a_step_reports_the_ranges_of_the_pose_it_ends_in_and_the_stated_types(compiled: bool):
    simulator = Simulator(Track.load("paper"), Vehicle(), Sensor(), compiled=compiled)
    outcome = simulator.step(simulator.start(torch.zeros(2)), steer(torch.tensor([0, 1])))
    assert torch.equal(outcome.ranges, simulator.sense(outcome.cars))
    assert outcome.ranges.shape == (2, 7)
    types = [torch.float32, *[torch.int64] * 3, torch.float32, torch.bool, torch.int64]
    assert [tensor.dtype for tensor in tensors(outcome)] == types


def test_no_cars_at_all_make_an_empty_step(compiled: bool):
    simulator = Simulator(Track.load("paper"), Vehicle(), Sensor(), compiled=compiled)
    outcome = simulator.step(simulator.start(torch.zeros(0)), steer(torch.zeros(0, dtype=torch.int64)))
    assert outcome.ranges.shape == (0, 7)
    assert simulator.progress(outcome.cars, torch.zeros(0)).shape == (0,)


def test_lap_steps_is_the_least_number_of_steps_that_covers_the_centreline():
    simulator = Simulator(Track.load("oval"), Vehicle(speed=10.0, time_step=0.1), Sensor())
    assert simulator.lap_steps - 1 < simulator.track.length <= simulator.lap_steps
