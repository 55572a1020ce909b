"""What drivers of cars with a speed of their own are told and paid, and what ends their episodes: worked by hand."""

import math

import pytest
import torch

from carrl.errors import ConfigError
from carrl.sim.kinematic import Kinematic
from carrl.sim.vehicle import Vehicle
from carrl.task.end import End, EndAtContact, NoProgress, RunningBackwards, SlideAlongWall
from carrl.task.motion import LastControl, StateEntry, Velocity, WallContact
from carrl.task.observation import Observation, Rays, Scans
from carrl.task.racing import Contact, Progress, SpeedAlong, Time
from carrl.task.reward import Reward, Steering
from carrl.task.road import Curvatures, HeadingError, TrackPosition
from carrl.task.task import make_task
from carrl.task.trial import try_terms
from tests.task.moments import ACTIONS, cars_with, moment, simulator, step_of, value

SENSOR = simulator().sensor

# Observations


def test_an_entry_of_the_state_is_told_in_its_unit():
    assert value(StateEntry("speed", 20.0)(moment(speed=30.0))) == 1.5
    assert value(StateEntry("lateral_acceleration", 10.0)(moment(lateral_acceleration=-5.0))) == -0.5


def test_the_velocity_is_told_along_the_heading_and_to_the_left():
    told = Velocity(10.0)(moment(speed=20.0, slip=math.pi / 6))
    assert told.tolist() == [pytest.approx([2 * math.cos(math.pi / 6), 1.0])]


def test_the_last_command_is_told_and_not_the_wheel():
    assert value(LastControl("steer")(moment(last_action=(-0.25, 0.5), steering=0.1))) == -0.25
    assert value(LastControl("pedal")(moment(last_action=(-0.25, 0.5)))) == 0.5
    with pytest.raises(ConfigError, match=r"observation.last.control is 'gear'; the vehicle has steer, pedal"):
        LastControl("gear").part("last", SENSOR, ACTIONS)


def test_the_heading_error_is_told_to_the_left_of_the_road():
    assert value(HeadingError(unit=0.5)(moment(x=33.0, heading=0.3))) == pytest.approx(0.6)
    assert value(HeadingError()(moment(x=33.0, heading=-math.pi / 2))) == pytest.approx(-0.5)


@pytest.mark.parametrize(("y", "position"), [(2.0, 0.5), (-3.0, -0.5), (4.0, 1.0), (-6.0, -1.0), (0.0, 0.0)])
def test_the_track_position_is_a_share_of_the_room_on_that_side(y, position):
    assert value(TrackPosition()(moment(last_station=33.0, x=33.0, y=y))) == pytest.approx(position)


def test_curvatures_are_those_of_the_road_ahead_at_the_present_speed():
    """At 20 m/s from 60 m on, places at 80, 100 and 120 m: of the quarter turn at 100 m, each over 20 m."""
    told = Curvatures(count=3, from_s=1.0, spacing_s=1.0, radius=50.0)(moment(last_station=60.0, x=60.0, speed=20.0))
    assert told.tolist() == [pytest.approx([0, 50 * math.pi / 2 / 20, 0], abs=1e-4)]
    told = Curvatures(count=2, from_s=2.0, spacing_s=1.0)(moment(last_station=60.0, x=60.0, speed=0.0))
    assert told.tolist() == [pytest.approx([0, 0], abs=1e-4)]


def test_wall_contact_is_told_of_the_last_step_alone():
    seen = moment()
    assert value(WallContact()(seen)) == 0
    seen.state.contact = torch.tensor([True])
    assert value(WallContact()(seen)) == 1


def test_scans_are_told_the_newest_first_and_at_a_start_the_first_one_again():
    seen, (three,) = moment(x=33.0), Rays()(moment(x=33.0)).tolist()
    assert Scans(3)(seen).tolist() == [three * 3]
    seen.seen = torch.arange(9.0)[None]
    assert Scans(3)(seen).tolist() == [[*three, 0, 1, 2, 3, 4, 5]]


def test_scans_of_an_episode_are_those_that_were_seen_even_where_the_sensor_errs():
    from carrl.sim.sensor import Sensor

    observation = Observation({"speed": StateEntry("speed"), "scans": Scans(3), "last": LastControl("steer")})
    noisy = Sensor(rays=3, noise=0.1)
    parts = {"vehicle": Kinematic(), "sensor": noisy, "action": ACTIONS, "observation": observation}
    task = make_task("oval", 4, [0], **parts)
    start = task.start()
    now, told = start, [start.observation]
    for _ in range(4):
        now = task.step(now.state, torch.tensor([[0.1, 1.0]]).expand(4, 2))
        told.append(now.observation)
    scans = torch.stack(told)[:, :, 1:10].unflatten(-1, (3, 3))
    assert not torch.equal(scans[1, :, 0], scans[0, :, 0])
    for step in range(2, 5):
        assert torch.equal(scans[step, :, 1], scans[step - 1, :, 0])
        assert torch.equal(scans[step, :, 2], scans[step - 2, :, 0])
    assert torch.equal(scans[1, :, 2], scans[0, :, 0])


