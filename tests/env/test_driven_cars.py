"""Cars with a speed of their own in every environment, with every observation, end and reward that `conf/` has."""

import math

import gymnasium
import numpy as np
import pytest
import torch
from torchrl.envs.utils import check_env_specs

from carrl import ContinuousActions, GymTrackEnv, Start, TrackEnv
from carrl.config import build_terms
from carrl.errors import ConfigError
from carrl.sim.kinematic import Kinematic
from carrl.sim.sensor import Sensor
from carrl.sim.simulator import Simulator
from carrl.sim.single_track import SingleTrack
from carrl.sim.vehicle import Bicycle, Vehicle
from carrl.task.action import make_table
from carrl.task.end import End, EndAtContact, NoProgress, RunningBackwards, SlideAlongWall
from carrl.task.observation import Observation
from carrl.task.reward import Reward
from carrl.tracks.track import Track
from tests.configs import compose

VEHICLES = {"kinematic": Kinematic(), "race": SingleTrack(), "f1tenth": SingleTrack("f1tenth", time_step=0.05)}
OBSERVATIONS = ["gran_turismo", "time_trial", "torcs", "f1tenth", "racer"]
ENDS = ["contact", "gran_turismo", "torcs"]
REWARDS = ["progress", "gran_turismo", "torcs", "torcs_centred", "racing", "lap_time"]


def parts_of(observation: str, end: str, reward: str = "racing") -> dict:
    config = compose(f"observation={observation}", f"end={end}", f"reward={reward}")
    return {
        "observation": Observation(build_terms("observation", config["observation"])),
        "end": End(build_terms("end", config["end"])),
        "reward": Reward(build_terms("reward", config["reward"])),
        "action": ContinuousActions(),
        "sensor": Sensor(mount=0.2),
    }


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("observation", OBSERVATIONS)
@pytest.mark.parametrize("vehicle", VEHICLES.values(), ids=VEHICLES)
def test_torchrl_finds_the_specs_kept(vehicle, observation, end):
    check_env_specs(TrackEnv("oval", 3, seed=0, vehicle=vehicle, max_steps=20, **parts_of(observation, end)))


@pytest.mark.parametrize(
    ("vehicle", "reward"),
    [(VEHICLES["kinematic"], reward) for reward in REWARDS]
    + [(VEHICLES["race"], "racing"), (VEHICLES["f1tenth"], "racing")],
)
def test_rollouts_are_finite_follow_the_seed_and_keep_their_state(vehicle, reward):
    """However the cars are thrown about among the walls, and however often they start anew."""
    start = Start(anywhere=True, offset=0.8, heading_jitter=20.0, speed=6.0, speed_spread=3.0)
    end = End({"contact": SlideAlongWall(), "stands": NoProgress(steps=25, speed=3.0), "back": RunningBackwards(60.0)})
    parts = parts_of("gran_turismo", "torcs", reward) | {"start": start, "vehicle": vehicle, "end": end}
    first, second = (
        TrackEnv("serpentine", 16, seed=3, max_steps=60, **parts).rollout(150, break_when_any_done=False)
        for _ in range(2)
    )
    assert (first == second).all()
    assert all(values.isfinite().all() for values in first.values(True, True) if values.is_floating_point())
    assert first["next", "terminated"].any() and first["next", "truncated"].any()
    assert not (first["next", "terminated"] & first["next", "truncated"]).any()
    length = Track.load("serpentine").length
    assert ((first["station"] >= 0) & (first["station"] < length)).all()
    goes_on = ~first["next", "done"][:, :-1, 0]
    for key in ("station", "stalled", "state"):
        assert torch.equal(first["next", key][:, :-1][goes_on], first[key][:, 1:][goes_on])
    speed = vehicle.state_names.index("speed")
    fresh = first["step"] == 0
    assert first["state"][..., speed][fresh].min() >= 3
    assert first["state"][..., speed][fresh].unique().numel() > 10
    assert not first["stalled"][fresh].any()


