"""Follow-the-gap: against a slow reading of the survey, with other sensors, and for its lap times on its maps."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from carrl.errors import ConfigError
from carrl.evaluation.follow_the_gap import FollowTheGap, follow_the_gap_of
from carrl.evaluation.rollout import rollout_laps
from carrl.sim.sensor import Sensor
from carrl.sim.single_track import SingleTrack
from carrl.task.action import ContinuousActions
from carrl.tracks.track import Track
from tests.reference.follow_the_gap import follow_the_gap
from tests.worlds import make_world

MAPS = Path(__file__).parents[3] / "shared" / "tracks" / "f1tenth"
CAR = SingleTrack("f1tenth", time_step=0.04, contact="corners")
SCANNER = Sensor(1080, math.degrees(4.7), 30.0, noise=0.01)
PUBLISHED = {"aut": 19.10, "esp": 45.78, "gbr": 39.34, "mco": 34.99}
"""Mean lap times, s. Source: Evans et al. 2024, table 4."""


def random_scans(count, beams=1080):
    """Smooth ranges with jumps, as of rooms with doors, [count, beams], m."""
    random = np.random.default_rng(0)
    angle = np.linspace(0, 1, beams)
    scans = []
    for _ in range(count):
        waves = sum(random.uniform(-2, 2) * np.sin(random.uniform(2, 30) * angle + random.uniform(0, 6)) for _ in "abc")
        door = np.abs(angle - random.uniform(0, 1)) < random.uniform(0, 0.2)
        scans.append((random.uniform(1, 6) + waves + 12 * door).clip(0.2, 30.0) + random.normal(0, 0.01, beams))
    return np.array(scans)


def driver(sensor=SCANNER):
    return FollowTheGap(sensor, CAR.max_steering, CAR.max_speed)


def test_it_does_what_the_slow_reading_does():
    scans = random_scans(60)
    controls = driver()(torch.tensor(scans) / SCANNER.max_range).double()
    wanted = torch.tensor([follow_the_gap(scan.tolist()) for scan in scans], dtype=torch.float64)
    torch.testing.assert_close(controls * torch.tensor([0.4189, 20.0]), wanted, atol=1e-5, rtol=0)
    assert wanted[:, 1].unique().tolist() == [3.0, 5.0]
    assert (wanted[:, 0] > 0.1).any() and (wanted[:, 0] < -0.1).any()


def test_a_road_ahead_between_two_walls_is_driven_straight_on_and_fast():
    for rays, view in ((1080, math.degrees(4.7)), (181, 180.0), (31, 120.0)):
        sensor = replace(SCANNER, rays=rays, field_of_view=view)
        across = sensor.angles.sin().abs().clamp(min=1e-3)
        steer, speed = driver(sensor)((1.0 / across).clamp(max=30.0)[None] / 30.0)[0].tolist()
        assert abs(steer) < 0.1
        assert speed == pytest.approx(5 / 20)


def test_it_steers_to_the_side_that_is_free_and_slows_down_for_that():
    for rays in (1080, 181, 31):
        sensor = replace(SCANNER, rays=rays)
        for free in (1, -1):
            ranges = 3 + free * sensor.angles.clamp(-2, 2)
            steer, speed = driver(sensor)(ranges[None] / 30.0)[0].tolist()
            assert free * steer == pytest.approx(0.4 / 0.4189, rel=1e-3)
            assert speed == pytest.approx(3 / 20)


def test_of_two_gaps_it_takes_the_left_one():
    pillar = torch.where(SCANNER.angles.abs() < 0.05, 1.0, 4.0 - 0.5 * SCANNER.angles)
    steer, _ = driver()(pillar[None] / 30.0)[0].tolist()
    assert steer > 0.3


@pytest.mark.parametrize("rays", [1, 3, 7])
def test_few_rays_are_enough_to_say_something(rays):
    controls = driver(replace(SCANNER, rays=rays))(torch.rand(5, rays, generator=torch.Generator().manual_seed(0)))
    assert controls.isfinite().all() and controls.abs().max() <= 1


def test_a_car_that_is_told_no_speed_is_refused():
    with pytest.raises(ConfigError, match=r"follow_the_gap tells a car .* this one has steer, pedal\. Choose vehicle"):
        follow_the_gap_of(make_world(vehicle=SingleTrack(), action=ContinuousActions(("steer", "pedal"))))


def test_a_car_that_looks_backwards_alone_is_refused():
    sensor, action = Sensor(rays=3, field_of_view=30.0, turn=180.0), ContinuousActions(("steer", "speed"))
    with pytest.raises(ConfigError, match=r"follow_the_gap needs rays that look ahead; change sensor\.turn"):
        follow_the_gap_of(make_world(vehicle=CAR, sensor=sensor, action=action))


@pytest.mark.skipif(not MAPS.is_dir(), reason="needs the optional folder ../shared/tracks/f1tenth")
@pytest.mark.parametrize(
    "name", ["aut", *(pytest.param(name, marks=pytest.mark.exhaustive) for name in ("esp", "gbr", "mco"))]
)
def test_it_laps_the_surveys_maps_in_the_surveys_time(name):
    """A lap ends with its last gate, at most a metre before it is complete; the survey's end after 99.5 %."""
    track = Track.load(MAPS / f"{name}.yaml", gate_spacing=1.0)
    world = make_world(track, vehicle=CAR, sensor=SCANNER, action=ContinuousActions(("steer", "speed")))
    world, policy = follow_the_gap_of(world)
    drives = rollout_laps(world, world.simulator(track), policy, 4, lambda _: ())
    assert all(drive.lap_completed for drive in drives)
    mean_time = sum(drive.lap_steps for drive in drives) / len(drives) * CAR.time_step
    assert mean_time == pytest.approx(PUBLISHED[name], rel=0.02)