@pytest.mark.parametrize(
    ("term", "message"),
    [
        (lambda: StateEntry("speed", 0.0), "unit of StateEntry is 0.0; it must be a positive number"),
        (lambda: Curvatures(count=0), "count of Curvatures is 0"),
        (lambda: Curvatures(from_s=-1.0), "from_s of Curvatures is -1.0"),
        (lambda: Scans(0), "count of Scans is 0"),
        (lambda: NoProgress(steps=0), "steps of NoProgress is 0"),
        (lambda: SlideAlongWall(1.5), "kept of SlideAlongWall is 1.5; it must be a share between 0 and 1"),
        (lambda: RunningBackwards(190.0), "angle of RunningBackwards is 190.0"),
        (
            lambda: End({"backwards": RunningBackwards()}),
            "exactly one term that says what touching a wall",
        ),
        (lambda: End({"a": EndAtContact(), "b": SlideAlongWall()}), "end has both a and b"),
    ],
)
def test_a_value_that_cannot_be_is_refused(term, message):
    with pytest.raises(ConfigError, match=message):
        term()


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (
            {"observation": Observation({"v": StateEntry("speed")})},
            r"observation.v: a term wants the speed of the car; the state of the vehicle Vehicle has x, y, heading",
        ),
        ({"reward": Reward({"wall": Contact()})}, r"reward.wall: a term wants the speed of the car"),
        ({"reward": Reward({"road": SpeedAlong()})}, r"reward.road: a term wants the speed of the car"),
    ],
)
def test_a_term_that_the_vehicle_has_no_value_for_is_named(parts, message):
    with pytest.raises(ConfigError, match=message):
        try_terms(make_task("oval", 2, vehicle=Vehicle(), **parts))


def test_a_term_that_does_not_say_what_it_needs_is_named():
    class Beside:
        def __call__(self, step):
            return step.outcome.offset

    with pytest.raises(ConfigError, match=r'reward.own: a term asks where .* must say `needs = \("place",\)`'):
        try_terms(make_task("oval", 2, reward=Reward({"own": Beside()})))


# Rewards

BEFORE = cars_with(30.0, x=30.0, speed=20.0)


def test_progress_pays_by_the_metre_and_takes_it_back():
    ahead, back = cars_with(0.0, x=31.5, y=2.0), cars_with(0.0, x=29.0, y=-3.0)
    assert value(Progress(2.0)(step_of(BEFORE, ahead))) == pytest.approx(3.0)
    assert value(Progress(2.0)(step_of(BEFORE, back))) == pytest.approx(-2.0)


def test_contact_costs_by_the_square_of_the_speed_before():
    after = cars_with(0.0, x=31.0, speed=5.0)
    assert value(Contact(-0.2, -0.01)(step_of(BEFORE, after, collided=True))) == pytest.approx(-0.2 - 0.01 * 400)
    assert value(Contact(-0.2, -0.01)(step_of(BEFORE, after))) == 0
    assert value(Contact(-0.2, 0.0)(step_of(BEFORE, after, collided=True))) == pytest.approx(-0.2)


def test_the_speed_along_the_road_is_that_of_the_velocity():
    """At 10 m/s, 0.3 rad to the left of the road with 0.1 rad of slip to the right: 0.2 rad."""
    step = step_of(BEFORE, cars_with(0.0, x=31.0, y=-3.0, heading=0.3, slip=-0.1, speed=10.0))
    along, across = 10 * math.cos(0.2), 10 * math.sin(0.2)
    assert value(SpeedAlong()(step)) == pytest.approx(along)
    assert value(SpeedAlong(1.0, -1.0, -1.0)(step)) == pytest.approx(along - across - 10 * 0.5)
    assert value(SpeedAlong(0.5, -0.25, -2.0)(step)) == pytest.approx(0.5 * along - 0.25 * across - 2 * 10 * 0.5)


def test_driving_the_wrong_way_costs():
    step = step_of(BEFORE, cars_with(0.0, x=29.0, heading=math.pi, speed=10.0))
    assert value(SpeedAlong()(step)) == pytest.approx(-10)


def test_time_costs_by_the_second():
    assert value(Time(-2.0)(step_of(BEFORE, BEFORE))) == pytest.approx(-2.0 * 0.1)


def test_a_change_of_the_steering_command_costs_in_proportion_whatever_the_pedal_does():
    step = step_of(BEFORE, BEFORE, action=(0.7, -1.0), last_action=(-0.1, 1.0))
    assert value(Steering(switch=-0.1)(step)) == pytest.approx(-0.08)


# Ends


def test_a_car_without_progress_is_counted_until_the_steps_are_full():
    rule, still, slow, fast = NoProgress(steps=3, speed=2.0), *(cars_with(0.0, x=30 + way) for way in (0, 0.19, 0.21))
    assert rule.count(step_of(BEFORE, still, stalled=1)).tolist() == [2]
    assert rule.count(step_of(BEFORE, slow, stalled=1)).tolist() == [2]
    assert rule.count(step_of(BEFORE, fast, stalled=1)).tolist() == [0]
    assert [rule(step_of(BEFORE, still, stalled=before)).item() for before in (0, 1, 2)] == [False, False, True]
    assert not rule(step_of(BEFORE, fast, stalled=2)).item()


@pytest.mark.parametrize(("degrees", "ends"), [(89.0, False), (91.0, True), (-91.0, True), (180.0, True), (0.0, False)])
def test_a_car_that_has_turned_round_ends(degrees, ends):
    step = step_of(BEFORE, cars_with(0.0, x=31.0, heading=math.radians(degrees)))
    assert RunningBackwards()(step).item() is ends


def test_any_of_the_ends_terminates_and_sliding_none():
    backwards, forward = (cars_with(0.0, x=31.0, heading=angle) for angle in (3.0, 0.0))
    slides = End({"contact": SlideAlongWall(0.8), "backwards": RunningBackwards()})
    ends = End({"contact": EndAtContact(), "backwards": RunningBackwards()})
    assert (slides.slide, ends.slide) == (0.8, None)
    assert slides(step_of(BEFORE, backwards)).item() and ends(step_of(BEFORE, backwards)).item()
    assert not slides(step_of(BEFORE, forward, collided=True)).item()
    assert ends(step_of(BEFORE, forward, collided=True)).item()
    assert not ends(step_of(BEFORE, forward)).item()
