"""The reward's terms, worked by hand."""

import pytest
import torch

from carrl.errors import ConfigError
from carrl.task.action import ContinuousActions, DiscreteActions
from carrl.task.reward import (
    LAP_TERMS,
    Collision,
    Gate,
    Proximity,
    Reward,
    Shaping,
    Steering,
    paper_reward,
)
from tests.env.steps import cars_before_gates, make_step

TERMS = ("collision", "proximity", "gate", "steering")


def all_terms_of(*, reward=None, **step):
    return (reward or paper_reward())(make_step(**step))[0]


def terms_of(**step):
    """Those of the paper."""
    return all_terms_of(**step)[:3].tolist()


def test_the_terms_are_the_papers_and_one_for_steering():
    reward = paper_reward(turn=-0.5, switch=-2.0)
    assert reward.term_names == TERMS
    terms = all_terms_of(nearest=0.05, gates=1, action=1, reward=reward)
    assert terms.tolist() == [0, -20, 50, -2.5]
    assert reward.total(terms, LAP_TERMS) == 30
    assert reward.total(terms, ("steering",)) == -2.5


@pytest.mark.parametrize(
    ("last_action", "action", "steering"), [(0, 0, 0.0), (1, 1, -0.5), (0, 2, -2.5), (1, 2, -4.5), (1, 0, -2.0)]
)
def test_turns_and_switches_cost_what_is_asked_and_nothing_in_the_paper(last_action, action, steering):
    steered = {"nearest": 0.5, "action": action, "last_action": last_action}
    assert all_terms_of(**steered, reward=paper_reward(turn=-0.5, switch=-2.0))[3] == steering
    assert all_terms_of(**steered)[3] == 0


@pytest.mark.parametrize(
    ("last_action", "action", "steering"), [(0, 1, -1.25), (1, 1, -0.25), (1, 2, -3.5), (2, 0, -2.0), (2, 1, -3.25)]
)
def test_half_a_turn_costs_half_as_much(last_action, action, steering):
    actions = DiscreteActions(("straight", "half_left", "right"), {"steer": (0.0, 0.5, -1.0)})
    step = make_step(action=action, last_action=last_action, actions=actions)
    assert Steering(turn=-0.5, switch=-2.0)(step).tolist() == [steering]


def test_a_continuous_turn_costs_in_proportion():
    step = make_step(action=0.25, last_action=-0.5, actions=ContinuousActions(("steer",)))
    assert Steering(turn=-0.5, switch=-2.0)(step).tolist() == [-0.125 - 1.5]


def test_driving_in_the_open_earns_nothing():
    assert terms_of(nearest=0.5) == [0, 0, 0]


def test_a_sensor_below_a_tenth_costs_20():
    assert terms_of(nearest=0.0999) == [0, -20, 0]


def test_a_sensor_at_exactly_a_tenth_costs_nothing():
    assert terms_of(nearest=0.1) == [0, 0, 0]


def test_a_collision_costs_200_and_not_20_on_top():
    assert terms_of(nearest=0.01, collided=True) == [-200, 0, 0]


def test_every_gate_earns_50():
    assert terms_of(nearest=0.5, gates=1) == [0, 0, 50]
    assert terms_of(nearest=0.05, gates=2) == [0, -20, 100]


def test_all_weights_are_parameters():
    terms = {"collision": Collision(-1.0), "proximity": Proximity(-2.0, threshold=0.6), "gate": Gate(3.0)}
    assert all_terms_of(nearest=0.5, gates=1, reward=Reward(terms)).tolist() == [0, -2, 3]
    assert all_terms_of(nearest=0.5, collided=True, reward=Reward(terms)).tolist() == [-1, 0, 0]


def test_shaping_pays_for_each_metre_closer_to_the_gate():
    before, after = cars_before_gates([10.0, 10.0, 1.0]), cars_before_gates([9.0, 9.0, 30.0], gates=[0, 0, 1])
    paid = Shaping(approach=0.5, discount=0.9)(make_step(before=before, after=after, collided=[False, True, False]))
    assert paid.dtype == torch.float32
    assert paid.tolist() == pytest.approx([0.5 * (10 - 0.9 * 9), 0.5 * 10, 0.5 * (1 - 0.9 * 30)], rel=1e-5)


def test_over_an_episode_shaping_pays_what_the_start_decides_however_it_is_driven():
    """Discounted, it sums up to minus the potential of the start."""
    shaping = Shaping(approach=2.0, discount=0.9)
    for distances in ([10.0, 9.0, 8.0, 7.0], [10.0, 30.0, 2.0, 50.0]):
        before, after = cars_before_gates(distances[:-1]), cars_before_gates(distances[1:])
        paid = shaping(make_step(before=before, after=after, collided=[False, False, True]))
        assert (paid * 0.9 ** torch.arange(3)).sum().item() == pytest.approx(2.0 * 10.0, rel=1e-5)


def test_shaping_is_a_term_of_its_own_beside_the_others():
    reward = Reward({**paper_reward().terms, "shaping": Shaping(approach=1.0)})
    assert reward.term_names == (*TERMS, "shaping")
    terms = torch.tensor([-200.0, -20.0, 50.0, -3.0, 7.0])
    assert reward.total(terms, LAP_TERMS) == -170
    assert reward.total(terms, ("steering",)) == -3


def test_the_total_of_terms_that_there_are_not_is_zero():
    reward = Reward({"gate": Gate()})
    assert reward.total(torch.tensor([[50.0], [100.0]]), ("steering",)).tolist() == [0, 0]
    assert reward.total(torch.tensor([[50.0], [100.0]]), LAP_TERMS).tolist() == [50, 100]


@pytest.mark.parametrize(("key", "value"), [("approach", -1.0), ("approach", float("nan")), ("discount", 1.1)])
def test_a_shaping_that_is_none_is_refused(key, value):
    with pytest.raises(ConfigError, match=rf"reward: {key} of Shaping is {value}"):
        Shaping(**{key: value})


@pytest.mark.parametrize("term", [Collision, Proximity, Gate])
@pytest.mark.parametrize("weight", [float("nan"), float("inf"), True, "50", None, 10**400])
def test_a_weight_that_is_no_number_is_refused(term, weight):
    with pytest.raises(ConfigError, match=rf"reward: weight of {term.__name__} is .*; it must be a finite number"):
        term(weight)


def test_a_reward_without_terms_is_refused():
    with pytest.raises(ConfigError, match="reward has no terms"):
        Reward({})
