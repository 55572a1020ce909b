"""The equations for CasADi are the simulator's."""

import casadi
import numpy as np
import pytest
import torch

from carrl.racing.equations import RATES
from carrl.racing.models import Car
from carrl.sim.single_track import SingleTrack

CARS = [
    {"preset": "race"},
    {"preset": "race", "tyre": "linear"},
    {"preset": "commonroad_2"},
    {"preset": "commonroad_2", "tyre": "brush"},
    {"preset": "f1tenth"},
    {"preset": "f1tenth", "tyre": "brush"},
]
STATES = 2000


@pytest.mark.parametrize("options", CARS, ids=lambda options: "-".join(options.values()))
def test_rates_are_those_of_the_simulator_on_random_motions(options):
    """Also of cars that slide sideways or are slower than the speed that slip is taken against."""
    car = SingleTrack(**options)
    motion, steering, drive = random_motions(car)
    found = rates_by_casadi(car, motion, steering, drive)
    turning = torch.zeros(len(motion), dtype=torch.float64)
    wanted = car.rates(*map(torch.from_numpy, (motion, steering)), turning, torch.from_numpy(drive))
    np.testing.assert_allclose(found, wanted[:, :6].numpy(), rtol=1e-9, atol=1e-9)


def test_random_motions_have_tyres_that_slide_and_that_do_not():
    """So that no branch of the equations goes unseen."""
    car = SingleTrack()
    motion, steering, drive = random_motions(car)
    rates = rates_by_casadi(car, motion, steering, drive)
    pushes = rates[:, 4] + motion[:, 5] * motion[:, 3]
    grip = car.friction * 9.81
    assert (np.abs(pushes) > 0.95 * grip * np.sqrt(1 - (drive / grip) ** 2)).any()
    assert (np.abs(pushes) < 0.5 * grip).any()
    assert (motion[:, 3] < car.slip_speed).any()


def random_motions(car):
    """Motions [B, 6], steering angles [B] and accelerations asked for that the car can give, [B].

    A front wheel across the way, which brakes hold, is left out: the minimum lap has none.
    """
    generator = np.random.default_rng(5)
    model = Car(car)
    moving, steering = model.states[0], model.states[-1]
    full = car.max_speed
    speed = generator.uniform(1.01 * moving.low, 0.95 * full, STATES)
    sideways = generator.uniform(-0.3, 0.3, STATES) * (speed if car.tyre == "brush" else 1.0)
    place = generator.uniform(-1, 1, (STATES, 3)) * [100, 100, np.pi]
    motion = np.column_stack([place, speed, sideways, generator.uniform(-2, 2, STATES)])
    strongest = model.controls[1].high
    most = np.minimum(strongest, car.max_acceleration * car.power_speed / np.maximum(speed, car.power_speed))
    missing = (full**2 - speed**2 - sideways**2) * 20 / (2 * full) if car.tyre == "brush" else np.inf
    drive = generator.uniform(-strongest, np.minimum(most, missing))
    angle = generator.uniform(-1, 1, STATES) * min(steering.high, 0.5)
    front = speed * np.cos(angle) + (sideways + car.front_axle * motion[:, 5]) * np.sin(angle)
    rolls = (front > moving.low) | (car.tyre == "linear")
    assert rolls.mean() > 0.95
    return motion[rolls], angle[rolls], drive[rolls]


def rates_by_casadi(car, motion, steering, drive):
    state, angle, asked = casadi.SX.sym("state", 6), casadi.SX.sym("angle"), casadi.SX.sym("asked")
    rates = RATES[car.tyre](car, casadi.vertsplit(state), angle, asked)
    function = casadi.Function("rates", [state, angle, asked], [casadi.vertcat(*rates)])
    return np.array(function.map(len(motion))(motion.T, steering[None], drive[None])).T
