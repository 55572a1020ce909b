"""Action maps, by hand and against the vehicle that they are to control."""

import math

import pytest
import torch

from carrl import Bicycle, ContinuousActions, DiscreteActions, TrackEnv, Vehicle
from carrl.errors import ConfigError
from carrl.task.action import check_fits, steer3
from tests.worlds import make_world

TWO_CONTROLS = DiscreteActions(("coast", "left", "brake"), {"steer": (0.0, 1.0, -0.25), "throttle": (0.0, 0.5, -1.0)})


class Kart(Vehicle):
    """A car with two controls, of which the tests here only read the names."""

    control_names = ("steer", "throttle")


def test_the_papers_actions_are_numbered_forward_left_right():
    assert list(steer3().names) == ["forward", "left", "right"]
    assert steer3().controls(torch.arange(3)).tolist() == [[0], [1], [-1]]
    assert steer3().first.item() == 0


def test_an_action_is_one_setting_of_all_controls_in_their_order():
    assert TWO_CONTROLS.control_names == ("steer", "throttle")
    controls = TWO_CONTROLS.controls(torch.tensor([2, 0, 1, 2]))
    assert controls.tolist() == [[-0.25, -1], [0, 0], [1, 0.5], [-0.25, -1]]
    assert controls.dtype == torch.float32


@pytest.mark.parametrize("wrong", [-1, 3])
def test_an_action_that_there_is_not_has_no_controls(wrong):
    with pytest.raises(IndexError):
        steer3().controls(torch.tensor([0, wrong]))


def test_discrete_actions_are_read_one_hot():
    assert (TWO_CONTROLS.features, TWO_CONTROLS.spec.n) == (3, 3)
    assert TWO_CONTROLS.encode(torch.tensor([2, 0])).tolist() == [[0, 0, 1], [1, 0, 0]]


def test_continuous_actions_are_the_controls_themselves_cut_off_at_full_lock():
    actions = ContinuousActions(("steer", "throttle"))
    given = torch.tensor([[-3.0, 0.25], [0.5, 7.0]])
    assert actions.controls(given).tolist() == [[-1, 0.25], [0.5, 1]]
    assert (actions.spec.shape, actions.features) == ((2,), 2)
    assert actions.encode(given[:, :1] / 4).tolist() == [[-0.75], [0.125]]
    assert actions.first.tolist() == [0, 0]
    assert list(actions.names) == []


@pytest.mark.parametrize(
    ("names", "settings", "message"),
    [
        ([], {}, r"action\.names is \[\]; it must name at least one action, none twice"),
        (["left", "left"], {"steer": [1, 1]}, r"action\.names is \['left', 'left'\]"),
        (
            ["left"],
            {"steer": [1, 0]},
            r"action\.settings\.steer is \[1, 0\]; it must have a number within -1 and 1 for each of left",
        ),
        (["left", "on"], {"steer": [1.5, 0]}, r"action\.settings\.steer is \[1\.5, 0\]; .*for each of left, on"),
        (["left"], {"steer": [math.nan]}, r"action\.settings\.steer is \[nan\]"),
        (["left"], {"steer": [True]}, r"action\.settings\.steer is \[True\]"),
        (["left"], {"steer": ["1"]}, r"action\.settings\.steer is \['1'\]"),
    ],
)
def test_actions_that_mean_nothing_are_refused(names, settings, message):
    with pytest.raises(ConfigError, match=message):
        DiscreteActions(names, settings)


@pytest.mark.parametrize("vehicle", [Vehicle(), Bicycle()])
@pytest.mark.parametrize("actions", [steer3(), ContinuousActions(("steer",))])
def test_whatever_steers_fits_a_car_that_is_steered(vehicle, actions):
    check_fits(actions, vehicle)


@pytest.mark.parametrize(
    ("actions", "vehicle", "message"),
    [
        (
            TWO_CONTROLS,
            Vehicle(),
            "action sets steer, throttle; the vehicle Vehicle is controlled by steer, in this order",
        ),
        (
            ContinuousActions(("throttle",)),
            Bicycle(),
            "action sets throttle; the vehicle Bicycle is controlled by steer",
        ),
        (steer3(), Kart(), "action sets steer; the vehicle Kart is controlled by steer, throttle, in this order"),
        (ContinuousActions(("throttle", "steer")), Kart(), "action sets throttle, steer; the vehicle Kart"),
        (DiscreteActions(("on",), {}), Vehicle(), "action sets nothing; the vehicle Vehicle"),
    ],
)
def test_actions_that_do_not_fit_the_vehicle_are_refused_wherever_they_meet(actions, vehicle, message):
    with pytest.raises(ConfigError, match=message):
        TrackEnv("oval", vehicle=vehicle, action=actions)
    with pytest.raises(ConfigError, match=message):
        make_world("oval", vehicle=vehicle, action=actions)


def test_a_range_says_what_the_numbers_of_a_control_stand_for():
    actions = ContinuousActions(("steer", "throttle"), {"throttle": [-0.5, 1.0]})
    numbers = torch.tensor([[-1.0, -1.0], [0.5, 0.0], [0.0, 3.0]])
    assert actions.controls(numbers).tolist() == [[-1, -0.5], [0.5, 0.25], [0, 1]]
    assert actions.first.tolist() == [0, 0]
    env = TrackEnv("oval", 1, vehicle=Kart(), action=ContinuousActions(ranges={"throttle": [0.0, 0.5]}))
    assert env.task.action.controls(torch.tensor([[0.25, 1.0]])).tolist() == [[0.25, 0.5]]


@pytest.mark.parametrize(
    ("ranges", "says"),
    [
        ({"steer": [0.5]}, r"action\.ranges\.steer is \[0\.5\]; it must be two numbers within -1 and 1"),
        ({"steer": [0.0, 1.5]}, r"action\.ranges\.steer is \[0\.0, 1\.5\]; it must be two numbers within"),
        ({"steer": 0.5}, r"action\.ranges\.steer is 0\.5; it must be two numbers"),
        ({"steer": [0.5, 0.5]}, r"action\.ranges\.steer is \[0\.5, 0\.5\]; the first number must be the lower one"),
        ({"wheel": [0.0, 0.5]}, r"action\.ranges has 'wheel'; the vehicle is controlled by steer, throttle"),
    ],
)
def test_a_range_that_is_none_is_refused(ranges, says):
    with pytest.raises(ConfigError, match=says):
        TrackEnv("oval", 1, vehicle=Kart(), action=ContinuousActions(ranges=ranges))
