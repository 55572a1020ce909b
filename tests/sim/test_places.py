"""Where cars are along their roads: by hand, against a slow search, and on circuits that come close to themselves."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from carrl.sim.sensor import Sensor
from carrl.sim.simulator import CarState, Simulator
from carrl.sim.vehicle import Vehicle
from carrl.tracks.centreline import Centreline
from carrl.tracks.track import Track
from tests.reference.scalar_places import nearest_near
from tests.sim.shapes import figure_eight, random_track

FAST = Vehicle(speed=50.0)
"""Five metres a step."""


def square_road(side: float = 100.0, left: float = 4.0, right: float = 6.0) -> Track:
    """Counter-clockwise from the origin along +x, with points 10 m apart."""
    along = np.arange(0, side, 10.0)
    zeros, ends = np.zeros_like(along), np.full_like(along, side)
    sides = [(along, zeros), (ends, along), (side - along, ends), (zeros, side - along)]
    points = np.concatenate([np.stack(each, axis=1) for each in sides])
    widths = np.ones(len(points))
    return Track.from_centreline("square", Centreline(points, right * widths, left * widths), gate_spacing=25.0)


def ring(radius: float, points: int = 720, width: float = 10.0) -> Track:
    """A circle, counter-clockwise from (radius, 0)."""
    angle = np.arange(points) * 2 * math.pi / points
    half = np.full(points, width / 2)
    return Track.from_centreline("ring", Centreline(radius * np.stack([np.cos(angle), np.sin(angle)], 1), half, half))


def simulator_on(track: Track, vehicle: Vehicle = FAST) -> Simulator:
    return Simulator(track, vehicle, Sensor(rays=1))


def car_at(x: float, y: float, heading: float, last: float) -> CarState:
    """One car, whose last station was this."""
    return replace(CarState.at(torch.tensor([[x, y, heading]])), station=torch.tensor([last]))


def test_a_place_beside_a_straight():
    place = simulator_on(square_road()).place(car_at(33.0, 2.0, 0.3, last=30.0))
    assert place.station.item() == pytest.approx(33)
    assert place.progress.item() == pytest.approx(3)
    assert place.offset.item() == pytest.approx(2)
    assert place.side.item() == pytest.approx(2 / 4)
    assert place.heading_error.item() == pytest.approx(0.3)


def test_a_place_to_the_right_backwards_and_facing_the_other_way():
    place = simulator_on(square_road()).place(car_at(103.0, 55.0, -0.75 * math.pi, last=160.0))
    assert (place.station.item(), place.progress.item()) == (pytest.approx(155), pytest.approx(-5))
    assert (place.offset.item(), place.side.item()) == (pytest.approx(-3), pytest.approx(-3 / 6))
    assert place.heading_error.item() == pytest.approx(0.75 * math.pi)


def test_progress_goes_on_over_the_start_line_both_ways():
    simulator = simulator_on(square_road())
    assert simulator.place(car_at(0.0 + 3, 0.0, 0.0, last=398.0)).progress.item() == pytest.approx(5)
    assert simulator.place(car_at(0.0, 2.0, 0.0, last=3.0)).progress.item() == pytest.approx(-5)
    assert 0 <= simulator.place(car_at(0.0, 0.0, 0.0, last=399.99)).station.item() < 400


def test_the_direction_of_the_road_turns_evenly_from_the_middle_of_a_corners_sides():
    """Halfway along the last segment before a corner of a quarter turn it has turned by an eighth of it."""
    place = simulator_on(square_road()).place(car_at(95.0, 0.0, 0.0, last=95.0))
    assert place.heading_error.item() == pytest.approx(-math.pi / 8)


def test_a_car_that_is_no_number_has_a_place_and_no_progress():
    place = simulator_on(square_road()).place(car_at(math.nan, 2.0, math.inf, last=30.0))
    assert all(values.isfinite().all() for values in vars(place).values())
    assert (place.station.item(), place.progress.item(), place.offset.item()) == (30, 0, 0)


def test_before_the_first_step_a_car_is_between_two_gates():
    simulator = simulator_on(figure_eight())
    stations = torch.linspace(0.5, simulator.track.length - 0.5, 97, dtype=torch.float64)
    cars = simulator.start(stations)
    assert cars.station is None
    torch.testing.assert_close(simulator.place(cars).station.double(), stations, atol=1e-3, rtol=0)
    assert not simulator.place(cars).progress.any()


def test_unknown_tracks_are_refused():
    simulator = simulator_on(square_road())
    with pytest.raises(IndexError):
        simulator.place(replace(car_at(0.0, 0.0, 0.0, last=0.0), track=torch.tensor([1])))


@pytest.mark.parametrize("name", ["oval", "paper", "serpentine", 0, 1])
def test_places_are_those_of_a_slow_search(name: str | int):
    simulator = simulator_on(random_track(name) if isinstance(name, int) else Track.load(name))
    generator = torch.Generator().manual_seed(1)
    cars = simulator.start(
        simulator.track.length * torch.rand(12, generator=generator, dtype=torch.float64),
        offset=2 * torch.rand(12, generator=generator) - 1,
    )
    moved = cars.state.clone()
    moved[:, :2] += 2 * torch.rand(12, 2, generator=generator) - 1
    last = simulator.place(cars).station
    place = simulator.place(replace(cars, state=moved, station=last))
    points = [tuple(point) for point in simulator.track.centreline.double().tolist()]
    for car in range(12):
        position = tuple(moved[car, :2].double().tolist())
        station, away = nearest_near(points, position, last[car].item(), reach=12.0)
        assert abs(place.offset[car].item()) == pytest.approx(away, abs=1e-3)
        assert place.station[car].item() == pytest.approx(station, abs=0.1)


def laps(simulator: Simulator) -> tuple[Tensor, Tensor, Tensor]:
    """Of a lap of each track forwards and one backwards, 5 m a step, from one side of the road to the other.

    Returns:
        The lengths [B], the progress of each step [T, B], and how far each station is from the one [T, B] that the car
        was put beside.
    """
    lengths = simulator.routes.lengths.repeat(2)
    track = torch.arange(len(simulator.tracks)).repeat(2)
    signed = lengths * torch.tensor([1.0, -1.0]).repeat_interleave(len(simulator.tracks))
    steps = math.ceil(lengths.max() / 5)
    shares = torch.arange(steps + 1, dtype=torch.float64) / steps
    wiggles = (lengths / 125).round()

    def put(step: int) -> CarState:
        beside = 0.9 * torch.sin(2 * math.pi * wiggles * shares[step])
        return simulator.start(signed * shares[step], track, offset=beside.float())

    station, progress, errors = simulator.place(put(0)).station, [], []
    for step in range(1, steps + 1):
        place = simulator.place(replace(put(step), station=station))
        station = place.station
        progress.append(place.progress)
        errors.append((station - signed * shares[step] + 50) % lengths - 50)
    return signed, torch.stack(progress).double(), torch.stack(errors)


def test_a_lap_over_a_bridge_makes_as_much_progress_as_it_is_long():
    signed, progress, errors = laps(simulator_on(figure_eight()))
    torch.testing.assert_close(progress.sum(0), signed, atol=0.01, rtol=0)
    assert errors.abs().max() < 5


def test_a_lap_of_every_real_circuit_makes_as_much_progress_as_it_is_long(real_circuits):
    tracks = [Track.load(path) for path in sorted(real_circuits.glob("*.csv"))]
    assert len(tracks) >= 10
    signed, progress, errors = laps(Simulator(tracks, FAST, Sensor(rays=1)))
    torch.testing.assert_close(progress.sum(0), signed, atol=0.05, rtol=0)
    assert errors.abs().max() < 10


# The road ahead


def test_a_circle_bends_by_one_over_its_radius():
    left, right = simulator_on(ring(50.0)), simulator_on(ring(50.0).reversed())
    stations, begin, spacing = torch.tensor([0.0, 300.0]), torch.tensor([10.0, 40.0]), torch.tensor([2.0, 25.0])
    track = torch.zeros(2, dtype=torch.int64)
    found = left.places.curvatures(track, stations, begin, spacing, 4)
    torch.testing.assert_close(found, torch.full((2, 4), 0.02), atol=1e-4, rtol=0)
    found = right.places.curvatures(track, stations, begin, spacing, 4)
    torch.testing.assert_close(found, torch.full((2, 4), -0.02), atol=1e-4, rtol=0)


def test_a_stretch_about_a_corner_has_all_of_its_turn():
    """Places 20 m apart: of 80, 100 and 120 m the second one is at the corner of a quarter turn."""
    simulator = simulator_on(square_road())
    one = torch.tensor([0])
    found = simulator.places.curvatures(one, torch.tensor([60.0]), torch.tensor([20.0]), torch.tensor([20.0]), 4)
    torch.testing.assert_close(found, torch.tensor([[0.0, math.pi / 2 / 20, 0.0, 0.0]]), atol=1e-6, rtol=0)


def test_a_car_at_rest_is_told_of_the_road_where_it_stands():
    simulator = simulator_on(ring(50.0))
    none = torch.zeros(1)
    found = simulator.places.curvatures(torch.tensor([0]), torch.tensor([7.0]), none, none, 3)
    torch.testing.assert_close(found, torch.full((1, 3), 0.02), atol=1e-4, rtol=0)
