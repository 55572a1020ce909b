"""Races: who is first, who is out, what is counted."""

import math
from dataclasses import replace

import pytest
import torch

from carrl.errors import ConfigError
from carrl.evaluation.baselines import rule_policy
from carrl.evaluation.race import drive_races
from carrl.evaluation.race_grid import Entrant
from carrl.evaluation.rollout import rollout
from carrl.evaluation.standings import Race, Result, elo, league
from carrl.opponents.line import LineOpponents
from carrl.sim.kinematic import Kinematic
from carrl.sim.vehicle import Vehicle
from carrl.task.action import ContinuousActions, fitted
from tests.evaluation.test_evaluation import forward_policy
from tests.worlds import make_world


def entrants(*policies, **parts):
    """A car for each policy, called a, b, ..., alone in its own world."""
    world = make_world("oval", **{"gap": 2.0, **parts})
    return [Entrant(name, world, policy) for name, policy in zip("abcdef", policies, strict=False)]


def among(policy, pace, cars=3, **parts):
    """One car behind opponents that drive on the middle of the road, or beside it."""
    opponents = LineOpponents(pace=pace, spread=0.0, offset=parts.pop("offset", 0.0))
    return entrants(policy, opponents=opponents, cars_per_world=cars, **parts)


def race(drivers, laps=1, races=1):
    return drive_races(drivers, drivers[0].world.track, laps, races)


def by_car(found):
    return {result.car: result for result in found.results}


def result(car, start=1, time=None, way=0.0, own=0, km=1.0):
    return Result(car, start, "finished" if time else "wall", time, way, None, 0, km, own, 0)


@pytest.fixture(scope="module")
def three():
    """Three races of two laps, of three cars that the rule drives."""
    return race(entrants(rule_policy, rule_policy, rule_policy), laps=2, races=3)


def test_the_first_car_drives_as_if_it_were_alone(three):
    world = make_world("oval")
    (alone,) = rollout(world, world.simulator(world.track), rule_policy, torch.zeros(1), laps=2)
    first = by_car(three[0])["a"]
    assert (first.start, first.ended) == (1, "finished")
    assert first.time == pytest.approx(sum(alone.lap_times), abs=1e-6)
    assert first.best_lap == pytest.approx(min(alone.lap_times), abs=1e-6)


def test_all_have_the_same_line_to_finish_at(three):
    times = [result.time for result in three[0].results]
    gap = 3 * Vehicle().body.outline.length  # behind each other, at 10 m/s
    assert times[1] - times[0] == pytest.approx(gap / 10, abs=0.05)
    assert times[2] - times[0] == pytest.approx(2 * gap / 10, abs=0.1)
    assert all(result.way == pytest.approx(2 * make_world("oval").track.length, abs=1.5) for result in three[0].results)


def test_each_starts_from_each_place_and_each_race_somewhere_else(three):
    starts = [[by_car(each)[car].start for each in three] for car in "abc"]
    assert starts == [[1, 2, 3], [2, 3, 1], [3, 1, 2]]
    length = make_world("oval").track.length
    assert [each.start for each in three] == pytest.approx([0, length / 3, 2 * length / 3], abs=1e-3)


def test_a_car_at_the_wall_is_out_and_the_others_go_on():
    (found,) = race(entrants(forward_policy, rule_policy, rule_policy))
    assert [(each.car, each.ended) for each in found.results] == [("b", "finished"), ("c", "finished"), ("a", "wall")]
    out = by_car(found)["a"]
    assert out.time is None
    assert out.driven_km < 0.1
    assert all(each.contacts_own == each.contacts_others == 0 for each in found.results)
    assert by_car(found)["b"].overtakes == 0  # there was nobody any more


def test_touching_a_car_ends_a_race_where_it_ended_the_episodes_of_the_run():
    for bump, ended in ((None, "car"), (0.9, "wall")):
        (found,) = race(among(forward_policy, 0.5, bump=bump))
        car = by_car(found)["a"]
        assert (car.ended, car.contacts_own, car.contacts_others) == (ended, 1, 0)