def test_one_pushes_on_through_contact_and_no_progress_ends_it():
    """A car that stands ends after as many steps as are said; one that slides along a wall does not."""
    parts = parts_of("racer", "torcs") | {"end": End({"contact": SlideAlongWall(), "no_progress": NoProgress(100)})}
    env = TrackEnv("oval", 2, vehicle=Kinematic(), **parts)
    state, ends, touched = env.reset(), None, False
    for step in range(1, 102):
        state["action"] = torch.tensor([[0.0, 0.0], [0.0, 0.6]])
        state = env.step(state)["next"]
        touched |= bool(state["reward_terms"][1, 1] < 0)
        if state["terminated"].any() and ends is None:
            ends = step, state["terminated"].flatten().tolist()
            break
    assert ends == (100, [True, False])
    assert touched


def test_what_is_no_number_harms_one_car_for_one_step():
    """An action of nan, as a network gives that has diverged, is a contact where the car was."""
    parts = parts_of("gran_turismo", "gran_turismo", "torcs_centred")
    env = TrackEnv("oval", 2, vehicle=Kinematic(), start=Start(speed=10.0), **parts)
    state = env.reset()
    state["action"] = torch.tensor([[math.nan, math.nan], [0.0, 0.0]])
    after = env.step(state)["next"]
    assert all(after[key].isfinite().all() for key in ("state", "station", "reward_terms"))
    assert torch.equal(after["pose"][0], state["pose"][0]) and after["pose"][1, 0] > state["pose"][1, 0] + 0.9
    after["action"] = torch.zeros(2, 2)
    assert env.step(after)["next", "pose"][0, 0] > state["pose"][0, 0]


def test_a_gym_car_that_slides_goes_on_and_one_that_ended_is_to_be_reset():
    parts = parts_of("gran_turismo", "gran_turismo") | {"vehicle": Kinematic()}
    one = GymTrackEnv("oval", **parts)
    one.reset(seed=0)
    contacts = [one.step(np.array([0.3, 1.0], np.float32))[4]["contact"] < 0 for _ in range(80)]
    assert any(contacts) and not all(contacts)
    strict = GymTrackEnv("oval", **(parts | parts_of("gran_turismo", "contact")))
    strict.reset(seed=0)
    while not strict.step(np.array([0.3, 1.0], np.float32))[2]:
        pass
    with pytest.raises(gymnasium.error.ResetNeeded, match="the car has hit a wall"):
        strict.step(np.array([0.3, 1.0], np.float32))


def test_continuous_actions_take_the_controls_that_the_car_has():
    for pedals, names in (("one", ("steer", "pedal")), ("two", ("steer", "throttle", "brake"))):
        env = TrackEnv("oval", 2, vehicle=Kinematic(pedals=pedals), action=ContinuousActions())
        assert env.task.action.control_names == names
        assert env.action_spec.shape == (2, len(names))
    with pytest.raises(ConfigError, match="action sets steer; the vehicle Kinematic is controlled by steer, pedal"):
        TrackEnv("oval", vehicle=Kinematic(), action=ContinuousActions(("steer",)))


def test_a_table_has_every_combination_under_a_name():
    table = make_table({"steer": [0.0, 1.0, -0.3], "pedal": [0.0, 1.0, -1.0]})
    assert table.names[:4] == ["straight_coast", "straight_drive", "straight_brake", "left_coast"]
    assert table.names[-1] == "right_30_brake"
    assert table.controls(torch.tensor([8, 4])).tolist() == [pytest.approx([-0.3, -1.0]), [1.0, 1.0]]
    assert len(make_table({"steer": [0.0, 0.5], "throttle": [-1.0, 1.0], "brake": [-1.0, 0.5]}).names) == 8
    with pytest.raises(ConfigError, match=r"action.settings.pedal is \[0.5, 0.5\]; it must be numbers within -1 and 1"):
        make_table({"steer": [0.0], "pedal": [0.5, 0.5]})


@pytest.mark.parametrize(
    ("start", "vehicle", "message"),
    [
        (Start(speed=5.0), Vehicle(), "start.speed is 5.0; the vehicle Vehicle has no speed in its state"),
        (Start(speed_spread=5.0), Bicycle(), "start.speed_spread is 5.0; the vehicle Bicycle has no speed"),
        (Start(speed=50.0, speed_spread=5.0), Kinematic(), "start.speed is 55 m/s; it must lie between 0 and"),
    ],
)
def test_a_speed_that_the_car_cannot_start_with_is_refused(start, vehicle, message):
    with pytest.raises(ConfigError, match=message):
        TrackEnv("oval", vehicle=vehicle, start=start, action=ContinuousActions())
    with pytest.raises(ConfigError, match=r"start.speed is -1.0; it must be between 0 and"):
        Start(speed=-1.0)


