"""The minimum lap: against laps worked out by hand, and against what must be true of it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from shapely.geometry import Polygon

from carrl.errors import ConfigError, TrackError
from carrl.racing.minimum_lap import STARTS, minimum_lap, point_mass_lap
from carrl.racing.replay import drifts
from carrl.racing.speed_profile import forward_backward
from carrl.sim.kinematic import Kinematic
from carrl.sim.single_track import SingleTrack
from carrl.tracks.track import Track
from tests.racing.laps import HALF, RADIUS, SPACING, oval_lap, ring

GRIP = 1.0489 * 9.81


def test_a_point_mass_drives_the_inner_edge_of_a_ring_as_fast_as_it_sticks():
    """The lap of radius r takes 2 pi sqrt(r / (mu g)), which is less the nearer to the middle."""
    car = SingleTrack()
    lap = point_mass_lap(ring(), car, SPACING)
    inner = RADIUS - HALF + car.width / 2
    assert lap.lap_time == pytest.approx(2 * math.pi * math.sqrt(inner / GRIP), rel=1e-3)
    assert lap.at_grip_limit == lap.at_walls == 1.0
    assert lap.line.curvature == pytest.approx(np.full(len(lap.line), 1 / inner), rel=1e-2)
    assert forward_backward(lap.line, car) == pytest.approx(lap.lap_time, rel=1e-3)


def test_on_a_ring_the_car_with_all_its_tyres_is_hardly_slower_than_a_point_mass():
    """Its front wheels are turned, so that they push a little backwards, and its outer corners poke out a little."""
    car = SingleTrack()
    lap, mass = minimum_lap(ring(), car, SPACING), point_mass_lap(ring(), car, SPACING)
    assert 1.001 < lap.lap_time / mass.lap_time < 1.02
    assert lap.at_walls > 0.99


def test_half_the_grid_finds_the_same_time_and_so_do_other_starts():
    lap, track, car = oval_lap(), Track.load("oval"), SingleTrack()
    finer = minimum_lap(track, car, SPACING / 2, coarser=lap)
    assert finer.lap_time == pytest.approx(lap.lap_time, rel=1e-3)
    for start in STARTS[1:]:
        assert minimum_lap(track, car, SPACING, start=start).lap_time == pytest.approx(lap.lap_time, rel=1e-4)


def test_the_mirror_image_of_a_road_takes_the_same_time_and_the_opposite_steering():
    mirrored = minimum_lap(Track.load("oval").mirrored(), SingleTrack(), SPACING)
    assert mirrored.lap_time == pytest.approx(oval_lap().lap_time, rel=1e-4)
    assert mirrored.line.steering == pytest.approx(-oval_lap().line.steering, abs=2e-3)


def test_the_lap_asks_for_nothing_that_the_car_does_not_have():
    line, car = oval_lap().line, SingleTrack()
    middle = (line.speed + np.roll(line.speed, -1)) / 2
    assert (line.acceleration * middle <= car.max_acceleration * car.power_speed * 1.01).all()
    assert (np.abs(line.steering_rate) <= car.steering_rate * 1.0001).all()
    assert (line.grip_used(GRIP) <= 1.001).all()
    assert (line.grip_used(GRIP) > 0.98).mean() > 0.3
    assert (line.distance[1:] > line.distance[:-1]).all() and line.lap_time > line.time[-1]


def test_the_whole_body_stays_between_the_walls_and_touches_them():
    """Within 12 cm, since a wall is taken for a parabola at each station, and an arc joins a straight at once here."""
    line, track, car = oval_lap().line, Track.load("oval"), SingleTrack()
    road = Polygon(track.right_wall.numpy(), [track.left_wall.numpy()])
    bodies = [body_at(car, *pose) for pose in zip(line.x, line.y, line.heading, strict=True)]
    assert all(road.buffer(0.12).covers(body) for body in bodies)
    assert not all(road.buffer(-0.03).covers(body) for body in bodies)


def test_a_margin_costs_time_and_grip_and_power_save_it():
    track, car, time = Track.load("oval"), SingleTrack(), oval_lap().lap_time
    assert minimum_lap(track, car, SPACING, margin=0.5).lap_time > 1.01 * time
    assert minimum_lap(track, replace(car, friction=1.2), SPACING).lap_time < 0.97 * time
    assert minimum_lap(track, replace(car, power_speed=9.0), SPACING).lap_time < 0.995 * time


def test_the_simulator_drives_the_lap_by_its_controls_alone_for_a_while():
    """Open loop, at the limit of grip, the car is within centimetres of the line after 20 m."""
    track, car = Track.load("oval"), SingleTrack()
    fine = minimum_lap(track, car, SPACING / 4, coarser=oval_lap())
    for drift in drifts(fine.line, car, distance=20.0, starts=8):
        assert drift.apart < 0.05
        assert abs(drift.speed) < 0.05


def test_linear_tyres_are_faster_than_there_is_grip_for():
    car = SingleTrack(preset="commonroad_2")
    lap = minimum_lap(Track.load("oval"), car, SPACING)
    assert lap.at_grip_limit is None
    assert lap.lap_time < 0.8 * oval_lap().lap_time
    with pytest.raises(ConfigError, match="a point mass has a limit of grip"):
        point_mass_lap(Track.load("oval"), car, SPACING)


def test_what_it_cannot_be_found_for_is_said():
    oval = Track.load("oval")
    with pytest.raises(ConfigError, match="this is a Kinematic; choose that one"):
        minimum_lap(oval, Kinematic())
    with pytest.raises(ConfigError, match=r"--spacing is 0; it must be more than 0 and at most 26\.6 m here"):
        minimum_lap(oval, SingleTrack(), 0.0)
    with pytest.raises(ConfigError, match="--margin is -1; it must be 0 or more"):
        minimum_lap(oval, SingleTrack(), SPACING, margin=-1.0)
    with pytest.raises(TrackError, match=r"the road is 9\.98 m wide in places, and the car with its margins 11\.61 m"):
        minimum_lap(oval, SingleTrack(), SPACING, margin=5.0)


@pytest.mark.slow
def test_a_real_circuit_takes_what_it_took(real_circuits):
    """A point mass's lap of Norisring was 64.7 s by another programme, with a disc of 1 m for a body."""
    track = Track.load(real_circuits / "Norisring.csv")
    assert point_mass_lap(track, SingleTrack()).lap_time == pytest.approx(64.7, rel=3e-3)


def body_at(car, x, y, heading):
    """The rectangle that the car covers."""
    ahead = np.array([math.cos(heading), math.sin(heading)]) * car.length / 2
    aside = np.array([-math.sin(heading), math.cos(heading)]) * car.width / 2
    return Polygon([[x, y] + a * ahead + b * aside for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))])
