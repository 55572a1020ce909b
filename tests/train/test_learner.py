"""Compiled updates against eager ones."""

import logging
import shutil
from dataclasses import replace

import pytest
import torch
from torch import nn
from torch.fx.experimental.proxy_tensor import make_fx
from torchrl.objectives import DQNLoss

from carrl.algorithms.common.native import CompilationError, _fingerprint
from carrl.algorithms.common.network import QNetwork
from carrl.algorithms.dqn.dqn import DQN
from carrl.algorithms.dqn.loss import make_dqn_loss
from carrl.cache import cache_dir
from carrl.data.replay_buffer import KEYS, memory_of
from carrl.train.build import build_pipeline
from carrl.train.learner import Learner
from tests.configs import compose

needs_compiler = pytest.mark.skipif(shutil.which("g++") is None, reason="there is no C++ compiler to compile with")


def make_pipeline(*overrides):
    """A pipeline whose buffer holds 800 transitions."""
    soft = any(override.startswith(("target_updater=", "loss=sac", "loss=td3", "loss=ddpg")) for override in overrides)
    period = [] if soft or any("period" in o for o in overrides) else ["target_updater.period=50"]
    pipeline = build_pipeline(compose("seed=1", "env.num_envs=32", *period, *overrides))
    replicates = len(pipeline.algorithm.replicates)
    for _, batch in zip(range(25), pipeline.source.collector, strict=False):
        transitions = batch.view(replicates, -1, 1).permute(2, 1, 0).select(*KEYS)
        kept = transitions if pipeline.source.returns is None else pipeline.source.returns(transitions)
        if len(kept):
            pipeline.replay_buffer.extend(kept.flatten(0, 1))
    return pipeline


def messages(caplog):
    """What CarRL itself logged."""
    return [record.message for record in caplog.records if record.name.startswith("carrl")]


def updated(pipeline, count=200):
    """The losses of this many updates, [count, A]."""
    losses = []
    for _ in range(count):
        pipeline.learner.learn(1)
        losses.append(pipeline.learner.losses.tolist())
    return torch.tensor(losses)


TWO = ("loss=double_dqn", "trainer.seeds=[1,2]")
FEATURES = (
    ("loss=dqn", "replay_buffer.batch_size=37", "network.hidden_sizes=[5]"),
    ("loss=huber", "gradient_clipping.max_norm=10", "learning_rate=linear", "learning_rate.updates=100"),
    ("loss=advantage_learning", "returns.steps=3", "network.input_exponent=0.5", "target_updater=soft"),
    ("loss=cql", "network.hidden_sizes=[]", "vehicle=kinematic", "action=table"),
)
"""Of updates that have machine code of their own."""
OTHERS = (
    ("loss=dqn", "network=noisy", "replay_buffer=prioritized", "returns.steps=3", "target_updater=soft"),
    ("loss=distributional", "gradient_clipping.max_norm=10", "learning_rate=linear", "learning_rate.updates=100"),
    ("loss=dueling", "loss.loss_function=smooth_l1", "gradient_clipping.max_norm=10"),
)
"""Updates that only Inductor compiles."""


def assert_learns_as_eagerly(compiled, eager, updates=200):
    """Whether both find the same losses, and have the same networks in the end."""
    torch.testing.assert_close(updated(compiled, updates), updated(eager, updates), rtol=1e-5, atol=0)
    for ours, theirs in zip(compiled.algorithm.replicates, eager.algorithm.replicates, strict=True):
        for name in ("value_network_params", "target_value_network_params"):
            tensors = (getattr(replicate.loss, name).values(True, True) for replicate in (ours, theirs))
            for fused, plain in zip(*tensors, strict=True):
                assert ((fused - plain).norm() / plain.norm()).item() < 1e-5


def assert_same_weights(together, index, alone):
    pairs = zip(together.algorithm.networks[index].parameters(), alone.algorithm.networks[0].parameters(), strict=True)
    assert all(torch.equal(ours, theirs) for ours, theirs in pairs)


@pytest.mark.parametrize("overrides", [TWO, *((*each, "trainer.seeds=[1,2]") for each in FEATURES)], ids=" ".join)
def test_200_updates_by_machine_code_equal_200_eager_ones(overrides):
    compiled = make_pipeline(*overrides, "compile=true")
    assert_learns_as_eagerly(compiled, make_pipeline(*overrides))
    assert compiled.learner.state_dict()["kind"] == "machine code"


def test_machine_code_learns_from_weighted_transitions_as_eagerly():
    overrides = ("loss=advantage_learning", "replay_buffer=prioritized", *TWO[1:])
    compiled, eager = make_pipeline(*overrides, "compile=true"), make_pipeline(*overrides)
    torch.testing.assert_close(updated(compiled, 40), updated(eager, 40), rtol=1e-5, atol=0)