def test_every_car_starts_at_rest_unless_a_speed_is_asked_for():
    vehicle, action = Kinematic(), ContinuousActions()
    speed = vehicle.state_names.index("speed")
    assert not TrackEnv("oval", 4, vehicle=vehicle, action=action).reset()["state"][:, speed].any()
    moving = TrackEnv("oval", 4, vehicle=vehicle, action=action, start=Start(speed=7.0))
    assert moving.reset()["state"][:, speed].tolist() == [7.0] * 4
    assert moving.task.starts_alike


# The mount of the rays


@pytest.mark.parametrize("compiled", [True, False])
def test_rays_from_a_mount_are_those_of_a_car_that_is_so_far_ahead(compiled):
    track = Track.load("paper")
    ahead, middle = (
        Simulator(track, Kinematic(), Sensor(rays=9, mount=mount), compiled=compiled) for mount in (1.5, 0.0)
    )
    cars = ahead.start(torch.linspace(0, 150, 20), heading=torch.linspace(-0.5, 0.5, 20))
    moved = cars.state.clone()
    moved[:, 0] += 1.5 * cars.state[:, 2].cos()
    moved[:, 1] += 1.5 * cars.state[:, 2].sin()
    there = middle.start(torch.linspace(0, 150, 20))
    there.state[:] = moved
    # The places of the second ones are rounded to float32, to 4e-6 m, and rays that graze a wall magnify that.
    torch.testing.assert_close(ahead.sense(cars), middle.sense(there), atol=1e-4, rtol=0)
    outcome = ahead.step(cars, torch.zeros(20, 2))
    torch.testing.assert_close(outcome.ranges, ahead.sense(outcome.cars), atol=1e-6, rtol=0)


def test_a_mount_outside_of_the_car_is_refused():
    with pytest.raises(ConfigError, match=r"sensor.mount is 3; it must be within the car, at most 2.39\d* m from"):
        Simulator(Track.load("oval"), Kinematic(), Sensor(mount=3))
    with pytest.raises(ConfigError, match=r"sensor.mount is nan; it must be a number of metres"):
        Sensor(mount=math.nan)


# What ended an episode


def ended_in_a_row(pose, speed, end, steps=2):
    """The last state of cars at these poses that drive straight on, at this speed, for so many steps."""
    env = TrackEnv("oval", len(pose), vehicle=Kinematic(), action=ContinuousActions(), end=end, seed=0)
    now = env.reset()
    now["state"][:, :3], now["state"][:, 3] = pose, speed
    for _ in range(steps):
        now = env.step(now.set("action", torch.zeros(len(pose), 2)))["next"]
    return now


def test_an_end_that_no_wall_brought_is_no_collision():
    track = Track.load("oval")
    on_road = TrackEnv(track, 1, seed=0).reset()["pose"][0]
    sideways = on_road + torch.tensor([0.0, 0.0, math.pi / 2])
    poses = torch.stack([on_road, sideways])
    after = ended_in_a_row(poses, 30.0, End({"contact": EndAtContact(), "no_progress": NoProgress(100)}), 2)
    assert after["terminated"].flatten().tolist() == after["collided"].flatten().tolist() == [False, True]
    after = ended_in_a_row(poses, 0.0, End({"contact": EndAtContact(), "no_progress": NoProgress(2)}))
    assert after["terminated"].flatten().tolist() == [True, True]
    assert after["collided"].flatten().tolist() == [False, False]
    after = ended_in_a_row(poses, 30.0, End({"contact": SlideAlongWall(), "no_progress": NoProgress(2, speed=1000)}))
    assert after["terminated"].flatten().tolist() == [True, True]
    assert not after["collided"].any()  # a wall ends nothing here


def test_where_walls_alone_end_episodes_nobody_is_told_which_end_it_was():
    assert "collided" not in TrackEnv("oval", 1).reset()
    sliding = TrackEnv(
        "oval", 1, vehicle=Kinematic(), action=ContinuousActions(), end=End({"contact": SlideAlongWall()})
    )
    assert "collided" not in sliding.reset()
