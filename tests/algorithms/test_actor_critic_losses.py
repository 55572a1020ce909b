"""What DDPG, TD3 and SAC learn from, by numbers worked by hand, and what TorchRL does otherwise than expected."""

import math
import warnings
from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torch.fx.experimental.proxy_tensor import make_fx
from torchrl.data import Bounded
from torchrl.modules import ProbabilisticActor, TanhNormal
from torchrl.objectives import DDPGLoss, SACLoss, SoftUpdate, TD3Loss

from carrl.algorithms.actor_critic.loss import DDPG, SAC, TD3, values
from carrl.algorithms.actor_critic.network import Actor, ActorCritic, Critic
from carrl.algorithms.common.compiled_update import CompiledUpdate
from carrl.algorithms.common.noise import GivenNoise
from carrl.algorithms.common.optimizer import make_soft_update
from carrl.algorithms.common.stand_ins import standing_in
from carrl.data.replay_buffer import KEYS
from carrl.errors import ConfigError
from tests.algorithms.actor_critics import RULES, make_algorithm, make_networks, make_replicate, random_batch

GAMMA = 0.5
UPPER, LOWER = 3.0, 2.0
"""What the two critics think of an action of 1: Q(s, a) = s + w a."""


def linear(weights):
    layer = nn.Linear(len(weights), 1)
    nn.init.zeros_(layer.bias)
    layer.weight.data = torch.tensor([weights])
    return nn.Sequential(layer)


def linear_networks(rule, middle):
    """An actor whose action is tanh(middle * s), with a standard deviation of 1, and critics of the weights above."""
    layer = nn.Linear(1, 2 if rule.is_stochastic else 1)
    nn.init.zeros_(layer.bias)
    layer.weight.data = torch.tensor([[middle], [0.0]][: layer.out_features])
    critics = [Critic(linear([1.0, weight])) for weight in (UPPER, LOWER)[: rule.critics]]
    return ActorCritic(Actor(nn.Sequential(layer), rule.is_stochastic), critics)


def one_transition(*, terminated=False, steps=None):
    """From s = 0 by a = 1 for a reward of 10 to s = 1."""
    following = {
        "observation": torch.ones(1, 1),
        "reward": torch.full((1, 1), 10.0),
        "done": torch.full((1, 1), terminated),
        "terminated": torch.full((1, 1), terminated),
    }
    given = {"observation": torch.zeros(1, 1), "action": torch.ones(1, 1), "next": following}
    return TensorDict({**given, **({"steps_to_next_obs": torch.tensor([[steps]])} if steps else {})}, [1])


def found(rule, transitions, middle, noise=()):
    loss = rule.make(linear_networks(rule, middle), 1)
    make_soft_update(0.5, loss=loss)
    with GivenNoise([torch.tensor([[number]]) for number in noise]):
        return rule.losses(loss, transitions, True)


def test_ddpgs_target_is_its_one_critic_of_its_target_actors_action():
    losses = found(DDPG(GAMMA, 1.0, saturation=0.0), one_transition(), middle=0.5)
    target = 10 + GAMMA * (1 + UPPER * math.tanh(0.5))
    assert losses.td_error.item() == pytest.approx((UPPER - target) ** 2, rel=1e-5)
    assert losses.of_parts["critic"].item() == pytest.approx((UPPER - target) ** 2, rel=1e-5)
    assert losses.of_parts["actor"].item() == pytest.approx(0.0, abs=1e-6)  # of the action 0 in s = 0


def test_ddpgs_actor_pays_for_actions_that_tanh_has_flattened():
    transitions = one_transition()
    transitions["observation"] = torch.ones(1, 1)
    action = math.tanh(2.0)
    for saturation in (0.0, 0.1):
        losses = found(DDPG(GAMMA, 1.0, saturation), transitions.clone(), middle=2.0)
        price = -saturation * math.log(1 - action**2 + 1e-6)
        assert losses.of_parts["actor"].item() == pytest.approx(price - (1 + UPPER * action), rel=1e-5)
        assert losses.of_parts["critic"].item() == pytest.approx((1 + UPPER - 10 - GAMMA * (1 + UPPER * action)) ** 2)


def test_the_price_leads_back_from_where_tanh_is_flat():
    rule = DDPG(GAMMA, 1.0, saturation=0.1)
    loss = rule.make(linear_networks(rule, 6.0), 1)
    make_soft_update(0.5, loss=loss)
    transitions = one_transition()
    transitions["observation"] = torch.ones(1, 1)
    rule.losses(loss, transitions, True).of_parts["actor"].backward()
    (weight, _) = rule.parameters(loss, "actor")
    assert weight.grad.item() == pytest.approx(0.2, abs=0.02)  # 2 * saturation, against almost nothing of the critic


