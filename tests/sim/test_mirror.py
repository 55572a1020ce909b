"""What a car sees and does is the same the other way round on a track's mirror image."""

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from carrl.sim.sensor import Sensor
from carrl.sim.simulator import CarState, Simulator
from carrl.sim.vehicle import Bicycle, Vehicle
from tests.sim.shapes import random_poses, random_track
from tests.sim.steering import ACTIONS, FORWARD, LEFT, RIGHT, steer

exactly = settings(max_examples=10, deadline=None, derandomize=True)
FLIP = torch.tensor([1.0, -1.0, -1.0])
OTHER = torch.tensor([FORWARD, RIGHT, LEFT])


@exactly
@given(st.integers(0, 19), st.integers(1, 31))
def test_on_the_mirror_image_of_a_track_the_readings_are_those_from_the_other_side(seed, rays):
    track, sensor = random_track(seed), Sensor(rays=rays, max_range=30.0)
    poses = random_poses(track, 40, seed)
    seen, mirrored = (
        Simulator(each, Vehicle(), sensor).sense(CarState.at(pose))
        for each, pose in ((track, poses), (track.mirrored(), poses * FLIP))
    )
    torch.testing.assert_close(mirrored, seen.flip(1), atol=1e-4, rtol=0)


@exactly
@given(st.integers(0, 19), st.lists(st.sampled_from(ACTIONS), min_size=30, max_size=30), st.booleans())
def test_a_mirrored_drive_on_the_mirror_image_passes_the_same_gates_and_ends_alike(seed, actions, bicycle):
    track, vehicle = random_track(seed), Bicycle() if bicycle else Vehicle()
    simulators = [Simulator(each, vehicle, Sensor()) for each in (track, track.mirrored())]
    start = torch.linspace(0, track.length, 9)[:-1].double()
    states = [simulator.start(start) for simulator in simulators]
    driving = torch.ones(8, dtype=torch.bool)
    for action in torch.tensor(actions):
        steps = [action.expand(8), OTHER[action].expand(8)]
        outcomes = [each.step(state, steer(step)) for each, state, step in zip(simulators, states, steps, strict=True)]
        states = [outcome.cars for outcome in outcomes]
        pose, mirrored = (state.pose[driving] for state in states)
        torch.testing.assert_close(mirrored[:, :2], (pose * FLIP)[:, :2], atol=1e-3, rtol=0)
        assert torch.equal(outcomes[0].collided[driving], outcomes[1].collided[driving])
        assert torch.equal(outcomes[0].gates_passed[driving], outcomes[1].gates_passed[driving])
        driving &= ~outcomes[0].collided