@pytest.mark.parametrize("overrides", [TWO[:1], FEATURES[1], ("replay_buffer=prioritized",)], ids=" ".join)
def test_by_machine_code_together_and_alone_many_at_once_and_each_for_itself_the_weights_are_the_same(overrides):
    together = make_pipeline(*overrides, "trainer.seeds=[1,2]", "compile=true")
    together.learner.learn(120)
    for index, seed in enumerate((1, 2)):
        alone = make_pipeline(*overrides, f"seed={seed}", "compile=true")
        for frames in [1] * 20 + [20] * 5:
            alone.learner.learn(frames)
        assert_same_weights(together, index, alone)


def test_large_networks_are_compiled_where_there_is_a_compiler(monkeypatch, traced):
    large = ("network.hidden_sizes=[256,128]", "compile=true")
    compiled = make_pipeline(*large)
    compiled.learner.learn(2)
    assert compiled.learner.state_dict()["kind"] == "compiled"
    monkeypatch.setenv("CXX", "no-such-compiler")
    machine = make_pipeline(*large)
    machine.learner.learn(2)
    assert machine.learner.state_dict()["kind"] == "machine code"


@pytest.mark.parametrize(
    ("key", "value", "message"), [("items", 131072, "no such transition"), ("action", 3, "an action")]
)
def test_machine_code_reads_nothing_beyond_the_memory_and_the_values(key, value, message):
    pipeline = make_pipeline("compile=true")
    pipeline.learner.learn(2)
    memory, items = memory_of(pipeline.replay_buffer), torch.zeros(1, 128, 1, dtype=torch.int64)
    (items if key == "items" else memory["action"]).fill_(value)
    make = pipeline.algorithm.machine_code(memory, 128)
    with pytest.raises(ValueError, match=message):
        make(2, items, None)


class OwnLoss(DQNLoss):
    """A user's, which may compute anything."""


def absolute(network):
    loss = DQNLoss(network, loss_function="l1", delay_value=True, action_space="categorical")
    loss.make_value_estimator(gamma=0.9)
    return loss


def of_my_own(network):
    loss = OwnLoss(network, loss_function="l2", delay_value=True, action_space="categorical")
    loss.make_value_estimator(gamma=0.9)
    return loss


@pytest.mark.parametrize("make_loss", [absolute, of_my_own])
def test_a_loss_of_another_kind_has_no_machine_code(make_loss):
    pipeline = make_pipeline()
    (replicate,) = pipeline.algorithm.replicates
    replicate = replace(replicate, loss=make_loss(replicate.network))
    algorithm = DQN([replicate], pipeline.algorithm.exploration, pipeline.world.action.names)
    with pytest.raises(CompilationError, match="the loss"):
        algorithm.machine_code(memory_of(pipeline.replay_buffer), 8)


RELU = nn.ReLU()


class Counting(nn.Linear):
    """A layer of a user's own, with a buffer of another type."""

    def __init__(self, inputs, outputs):
        super().__init__(inputs, outputs)
        self.register_buffer("calls", torch.zeros(1, dtype=torch.int64))


@pytest.mark.parametrize(
    "layers",
    [
        [nn.Linear(7, 8, bias=False), nn.ReLU(), nn.Linear(8, 3)],
        [nn.Linear(7, 8).requires_grad_(False), nn.ReLU(), nn.Linear(8, 3)],
        [Counting(7, 8), nn.ReLU(), nn.Linear(8, 3)],
        [nn.Linear(7, 8), RELU, nn.Linear(8, 3), RELU],
    ],
    ids=["without biases", "partly frozen", "of a class of its own", "one ReLU twice, at the end, too"],
)
def test_a_network_of_another_kind_has_no_machine_code_and_acts_as_it_is(layers):
    network = QNetwork(nn.Sequential(*layers))
    pipeline = make_pipeline()
    (replicate,) = pipeline.algorithm.replicates
    replicate = replace(replicate, network=network, loss=make_dqn_loss(0.9, "l2", False, network=network))
    algorithm = DQN([replicate], pipeline.algorithm.exploration, pipeline.world.action.names)
    observation = torch.rand(5, 7)
    torch.testing.assert_close(algorithm.greedy.action_values(observation), network.layers(observation))
    with pytest.raises(CompilationError, match="the network is not made of linear layers"):
        algorithm.machine_code(memory_of(pipeline.replay_buffer), 8)


@needs_compiler
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
def test_an_update_that_is_given_noise_and_weights_is_compiled_and_kept_between_runs(caplog):
    caplog.set_level(logging.WARNING)
    overrides = (*OTHERS[0], "trainer.seeds=[1,2]")
    eager, compiled = make_pipeline(*overrides), make_pipeline(*overrides, "compile=true")
    torch.testing.assert_close(updated(compiled, 60), updated(eager, 60), rtol=1e-3, atol=0)
    assert not any("eagerly" in message for message in messages(caplog))
    assert list(cache_dir().glob("*.pt2"))
    caplog.clear()
    again = make_pipeline(*overrides, "compile=true")
    updated(again, count=60)
    assert messages(caplog) == []
    for ours, theirs in zip(again.algorithm.networks, compiled.algorithm.networks, strict=True):
        assert all(map(torch.equal, ours.parameters(), theirs.parameters()))


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
@pytest.mark.parametrize("overrides", OTHERS[1:], ids=" ".join)
def test_whatever_an_update_is_made_with_it_is_traced_with_the_same_numbers(overrides, traced, caplog):
    overrides = (*overrides, "trainer.seeds=[1,2]")
    eager, compiled = make_pipeline(*overrides), make_pipeline(*overrides, "compile=true")
    torch.testing.assert_close(updated(compiled, 60), updated(eager, 60), rtol=1e-3, atol=0)
    assert not any("eagerly" in message for message in messages(caplog))


