"""Noise on actions: its size, its schedule, and whose random numbers it draws."""

import copy
import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from carrl.algorithms.actor_critic.exploration import GaussianNoise, NoNoise, OrnsteinUhlenbeckNoise
from carrl.algorithms.actor_critic.policy import ActorPolicy, GreedyActors
from carrl.errors import ConfigError
from tests.algorithms.actor_critics import RULES, action_spec, make_networks

CARS = 20_000


def parts(*seeds, controls=2):
    return {
        "action_spec": action_spec(controls),
        "generators": [torch.Generator().manual_seed(seed) for seed in seeds or (0,)],
    }


def added(noise, cars=CARS, is_first=True):
    """What noise adds to actions of zero."""
    return noise(torch.zeros(cars, 2), torch.full((cars,), is_first))


def test_gaussian_noise_has_the_standard_deviation_of_each_control():
    found = added(GaussianNoise([0.1, 0.3], 1.0, 100, **parts()))
    torch.testing.assert_close(found.std(0), torch.tensor([0.1, 0.3]), rtol=0.03, atol=0)
    torch.testing.assert_close(found.mean(0), torch.zeros(2), rtol=0, atol=0.01)


def test_actions_with_noise_stay_within_their_bounds():
    for noise in (GaussianNoise(5.0, 1.0, 100, **parts()), OrnsteinUhlenbeckNoise(0.1, 5.0, 0.0, 1.0, 100, **parts())):
        found = added(noise)
        assert (found.min().item(), found.max().item()) == (-1.0, 1.0)


def test_noise_falls_in_a_straight_line_with_the_env_steps_and_then_stays():
    noise = GaussianNoise([0.1, 0.3], 0.25, 100, **parts())
    found = []
    for frames in (0, 50, 50, 900):
        noise.step(frames)
        found.append(noise.figures()["sigma"])
    assert found == pytest.approx([0.2, 0.125, 0.05, 0.05])
    torch.testing.assert_close(added(noise).std(0), torch.tensor([0.025, 0.075]), rtol=0.03, atol=0)


def test_the_schedule_still_moves_after_a_hundred_million_env_steps():
    """TorchRL 0.14's counts down in float32, whose steps are larger than its own there."""
    noise = GaussianNoise(1.0, 0.0, 200_000_000, **parts())
    for _ in range(1000):
        noise.step(100_000)
    before = noise.figures()["sigma"]
    for _ in range(100):
        noise.step(1)
    assert noise.figures()["sigma"] < before == pytest.approx(0.5)


def test_wandering_noise_moves_back_by_theta_and_on_by_sigma():
    noise = OrnsteinUhlenbeckNoise(0.25, 0.1, [0.0, 0.4], 1.0, 100, **parts(5))
    drawn = torch.Generator().manual_seed(5)
    mean, expected = torch.tensor([0.0, 0.4]), torch.tensor([[0.0, 0.4]])
    for _ in range(3):
        expected = expected + 0.25 * (mean - expected) + 0.1 * torch.randn(1, 2, generator=drawn)
        torch.testing.assert_close(added(noise, cars=1, is_first=False), expected)


def test_wandering_noise_has_the_spread_that_its_page_says():
    noise = OrnsteinUhlenbeckNoise(0.15, 0.1, 0.0, 1.0, 100, **parts())
    for _ in range(40):
        found = added(noise, is_first=False)
    assert found.std().item() == pytest.approx(0.1 / math.sqrt(2 * 0.15 - 0.15**2), rel=0.03)


def test_wandering_noise_starts_at_its_mean_with_each_episode_and_for_its_car_alone():
    noise = OrnsteinUhlenbeckNoise(0.0, [1e-3, 1e-3], [0.5, 0.5], 1.0, 100, **parts())
    added(noise, cars=2)
    noise._noise = torch.tensor([[0.9, 0.9], [0.9, 0.9]])
    found = noise(torch.zeros(2, 2), torch.tensor([True, False]))
    torch.testing.assert_close(found, torch.tensor([[0.5, 0.5], [0.9, 0.9]]), rtol=0, atol=0.01)


MAKERS = {
    "gaussian": lambda *seeds: GaussianNoise(0.2, 0.5, 100, **parts(*seeds)),
    "ornstein_uhlenbeck": lambda *seeds: OrnsteinUhlenbeckNoise(0.15, 0.2, 0.0, 0.5, 100, **parts(*seeds)),
}


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_each_replicate_draws_from_its_own_generator(make):
    together = added(make(1, 2), cars=6)
    torch.rand(3)
    assert torch.equal(together, torch.cat([added(make(1), cars=3), added(make(2), cars=3)]))


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_noise_goes_on_where_it_was(make):
    noise = make(1, 2)
    added(noise, cars=4)
    noise.step(7)
    again = make(3, 4)
    again.load_state_dict(copy.deepcopy(noise.state_dict()))
    for _ in range(2):
        assert torch.equal(added(noise, 4, is_first=False), added(again, 4, is_first=False))
    assert noise.figures() == again.figures()