def test_td3s_target_is_the_lesser_critic_of_an_action_with_clipped_noise():
    rule = TD3(GAMMA, 1.0, policy_delay=2, policy_noise=0.2, noise_clip=0.3)
    losses = found(rule, one_transition(), middle=0.5, noise=[5.0])  # 1.0, clipped to 0.3
    target = 10 + GAMMA * (1 + LOWER * (math.tanh(0.5) + 0.3))
    expected = [(weight - target) ** 2 for weight in (UPPER, LOWER)]
    assert losses.td_error.item() == pytest.approx(max(expected), rel=1e-5)
    assert losses.of_parts["critic"].item() == pytest.approx(sum(expected), rel=1e-5)


def test_td3s_target_action_stays_within_the_bounds():
    rule = TD3(GAMMA, 1.0, policy_delay=2, policy_noise=1.0, noise_clip=9.0)
    target = 10 + GAMMA * (1 + LOWER)
    losses = found(rule, one_transition(), middle=0.5, noise=[5.0])
    assert losses.td_error.item() == pytest.approx(max((weight - target) ** 2 for weight in (UPPER, LOWER)), rel=1e-5)


def log_probability(drawn, middle):
    """Of tanh(drawn), drawn from a normal distribution with standard deviation 1."""
    return -((drawn - middle) ** 2) / 2 - math.log(math.sqrt(2 * math.pi)) - math.log(1 - math.tanh(drawn) ** 2)


def sac(alpha, **changes):
    return replace(SAC(GAMMA, 1.0, alpha, learn_alpha=True, target_entropy=None, alpha_rate=1.0), **changes)


def test_sacs_target_is_the_lesser_critic_of_a_drawn_action_and_what_its_entropy_is_worth():
    losses = found(sac(0.2), one_transition(), middle=0.5, noise=[0.3, -0.4])  # the next action's first
    following = LOWER * math.tanh(0.8) - 0.2 * log_probability(0.8, 0.5)
    target = 10 + GAMMA * (1 + following)
    assert losses.td_error.item() == pytest.approx((LOWER - target) ** 2, rel=1e-5)
    own = log_probability(-0.4, 0.0)
    acting = min(weight * math.tanh(-0.4) for weight in (UPPER, LOWER))
    assert losses.of_parts["actor"].item() == pytest.approx(0.2 * own - acting, rel=1e-5)
    assert losses.of_parts["alpha"].item() == pytest.approx(-math.log(0.2) * (own - 1), rel=1e-5)
    assert losses.figures["entropy"].item() == pytest.approx(-own, rel=1e-5)
    assert losses.figures["alpha"].item() == pytest.approx(0.2)


def test_a_fixed_temperature_is_no_part_that_learns():
    rule = sac(0.2, learn_alpha=False)
    assert "alpha" not in rule.rates
    assert set(found(rule, one_transition(), 0.5, [0.0, 0.0]).of_parts) == {"critic", "actor"}


@pytest.mark.parametrize("name", RULES)
def test_a_terminated_transition_has_its_reward_as_the_target(name):
    rule = RULES[name]
    losses = found(rule, one_transition(terminated=True), 0.5, [0.1] * rule.draws)
    weights = (UPPER, LOWER)[: rule.critics]
    assert losses.td_error.item() == pytest.approx(max((weight - 10.0) ** 2 for weight in weights))


@pytest.mark.parametrize("name", RULES)
def test_what_follows_after_several_steps_is_discounted_as_often(name):
    rule = RULES[name]
    errors = [
        found(rule, one_transition(steps=steps), 0.5, [0.1] * rule.draws).td_error.sqrt().item() for steps in (1, 3)
    ]
    nothing = found(replace(rule, gamma=0.0), one_transition(), 0.5, [0.1] * rule.draws).td_error.sqrt().item()
    assert (errors[1] - nothing) / (errors[0] - nothing) == pytest.approx(GAMMA**2, rel=1e-4)


def test_the_value_of_an_action_is_that_of_the_less_hopeful_critic():
    loss = RULES["td3"].make(linear_networks(RULES["td3"], 0.0), 1)
    found = values(loss, "qvalue_network", torch.tensor([[1.0], [1.0]]), torch.tensor([[1.0], [-1.0]]))
    assert found.tolist() == [1 + LOWER, 1 - UPPER]