@pytest.mark.parametrize("overrides", [*OTHERS, FEATURES[2]], ids=" ".join)
def test_whatever_an_update_is_made_with_together_and_alone_the_weights_are_the_same_bit_for_bit(overrides):
    together = make_pipeline(*overrides, "trainer.seeds=[1,2]")
    together.learner.learn(5)
    for index, seed in enumerate((1, 2)):
        alone = make_pipeline(*overrides, f"seed={seed}")
        alone.learner.learn(5)
        assert_same_weights(together, index, alone)


@needs_compiler
@pytest.mark.exhaustive
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
def test_compiled_together_or_alone_the_weights_are_the_same_bit_for_bit():
    together = make_pipeline("loss=dueling", "trainer.seeds=[1,2]", "compile=true")
    together.learner.learn(200)
    for index, seed in enumerate((1, 2)):
        alone = make_pipeline("loss=dueling", f"seed={seed}", "compile=true")
        alone.learner.learn(200)
        assert_same_weights(together, index, alone)


def test_without_a_compiler_other_updates_are_eager_and_one_line_says_so(monkeypatch, caplog):
    monkeypatch.setenv("CXX", "no-such-compiler")
    losses = updated(make_pipeline("loss=dueling", "compile=true"), count=5)
    assert torch.equal(losses, updated(make_pipeline("loss=dueling"), count=5))
    (message,) = messages(caplog)
    assert "cannot be compiled: no C++ compiler is installed" in message


@pytest.mark.parametrize("becomes", ["itself", "an error", "nothing"])
def test_an_interrupted_compilation_is_not_replaced_by_eager_updates(becomes, monkeypatch, caplog):
    """Whatever torch and torchrl make of the KeyboardInterrupt that a signal's handler raises in them."""
    learner = make_pipeline("loss=dueling", "compile=true").learner

    def compile_interrupted(*_):
        try:
            learner.interrupt()
        except KeyboardInterrupt:
            if becomes == "itself":
                raise
            if becomes == "an error":
                raise CompilationError("RuntimeError: a tensordict has no truth value") from None
        return list

    monkeypatch.setattr("carrl.algorithms.common.compiled_update.compile_native", compile_interrupted)
    learner.interrupt()  # there is no compilation yet
    with pytest.raises(KeyboardInterrupt):
        learner.learn(8)
    assert learner.updates == 0
    assert messages(caplog) == []


@pytest.mark.parametrize(
    ("optimizer", "reason"),
    [
        (lambda parameters: torch.optim.SGD(parameters, lr=1e-3, momentum=0.9), "the optimizer is SGD"),
        (lambda parameters: torch.optim.Adam(parameters, lr=1e-3, amsgrad=True), "the optimizer uses amsgrad"),
    ],
    ids=["SGD", "AMSGrad"],
)
def test_another_optimizer_than_plain_adam_runs_eagerly(optimizer, reason, caplog):
    pipeline = make_pipeline()
    (replicate,) = pipeline.algorithm.replicates
    replicate = replace(replicate, optimizer=optimizer(list(replicate.loss.parameters())))
    before = [parameter.clone() for parameter in replicate.network.parameters()]
    Learner(
        DQN([replicate], pipeline.algorithm.exploration, pipeline.world.action.names),
        pipeline.replay_buffer,
        compiled=True,
    ).learn(3)
    (message,) = messages(caplog)
    assert reason in message
    assert any((a != b).any() for a, b in zip(before, replicate.network.parameters(), strict=True))


def test_compiled_code_is_told_apart_by_every_constant_and_shape():
    def fingerprint(function, *shape):
        inputs = [torch.ones(shape)]
        return _fingerprint(make_fx(function)(*inputs), inputs)

    discount, other_discount = torch.tensor(0.95), torch.tensor(0.9)
    names = [
        fingerprint(lambda values: values * discount, 3),
        fingerprint(lambda values: values * other_discount, 3),
        fingerprint(lambda values: values * 0.5, 3),
        fingerprint(lambda values: values * 0.25, 3),
        fingerprint(lambda values: values * 0.5, 4),
    ]
    assert len(set(names)) == len(names)
    assert fingerprint(lambda values: values * discount, 3) == names[0]


@needs_compiler
def test_code_is_not_loaded_from_a_folder_that_others_can_write_to(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    cache_dir().mkdir()
    cache_dir().chmod(0o777)
    updated(make_pipeline("loss=dueling", "compile=true"), count=2)
    assert "can be written by others; remove it" in caplog.text
    assert list(cache_dir().iterdir()) == []