def test_noise_of_other_cars_is_refused():
    noise, other = MAKERS["ornstein_uhlenbeck"](1), OrnsteinUhlenbeckNoise(0.1, 0.1, 0.0, 1.0, 9, **parts(controls=3))
    added(noise, cars=2)
    with pytest.raises(ValueError, match="that of other cars"):
        other.set_extra_state(noise.get_extra_state())


WRONG = [
    (lambda: GaussianNoise(-0.1, 1.0, 100, **parts()), r"exploration.sigma is -0.1; it must be a number from 0 to 10"),
    (lambda: GaussianNoise([0.1] * 3, 1.0, 100, **parts()), "or a list of one for each of the 2 controls"),
    (lambda: GaussianNoise(0.1, 1.5, 100, **parts()), "exploration.final_share is 1.5; it must lie in 0..1"),
    (lambda: GaussianNoise(0.1, 1.0, 0, **parts()), "exploration.env_steps_to_final is 0; it must be at least 1"),
    (
        lambda: OrnsteinUhlenbeckNoise(1.5, 0.1, 0.0, 1.0, 100, **parts()),
        "exploration.theta is 1.5; it must be a number from 0 to 1",
    ),
]


@pytest.mark.parametrize(("make", "message"), WRONG, ids=[message for _, message in WRONG])
def test_noise_that_is_none_is_refused(make, message):
    with pytest.raises(ConfigError, match=message):
        make()


# The policy


def policy_of(name, *seeds):
    actors = [make_networks(RULES[name], 3, 2, seed=seed).actor for seed in seeds]
    return ActorPolicy(GreedyActors(actors), NoNoise(**parts(*seeds)))


def driven(policy, cars=CARS):
    observation = torch.randn(cars, 3, generator=torch.Generator().manual_seed(9))
    return policy(TensorDict({"observation": observation}, [cars]))


@pytest.mark.parametrize("name", RULES)
def test_the_first_actions_are_near_the_middle(name):
    assert driven(policy_of(name, 1))["greedy_action"].abs().max() < 0.2


def test_a_stochastic_actor_draws_its_actions_from_its_distribution():
    after = driven(policy_of("sac", 1))
    spread = after["action"].atanh() - after["greedy_action"].atanh()
    assert spread.std().item() == pytest.approx(1.0, rel=0.03)  # so wide is it at first
    assert (after["action"].abs() <= 1).all()


def test_a_deterministic_actor_without_noise_does_what_it_would_do_anyway():
    after = driven(policy_of("td3", 1))
    assert torch.equal(after["action"], after["greedy_action"])


@pytest.mark.parametrize("name", RULES)
def test_nothing_is_drawn_when_the_mode_is_deterministic(name):
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        after = driven(policy_of(name, 1))
    assert torch.equal(after["action"], after["greedy_action"])


def test_torchrls_own_deterministic_action_is_the_same():
    networks = make_networks(RULES["sac"], 3, 2)
    loss = RULES["sac"].make(networks, 2)
    observation = torch.randn(5, 3)
    with set_exploration_type(ExplorationType.DETERMINISTIC), loss.actor_network_params.to_module(loss.actor_network):
        theirs = loss.actor_network(TensorDict({"observation": observation}, [5]))["action"]
    torch.testing.assert_close(GreedyActors([networks.actor]).actions(observation), theirs)


@pytest.mark.parametrize("name", RULES)
def test_replicates_drive_together_as_alone(name):
    together = driven(policy_of(name, 1, 2), 8)
    for index, seed in enumerate((1, 2)):
        observation = together["observation"][4 * index : 4 * index + 4]
        alone = policy_of(name, seed)(TensorDict({"observation": observation}, [4]))
        torch.testing.assert_close(together["action"][4 * index : 4 * index + 4], alone["action"])


def test_a_copy_in_another_process_acts_alike_once_it_has_loaded_what_is_shared():
    own, copied = policy_of("td3", 1), policy_of("td3", 2)
    copied.load_shared_state(own.shared_state())
    assert torch.equal(driven(own, 4)["greedy_action"], driven(copied, 4)["greedy_action"])