WRONG = [
    (lambda: DDPG(1.1, 1.0, 0.0), "loss.gamma is 1.1; it must lie in 0..1"),
    (lambda: DDPG(0.9, 0.0, 0.0), "loss.actor_rate is 0.0; it must be a positive number"),
    (lambda: DDPG(0.9, 1.0, -0.1), "loss.saturation is -0.1; it must be a number of at least 0"),
    (lambda: TD3(0.9, 1.0, 0, 0.2, 0.5), "loss.policy_delay is 0; it must be at least 1"),
    (lambda: TD3(0.9, 1.0, 2, -0.2, 0.5), "loss.policy_noise is -0.2; it must be a number of at least 0"),
    (lambda: sac(0.0), "loss.alpha is 0.0; it must be a positive number"),
    (lambda: sac(math.nan), "loss.alpha is nan; it must be a positive number"),
]


@pytest.mark.parametrize(("make", "message"), WRONG, ids=[message for _, message in WRONG])
def test_a_loss_that_is_none_is_refused(make, message):
    with pytest.raises(ConfigError, match=message):
        make()


# Given noise


def test_given_noise_answers_a_normal_distribution_and_randn_like_in_their_order():
    first, second = torch.tensor([1.0, 2.0]), torch.tensor([3.0, 4.0])
    with GivenNoise([first, second]):
        assert torch.distributions.Normal(torch.zeros(2), 2.0).rsample().tolist() == [2.0, 4.0]
        assert torch.randn_like(torch.zeros(2)).tolist() == [3.0, 4.0]


def test_given_noise_of_another_shape_is_an_error():
    with GivenNoise([torch.zeros(3)]), pytest.raises(RuntimeError, match=r"of shape \[2\] are drawn, \[3\] are given"):
        torch.randn_like(torch.zeros(2))


@pytest.mark.parametrize("name", RULES)
def test_an_update_draws_as_often_as_its_loss_says_and_never_from_torchs_own_generator(name):
    rule, batch = RULES[name], random_batch()
    replicate, before = make_replicate(rule, 3, 2), torch.get_rng_state()
    noise = GivenNoise([torch.zeros(16, 2) for _ in range(rule.draws)])
    with noise:
        rule.losses(replicate.loss, batch, True)
    assert noise._left == []
    assert torch.equal(torch.get_rng_state(), before)


# The two traps of tracing


@pytest.fixture
def constants_of(monkeypatch):
    """A function from a rule's name to the constants of its traced updates that have more than one element."""
    graphs = []

    def trace_alone(function, inputs):
        graphs.append(make_fx(lambda *tensors: function(*tensors))(*inputs))

    def constants(name):
        algorithm, batch = make_algorithm(RULES[name], 3, 2, seeds=(1, 2)), random_batch()[:, None].expand(16, 2)
        algorithm.prepare(0, 16)
        algorithm.update(batch.clone())
        memory = {key: batch[key].contiguous() for key in KEYS}
        for update in algorithm.functional():
            CompiledUpdate(update, memory, 16, False)
        found = [pair for graph in graphs for pair in (*graph.named_buffers(), *graph.named_parameters())]
        return [name for name, value in found if value.numel() > 1]

    monkeypatch.setattr("carrl.algorithms.common.compiled_update.compile_native", trace_alone)
    return constants


@pytest.mark.parametrize("name", RULES)
def test_the_graph_has_no_network_baked_in(name, constants_of):
    assert constants_of(name) == []


@pytest.mark.parametrize("name", RULES)
def test_with_torchrls_cache_the_graph_would_have_a_network_baked_in(name, constants_of, monkeypatch):
    """TorchRL 0.14.1's losses keep detached parameters from the first call on, in `_cache`."""
    monkeypatch.setattr("carrl.algorithms.common.stand_ins.forget_cached", lambda loss: None)
    assert constants_of(name)


@pytest.mark.parametrize("name", RULES)
def test_an_eager_loss_follows_parameters_that_have_moved_to_other_memory(name):
    """As they have when a compiled update has stacked them; tensordict 0.14.3 keeps what `detach` gave, too."""
    rule, batch = RULES[name], random_batch()
    moved, fixed = (make_replicate(rule, 3, 2) for _ in range(2))
    noise = [torch.zeros(16, 2)] * rule.draws
    moved.losses(batch.clone(), noise, True)
    for parameter in moved.loss.parameters():
        parameter.data = parameter.data + 0.1
    for parameter in fixed.loss.parameters():
        parameter.data.add_(0.1)
    ours, theirs = (each.losses(batch.clone(), noise, True).of_parts for each in (moved, fixed))
    assert {part: value.item() for part, value in ours.items()} == {
        part: value.item() for part, value in theirs.items()
    }


def test_stand_ins_of_several_critics_are_mapped_over_as_they_are():
    rule = RULES["td3"]
    replicate, batch = make_replicate(rule, 3, 2), random_batch()
    noise = [torch.zeros(16, 2)]
    replicate.update(batch.clone(), noise, True)
    state, own = replicate.state(), replicate.losses(batch.clone(), noise, True)
    networks = {name: {**state[name], **rest} for name, rest in replicate.constants().items()}
    with standing_in(replicate.loss, networks), GivenNoise(noise):
        stood_in = rule.losses(replicate.loss, batch.clone(), True)
    assert torch.equal(own.td_error, stood_in.td_error)
    assert replicate.loss._modules["qvalue_network_params"].batch_size == (2,)


