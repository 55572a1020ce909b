"""The paper's reward, worked by hand."""

import pytest
import torch

from carrl.env.reward import TERMS, Reward
from carrl.errors import ConfigError


def all_terms_of(nearest, collided=False, gates=0, action=0, last_action=0, reward=None):
    observation = torch.tensor([[1.0, nearest, 0.7]])
    events = (torch.tensor([value]) for value in (collided, gates, action, last_action))
    return (reward or Reward()).terms(observation, *events)[0]


def terms_of(*args, **kwargs):
    """Those of the paper."""
    return all_terms_of(*args, **kwargs)[:3].tolist()


def test_the_terms_are_the_papers_and_one_for_steering():
    assert TERMS == ("collision", "proximity", "gate", "steering")
    terms = all_terms_of(nearest=0.05, gates=1, action=1, reward=Reward(turn=-0.5, switch=-2.0))
    assert terms.tolist() == [0, -20, 50, -2.5]
    assert Reward.of_paper(terms) == 30
    assert Reward.of_steering(terms) == -2.5


@pytest.mark.parametrize(
    ("last_action", "action", "steering"), [(0, 0, 0.0), (1, 1, -0.5), (0, 2, -2.5), (1, 2, -4.5), (1, 0, -2.0)]
)
def test_turns_and_switches_cost_what_is_asked_and_nothing_in_the_paper(last_action, action, steering):
    steered = {"nearest": 0.5, "action": action, "last_action": last_action}
    assert all_terms_of(**steered, reward=Reward(turn=-0.5, switch=-2.0))[3] == steering
    assert all_terms_of(**steered)[3] == 0


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
    reward = Reward(collision=-1.0, proximity=-2.0, gate=3.0, proximity_threshold=0.6)
    assert terms_of(nearest=0.5, gates=1, reward=reward) == [0, -2, 3]
    assert terms_of(nearest=0.5, collided=True, reward=reward) == [-1, 0, 0]


def test_shaping_pays_for_each_metre_closer_to_the_gate():
    reward = Reward(approach=0.5, discount=0.9)
    before, after = torch.tensor([10.0, 10.0, 1.0]), torch.tensor([9.0, 9.0, 30.0])
    terminated = torch.tensor([False, True, False])
    paid = reward.shaping(before, after, terminated).tolist()
    assert paid == pytest.approx([0.5 * (10 - 0.9 * 9), 0.5 * 10, 0.5 * (1 - 0.9 * 30)])


def test_over_an_episode_shaping_pays_what_the_start_decides_however_it_is_driven():
    """Discounted, it sums up to minus the potential of the start."""
    reward = Reward(approach=2.0, discount=0.9)
    for distances in ([10.0, 9.0, 8.0, 7.0], [10.0, 30.0, 2.0, 50.0]):
        steps = torch.tensor(distances)
        terminated = torch.tensor([False, False, True])
        paid = reward.shaping(steps[:-1], steps[1:], terminated) * 0.9 ** torch.arange(3)
        assert paid.sum().item() == pytest.approx(2.0 * 10.0)


def test_shaping_is_a_term_of_its_own_only_where_it_is_asked_for():
    assert Reward().term_names == TERMS
    assert Reward(approach=1.0).term_names == (*TERMS, "shaping")
    terms = torch.tensor([-200.0, -20.0, 50.0, -3.0, 7.0])
    assert Reward.of_paper(terms) == -170
    assert Reward.of_steering(terms) == -3


@pytest.mark.parametrize(("key", "value"), [("approach", -1.0), ("approach", float("nan")), ("discount", 1.1)])
def test_a_shaping_that_is_none_is_refused(key, value):
    with pytest.raises(ConfigError, match=rf"reward\.{key} is {value}"):
        Reward(**{key: value})


@pytest.mark.parametrize("value", ["50", True, None, float("inf"), 10**400])
def test_what_a_step_earns_is_a_finite_number(value):
    with pytest.raises(ConfigError, match=r"^reward\.gate is .*; it must be a finite number$"):
        Reward(gate=value)
