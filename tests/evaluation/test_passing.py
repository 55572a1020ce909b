"""Evaluation of a car among opponents: places, and contacts by fault."""

import pytest
import torch

from carrl.errors import ConfigError
from carrl.evaluation.baselines import rule_policy
from carrl.evaluation.results import aggregate
from carrl.evaluation.rollout import TrackEvaluator, rollout
from carrl.opponents.line import LineOpponents
from carrl.task.traffic import places_changed
from carrl.train.run import Run
from carrl.train.untrained import Untrained
from tests.evaluation.test_evaluation import forward_policy
from tests.worlds import make_world


def make_traffic(track="oval", cars=3, pace=0.5, offset=0.0, **parts):
    opponents = LineOpponents(pace=pace, spread=0.0, offset=offset)
    return make_world(track, opponents=opponents, cars_per_world=cars, **{"gap": 2.0, **parts})


def drive(world, policy, stations):
    return rollout(world, world.simulator(world.track), policy, torch.tensor(stations))


def test_places_change_where_a_car_comes_from_ahead_to_behind():
    before, after = torch.tensor([[3.0, -1.0, 40.0, -2.0]]), torch.tensor([[-1.0, 1.0, -40.0, -3.0]])
    won, lost = places_changed(before, after, torch.tensor([100.0]))
    assert (won.tolist(), lost.tolist()) == ([1], [1])  # 40 m of a lap of 100 m are no matter of who is ahead


def test_driving_into_the_car_ahead_is_a_contact_at_own_fault_that_ends_the_drive():
    (attempt,) = drive(make_traffic(), forward_policy, [0.0])
    assert (attempt.contacts_own, attempt.contacts_others, attempt.overtakes) == (1, 0, 0)
    assert not attempt.collided
    assert not attempt.lap_completed
    assert not attempt.is_clean_lap


def test_staying_in_touch_with_a_car_that_is_pushed_counts_once():
    (attempt,) = drive(make_traffic(bump=0.9), forward_policy, [0.0])
    assert attempt.contacts_own == 1
    assert attempt.collided  # it drove on, into the wall of the first corner


def test_a_lap_past_two_cars_that_crawl_beside_the_middle_wins_two_places():
    world = make_traffic(pace=0.02, offset=0.5)
    (passing,) = drive(world, rule_policy, [0.0])
    assert (passing.is_clean_lap, passing.overtakes, passing.places_won) == (True, 2, 2)


def test_a_car_that_is_alone_has_no_such_figures():
    (alone,) = drive(make_world(), rule_policy, [0.0])
    assert alone.overtakes is None
    assert "overtakes" not in alone.measures()


def test_the_same_place_has_the_same_opponents_whatever_is_driven_beside():
    world = make_traffic(cars=4, pace=0.7, offset=0.5)
    together, alone = drive(world, rule_policy, [0.0, 30.0]), drive(world, rule_policy, [30.0])
    assert together[1].measures() == alone[0].measures()


def test_figures_of_all_drives_count_contacts_by_km_and_overtakes_by_lap():
    world = make_traffic()
    drives = drive(world, forward_policy, [0.0, 0.0])
    figures = aggregate([drives], world.vehicle.step_length)
    assert figures["contacts_own"] == 2
    assert figures["contacts_own_per_km"] == pytest.approx(2 / figures["driven_km"])
    assert figures["contacts_others_per_km"] == figures["overtakes_per_lap"] == figures["clean_laps"] == 0
    assert "overtakes_per_lap" not in aggregate([drive(make_world(), rule_policy, [0.0])], 1.0)


def test_a_baseline_without_a_run_drives_among_opponents_that_are_asked_for():
    overrides = ["opponents=line", "env.cars_per_world=3", "track=oval"]
    figures = Untrained("rule", overrides).evaluate(policy="rule")["all"]
    assert {"overtakes_per_lap", "places_won", "contacts_own_per_km", "contacts_others_per_km"} <= figures.keys()
    with pytest.raises(ConfigError, match=r"env\.cars_per_world"):
        Untrained("rule", ["env.num_envs=3"])


def test_tracks_are_driven_in_smaller_groups_among_opponents():
    world = make_traffic(cars=3)
    found = TrackEvaluator(world, [world.track, world.track], starts=100).evaluate(rule_policy)
    assert [len(each) for each in found] == [100, 100]
    assert [each.measures() for each in found[0]] == [each.measures() for each in found[1]]


def test_a_run_is_evaluated_among_its_opponents(tmp_path):
    from carrl.train.run import train

    folder = tmp_path / "run"
    overrides = ["opponents=line", "env.cars_per_world=3", "trainer.frames=256", "recorder=null"]
    train(overrides=overrides, folder=folder)
    document = Run(folder).evaluate(starts=2)
    assert {"overtakes_per_lap", "contacts_own_per_km"} <= document["all"].keys() & document["all"]["rule"].keys()
    assert {"overtakes", "places_won", "contacts_own", "contacts_others"} <= Run(folder).summary["evaluation"].keys()
