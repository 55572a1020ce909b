"""`experiment=f1tenth` keeps the rules of the F1TENTH survey (Evans et al. 2024)."""

import math

import pytest
import torch

from carrl.train.build import build_world
from tests.configs import compose


@pytest.fixture(scope="module")
def world():
    return build_world(compose("experiment=f1tenth", "track.name_or_path=oval"))


def test_the_rays_are_every_54th_of_1080_beams_over_4_7_rad(world):
    beams = torch.linspace(-2.35, 2.35, 1080, dtype=torch.float64)
    torch.testing.assert_close(world.sensor.angles.double(), beams[::54], atol=1e-5, rtol=0)
    assert (world.sensor.max_range, world.sensor.noise) == (10.0, 0.01)


def test_actions_are_steering_angles_of_at_most_0_4_rad_and_speeds_from_1_to_8(world):
    low, middle, high = world.action.controls(torch.tensor([[-1.0, -1.0], [0.0, 0.0], [1.0, 1.0]])).double()
    unit = torch.tensor([world.vehicle.max_steering, world.vehicle.max_speed], dtype=torch.float64)
    expected = torch.tensor([[-0.4, 1.0], [0.0, 4.5], [0.4, 8.0]], dtype=torch.float64)
    torch.testing.assert_close(torch.stack([low, middle, high]) * unit, expected, atol=1e-5, rtol=0)


def test_a_control_lasts_0_04_s_of_steps_of_0_01_s(world):
    vehicle = world.vehicle
    assert (vehicle.time_step, vehicle.substeps, vehicle.integrator) == (0.04, 4, "euler")
    assert (vehicle.body.length, vehicle.body.width, vehicle.friction) == (0.58, 0.31, 1.0489)


def test_it_sees_the_newer_scan_the_older_one_and_the_speed_as_a_share_of_8(world):
    simulator = world.simulator(world.track)
    task = world.evaluation_task(simulator, 2)
    now = task.start_at(simulator.start(torch.tensor([0.0, 40.0]), speed=torch.tensor([4.0, 8.0])))
    assert now.observation.shape == (2, 41)
    assert torch.equal(now.observation[:, :20], now.observation[:, 20:40])
    assert now.observation[:, 40].tolist() == [0.5, 1.0]
    after = task.step(now.state, torch.tensor([[0.0, 1.0], [0.5, -1.0]]))
    assert torch.equal(after.observation[:, 20:40], now.observation[:, :20])
    noise = after.observation[:, :20] - simulator.sense(after.state.cars) / 10
    assert 0 < noise.abs().max() < 5 * 0.001
    speed = after.state.cars.state[:, 3]
    torch.testing.assert_close(after.observation[:, 40], speed / 8)
    assert speed[0] > 4 and speed[1] < 8
    assert math.isclose(float(after.state.cars.state[0, 6]), 0.0, abs_tol=1e-6)