def test_of_two_cars_that_touch_the_one_behind_is_at_fault_and_both_are_out():
    vehicle = Kinematic()
    action = fitted(ContinuousActions(), vehicle)

    def pushing(pedal):
        controls = [pedal if name == "pedal" else 0.0 for name in action.control_names]
        return lambda observation: torch.tensor([controls]).repeat(len(observation), 1)

    (found,) = race(entrants(pushing(-1.0), pushing(1.0), vehicle=vehicle, action=action, bump=None))
    standing, driving = (by_car(found)[car] for car in "ab")
    assert (standing.ended, standing.contacts_own, standing.contacts_others) == ("car", 0, 1)
    assert (driving.ended, driving.contacts_own, driving.contacts_others) == ("car", 1, 0)
    assert standing.driven_km == 0.0
    assert driving.driven_km == pytest.approx(0.002 * vehicle.length, rel=0.02)  # the gap is twice as long as a car


def test_one_that_passes_opponents_from_behind_all_of_them_wins():
    (found,) = race(among(rule_policy, 0.02, offset=0.5))
    car, other = by_car(found)["a"], by_car(found)["line 1"]
    assert found.results[0] == car
    assert (car.start, car.ended, car.overtakes) == (3, "finished", 2)
    assert (other.ended, other.contacts_own) == ("time", None)
    assert sorted(result.start for result in found.results) == [1, 2, 3]


def test_opponents_finish_after_a_car_that_is_out():
    (found,) = race(among(forward_policy, 0.5))
    assert [each.car for each in found.results][-1] == "a"
    times = [each.time for each in found.results[:2]]
    length = make_world("oval").track.length
    assert times[0] == pytest.approx(length / 5, rel=0.02)
    assert times[1] > times[0]


def test_the_same_races_come_out_the_same():
    drivers = among(rule_policy, 0.6, offset=0.5)
    assert race(drivers, races=2) == race(drivers, races=2)


def test_a_race_that_cannot_be_is_refused_in_one_sentence():
    alone = entrants(rule_policy)
    with pytest.raises(ConfigError, match="a has nobody to race; name several runs, or opponents"):
        race(alone)
    faster = alone[0]._replace(name="b", world=replace(alone[0].world, vehicle=Vehicle(speed=12.0)))
    with pytest.raises(
        ConfigError, match=r"must be the same; that of a is Vehicle\(speed=10.0.* that of b is Vehicle\(s"
    ):
        race([*alone, faster])
    with pytest.raises(ConfigError, match=r"3 cars take .* m of road to start; track 'oval' has"):
        race(entrants(rule_policy, rule_policy, rule_policy, gap=100.0))


def test_finishers_come_before_those_who_were_out_the_furthest_of_them_first():
    found = Race.of(
        "oval", 0.0, [result("a", way=10.0), result("b", time=9.0), result("c", way=20.0), result("d", time=8.0)]
    )
    assert [each.car for each in found.results] == ["d", "b", "c", "a"]


def test_ratings_are_those_worked_by_hand():
    three = Race.of("oval", 0.0, [result(car, time=time) for car, time in (("a", 1.0), ("b", 2.0), ("c", 3.0))])
    assert elo([three]) == {"a": 1016.0, "b": 1000.0, "c": 984.0}
    two = [Race.of("oval", 0.0, [result("a", time=1.0), result("b", time=2.0)])] * 2
    second = 16 * (1 - 1 / (1 + 10 ** (-16 / 400)))
    assert elo(two) == {"a": pytest.approx(1008 + second), "b": pytest.approx(992 - second)}


def test_a_league_counts_over_all_races():
    first = Race.of("oval", 0.0, [result("a", 2, time=1.0, own=1, km=0.5), result("b", 1, time=2.0)])
    second = Race.of("oval", 0.0, [result("a", 1, way=5.0, km=0.5), result("b", 2, way=9.0)])
    rows = {row["car"]: row for row in league([first, second])}
    assert (rows["a"]["wins"], rows["b"]["wins"]) == (1, 0)  # nobody wins a race that nobody finishes
    assert (rows["a"]["places_won"], rows["a"]["mean_place"], rows["a"]["finished"]) == (0.0, 1.5, 1)
    assert rows["a"]["contacts_own_per_km"] == 1.0
    low, high = rows["a"]["intervals"]["contacts_own_per_km"]
    assert low == pytest.approx(-math.log(0.975), abs=1e-6)  # Garwood's, of one event
    assert high == pytest.approx(5.5716, abs=1e-4)
