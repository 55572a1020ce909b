"""Which walls a car has near: exactly those that the simulator would find among all, on one track or on many."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from carrl.errors import ConfigError, TrackError
from carrl.sim.collision_geometry import MOST_CELLS, WallGrid
from carrl.sim.geometry import path_clearance, ray_distances
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import CarState, Simulator
from carrl.sim.vehicle import Vehicle
from carrl.tracks.centreline import Centreline
from carrl.tracks.track import Track, builtin_names
from tests.sim.shapes import random_poses, random_track
from tests.sim.steering import FORWARD, steer


def brute_force_ranges(track: Track, pose: torch.Tensor, sensor: Sensor) -> torch.Tensor:
    return ray_distances(pose[:, :2], pose[:, 2:].double() + sensor.angles.double(), track.walls, sensor.max_range)


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("max_range", [0.3, 10.0, 45.0, 3000.0])
@pytest.mark.parametrize("name", [*builtin_names(), 0, 1, 2])
def test_ranges_are_those_among_all_walls(name: str | int, max_range: float, compiled: bool):
    track = Track.load(name) if isinstance(name, str) else Track.random(name)
    sensor = Sensor(max_range=max_range)
    pose = random_poses(track, 300, seed=0)
    pose[0] = torch.tensor([1e6, -1e6, 0.0])  # far off the map
    ranges = Simulator(track, Vehicle(), sensor, compiled=compiled).sense(CarState.at(pose))
    torch.testing.assert_close(ranges, brute_force_ranges(track, pose, sensor), atol=1e-5, rtol=0)


def test_no_ray_on_a_real_circuit_is_off(real_circuits: Path):
    for file in sorted(real_circuits.glob("*.csv")):
        track, sensor = Track.load(file), Sensor()
        if track.bridges:
            continue
        pose = random_poses(track, 400, seed=1)
        ranges = Simulator(track, Vehicle(), sensor).sense(CarState.at(pose))
        assert (ranges - brute_force_ranges(track, pose, sensor)).abs().max() < 1e-4, file.name


def test_memory_does_not_grow_with_the_reach():
    walls = Track.random(3, length=800.0).walls.numpy()
    near, far = (WallGrid.build(walls, reach, touch=1.5) for reach in (10.0, 1000.0))
    assert len(far.entries) < 4 * len(near.entries)


def test_memory_stays_bounded_on_a_huge_map():
    grid = WallGrid.build(1e5 * np.array([[[-1.0, -1.0], [1.0, 1.0]], [[1.0, -1.0], [1.0, 1.0]]]), 10.0, 1.5)
    assert grid.columns * grid.rows == len(grid.list_of_cell) <= 1.01 * MOST_CELLS + grid.columns + grid.rows


def test_more_walls_than_memory_has_room_for_are_refused():
    angle = np.arange(200_000) * 2 * math.pi / 200_000
    points = 500 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    with pytest.raises(TrackError, match="200,000 walls is too finely drawn; leave out points"):
        WallGrid.build(np.stack([points, np.roll(points, -1, axis=0)], axis=1), 10.0, 1.5)


@pytest.mark.parametrize("reach", [1.0, 25.0])
def test_a_list_holds_exactly_the_walls_within_reach_of_its_cell_and_first_those_within_touch(reach: float):
    walls, touch = random_track(5).walls.numpy(), 0.7
    grid = WallGrid.build(walls, reach, touch)
    random = np.random.default_rng(0)
    for place in random.uniform(walls.min((0, 1)) - 2 * reach, walls.max((0, 1)) + 2 * reach, (300, 2)):
        points = torch.from_numpy(place).expand(len(walls), 2)
        distance = path_clearance(points, points, torch.from_numpy(walls)[:, None].double())  # of each wall
        column, row = np.floor((place - grid.low) / grid.cell_size).astype(int)
        inside = 0 <= column < grid.columns and 0 <= row < grid.rows
        begin, touching, end = grid.lists[grid.list_of_cell[row * grid.columns + column] if inside else 0]
        assert set((distance <= reach).nonzero()[:, 0].tolist()) <= set(grid.entries[begin:end].tolist())
        assert set((distance <= touch).nonzero()[:, 0].tolist()) <= set(grid.entries[begin:touching].tolist())
        slack = 2 * math.sqrt(0.5) * grid.cell_size + 1e-3
        assert all(distance[wall] <= reach + slack for wall in grid.entries[begin:end])
        assert (end - begin) % 2 == 0


# Several tracks


@pytest.mark.parametrize("compiled", [True, False])
def test_cars_on_different_tracks_drive_as_each_would_alone(compiled: bool):
    tracks = [Track.load("serpentine"), Track.random(4), Track.load("oval")]
    together = Simulator(tracks, Vehicle(), Sensor(), compiled=compiled)
    generator = torch.Generator().manual_seed(0)
    own = torch.arange(30) % 3
    stations = torch.rand(30, generator=generator, dtype=torch.float64) * together.routes.lengths[own]
    state, plans = together.start(stations, own), torch.randint(3, (40, 30), generator=generator)
    outcomes = []
    for actions in plans:
        outcomes.append(together.step(state, steer(actions)))
        state = outcomes[-1].cars
    for index, track in enumerate(tracks):
        alone, cars = Simulator(track, Vehicle(), Sensor(), compiled=compiled), own == index
        single = alone.start(stations[cars])
        for actions, outcome in zip(plans, outcomes, strict=True):
            expected = alone.step(single, steer(actions[cars]))
            single = expected.cars
            assert torch.equal(outcome.ranges[cars], expected.ranges)
            assert torch.equal(outcome.collided[cars], expected.collided)
            assert torch.equal(outcome.cars.pose[cars], single.pose)
            assert torch.equal(outcome.cars.next_gate[cars], single.next_gate)
        progress = together.progress(state, stations)[cars]
        torch.testing.assert_close(progress, alone.progress(single, stations[cars]), atol=1e-9, rtol=0)
        assert torch.equal(together.has_lapped(state)[cars], alone.has_lapped(single))


def test_a_simulator_without_a_track_is_refused():
    with pytest.raises(ConfigError, match="no track to drive on"):
        Simulator([], Vehicle(), Sensor())


def test_cars_start_beside_the_centreline_within_the_room_that_their_body_has():
    simulator = Simulator(Track.load("oval"), Vehicle(), Sensor(field_of_view=180.0, rays=3))
    state = simulator.start(torch.tensor([10.0, 10.0, 10.0]), offset=torch.tensor([1.0, -1.0, 0.5]))
    left, right = simulator.sense(state)[:, 2], simulator.sense(state)[:, 0]
    torch.testing.assert_close(left, torch.tensor([0.75, 9.25, 5 - 4.25 / 2]), atol=1e-4, rtol=0)
    torch.testing.assert_close(right, 10.0 - left, atol=1e-4, rtol=0)


def test_a_heading_at_the_start_turns_the_car_to_the_left():
    simulator = Simulator(Track.load("oval"), Vehicle(), Sensor())
    straight, turned = (simulator.start(torch.zeros(1), heading=torch.tensor([angle])).pose[0] for angle in (0.0, 0.3))
    torch.testing.assert_close(turned - straight, torch.tensor([0.0, 0.0, 0.3]))


# Bridges


def figure_eight(gate_spacing: float = 15.0) -> Track:
    angle = np.arange(160) * 2 * math.pi / 160
    points = np.stack([70 * np.sin(angle), 45 * np.sin(2 * angle)], axis=1)
    half = np.full(160, 4.0)
    return Track.from_centreline("eight", Centreline(points, half, half), gate_spacing=gate_spacing)


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("turned", ["", "mirrored", "reversed"])
def test_both_roads_of_a_bridge_are_open(turned: str, compiled: bool):
    track = getattr(figure_eight(), turned)() if turned else figure_eight()
    simulator = Simulator(track, Vehicle(time_step=0.05), Sensor(rays=3, field_of_view=2.0), compiled=compiled)
    stations = torch.tensor([sum(stretch) / 2 - 15 for stretch in (track.bridges[0].over, track.bridges[0].under)])
    state = simulator.start(stations)
    for _ in range(60):
        outcome = simulator.step(state, steer(torch.full((2,), FORWARD)))
        state = outcome.cars
        assert not outcome.collided.any()
        assert (outcome.ranges == 10).all(), "no wall of the other road is seen"


@pytest.mark.parametrize("compiled", [True, False])
def test_each_road_of_a_bridge_keeps_its_own_walls(compiled: bool):
    track = figure_eight()
    simulator = Simulator(track, Vehicle(time_step=0.05), Sensor(rays=3), compiled=compiled)
    for stretch in (track.bridges[0].over, track.bridges[0].under):
        stations = torch.linspace(stretch[0] - 30, stretch[1] + 30, 100)
        sides = simulator.sense(simulator.start(stations))[:, [0, 2]]
        torch.testing.assert_close(sides, torch.full((100, 2), 4.0), atol=0.3, rtol=0)


def test_gates_too_far_apart_to_tell_the_roads_of_a_bridge_apart_are_refused():
    with pytest.raises(TrackError, match=r"^track 'eight': the roads at a bridge .* use a smaller gate_spacing"):
        Simulator(figure_eight(gate_spacing=200.0), Vehicle(), Sensor(max_range=100.0))