# TorchRL 0.14.1


@pytest.fixture
def quiet():
    """TorchRL warns of losses without a target updater."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        yield


def torchrls(kind, **options):
    actor, critic = nn.Linear(3, 4 if kind is SACLoss else 2), Critic(nn.Sequential(nn.Linear(5, 1)))
    valuing = TensorDictModule(critic, in_keys=["observation", "action"], out_keys=["state_action_value"])
    if kind is not SACLoss:
        return kind(TensorDictModule(actor, ["observation"], ["action"]), valuing, **options)
    moments = TensorDictModule(Actor(nn.Sequential(actor), True), ["observation"], ["loc", "scale"])
    acting = ProbabilisticActor(moments, in_keys=["loc", "scale"], distribution_class=TanhNormal, return_log_prob=True)
    return kind(acting, valuing, **options)


def test_torchrls_target_entropy_counts_the_cars_of_a_batched_spec_and_ours_does_not():
    batched = torchrls(SACLoss, action_spec=Bounded(-1.0, 1.0, shape=(64, 2)))
    assert batched.target_entropy.item() == -128
    assert sac(1.0).make(make_networks(sac(1.0), 3, 2), 2).target_entropy.item() == -2
    assert sac(1.0, target_entropy=-0.5).make(make_networks(sac(1.0), 3, 2), 2).target_entropy.item() == -0.5


def test_torchrls_defaults_are_off_the_papers_and_ours_are_not():
    assert torchrls(SACLoss, action_spec=Bounded(-1.0, 1.0, shape=(2,))).loss_function == "smooth_l1"
    assert torchrls(TD3Loss, bounds=(-1.0, 1.0)).loss_function == "smooth_l1"
    assert not torchrls(DDPGLoss).delay_actor
    made = {name: rule.make(make_networks(rule, 3, 2), 2) for name, rule in RULES.items()}
    assert {loss.loss_function for loss in made.values()} == {"l2"}
    assert made["ddpg"].delay_actor and made["td3"].delay_actor


def test_making_an_updater_overwrites_the_targets_so_it_is_made_before_a_state_is_loaded(quiet):
    rule = RULES["ddpg"]
    loss = rule.make(make_networks(rule, 3, 2), 2)
    target = next(iter(loss.target_value_network_params.values(True, True)))
    target.data.fill_(7.0)
    SoftUpdate(loss, tau=0.5)
    assert (target != 7.0).any()


@pytest.mark.parametrize("name", RULES)
def test_an_updater_moves_all_targets(name):
    replicate = make_replicate(RULES[name], 3, 2, tau=0.5)
    for network in replicate.networks:
        for value in replicate.loss._modules[network].values(True, True):
            value.data.add_(1.0)
    before = {
        target: [value.clone() for value in replicate.loss._modules[target].values(True, True)]
        for target in replicate.targets
    }
    replicate.target_updater.follow()
    for target, values_before in before.items():
        for value, old in zip(replicate.loss._modules[target].values(True, True), values_before, strict=True):
            torch.testing.assert_close(value, old + 0.5)


def test_td_errors_of_all_three_are_squared_although_torchrls_sac_has_absolute_ones(quiet):
    loss, batch = torchrls(SACLoss, action_spec=Bounded(-1.0, 1.0, shape=(2,)), loss_function="l2"), random_batch()
    loss.make_value_estimator(gamma=0.0)
    loss(batch)
    reward = batch["next", "reward"][:, 0]
    with loss.qvalue_network_params[0].to_module(loss.qvalue_network, preserve_module_state=False):
        first = loss.qvalue_network(batch.clone())["state_action_value"][:, 0]
    with loss.qvalue_network_params[1].to_module(loss.qvalue_network, preserve_module_state=False):
        second = loss.qvalue_network(batch.clone())["state_action_value"][:, 0]
    torch.testing.assert_close(batch["td_error"], torch.maximum((first - reward).abs(), (second - reward).abs()))


def test_the_log_probability_of_a_saturated_action_is_not_that_of_its_draw():
    """So that of a stored action is never computed; the loss draws and scores in one go."""
    distribution = TanhNormal(torch.tensor([20.0]), torch.tensor([0.1]), event_dims=1)
    with GivenNoise([torch.zeros(1)]):
        action, log_prob = distribution.rsample_and_log_prob()
    assert log_prob.item() > 0
    assert distribution.log_prob(action).item() < -1000
