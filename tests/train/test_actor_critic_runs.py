"""DDPG, TD3 and SAC as they are trained: compiled, side by side, broken off, from logs."""

import json
import shutil

import pytest
import torch

from carrl.algorithms.common.compiled_update import CompiledUpdate
from carrl.algorithms.common.native import CompilationError
from carrl.cli.main import main
from carrl.log import load, read_metrics
from carrl.train.build import build_pipeline
from tests.configs import compose
from tests.stopped_runs import assert_same_run, assert_same_state, interrupted, state_of, train
from tests.train.test_learner import make_pipeline, updated

needs_compiler = pytest.mark.skipif(shutil.which("g++") is None, reason="there is no C++ compiler to compile with")
NETWORKS = ["network.actor_sizes=[16,16]", "network.critic_sizes=[16,16]", "vehicle=bicycle"]
SMALL = [*NETWORKS, "start.anywhere=true"]
LOSSES = {
    "ddpg": ["loss=ddpg", "returns.steps=3", "replay_buffer=prioritized", "learning_rate=linear"],
    "td3": ["loss=td3", "exploration.sigma=1.0", "replay_buffer=prioritized"],
    "sac": ["loss=sac", "returns.steps=3", "gradient_clipping.max_norm=10", "learning_rate=cosine"],
}


def compared(overrides, updates=50):
    """The greatest relative difference of any tensor after so many updates, compiled and eagerly."""
    eager, compiled = make_pipeline(*SMALL, *overrides), make_pipeline(*SMALL, *overrides, "compile=true")
    torch.testing.assert_close(updated(compiled, updates), updated(eager, updates), rtol=1e-4, atol=1e-7)
    differences = []
    for ours, theirs in zip(compiled.algorithm.replicates, eager.algorithm.replicates, strict=True):
        own, other = ours.loss.state_dict(), theirs.loss.state_dict()
        assert own.keys() == other.keys()
        tensors = [name for name, value in own.items() if isinstance(value, torch.Tensor) and value.is_floating_point()]
        differences += [((own[name] - other[name]).norm() / other[name].norm()).item() for name in tensors]
    return max(differences)


@needs_compiler
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
@pytest.mark.parametrize(
    ("name", "seeds"), [pytest.param("td3", "[1]", marks=pytest.mark.exhaustive), ("sac", "[1,2]")]
)
def test_50_compiled_updates_equal_50_eager_ones(name, seeds, caplog):
    assert compared([*LOSSES[name], f"trainer.seeds={seeds}"]) < 1e-4
    assert not any("eagerly" in record.message for record in caplog.records)


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
@pytest.mark.parametrize("name", ["ddpg", "td3"])
def test_50_traced_updates_equal_50_eager_ones(name, traced, caplog):
    assert compared(LOSSES[name]) < 1e-4
    assert not any("eagerly" in record.message for record in caplog.records)


@pytest.mark.parametrize("name", LOSSES)
def test_together_and_alone_the_weights_are_the_same_bit_for_bit(name):
    together = make_pipeline(*SMALL, *LOSSES[name], "trainer.seeds=[1,2]")
    together.learner.learn(5)
    for index, seed in enumerate((1, 2)):
        alone = make_pipeline(*SMALL, *LOSSES[name], f"seed={seed}")
        alone.learner.learn(5)
        own, other = (each.state_dict()["replicates"] for each in (together.algorithm, alone.algorithm))
        assert_same_state(own[index], other[0])


def test_td3_moves_its_actor_and_targets_in_every_second_update_from_the_first_on():
    pipeline = make_pipeline(*SMALL, *LOSSES["td3"])
    (replicate,) = pipeline.algorithm.replicates
    groups = [*replicate.networks, *replicate.targets]
    moved = []
    for _ in range(4):
        before = [replicate.loss._modules[name].clone() for name in groups]
        pipeline.learner.learn(1)
        pairs = zip(before, groups, strict=True)
        moved.append([bool((old != replicate.loss._modules[name]).any()) for old, name in pairs])
    assert moved == [[True] * 4, [True, False, False, False], [True] * 4, [True, False, False, False]]


def test_parts_have_learning_rates_of_their_own_which_fall_together():
    overrides = ["loss.actor_rate=0.1", "loss.alpha_rate=3", "learning_rate.final_share=0", "learning_rate.updates=2"]
    pipeline = make_pipeline(*SMALL, *LOSSES["sac"], *overrides, "optimizer.lr=0.01")
    (replicate,) = pipeline.algorithm.replicates

    def rates():
        return {part: each.param_groups[0]["lr"] for part, each in replicate.optimizers.items()}

    assert rates() == pytest.approx({"critic": 0.01, "actor": 0.001, "alpha": 0.03})
    pipeline.learner.learn(2)
    assert rates() == pytest.approx({"critic": 0.005, "actor": 0.0005, "alpha": 0.015})


def test_where_compilation_fails_halfway_eager_updates_go_on_with_the_very_parameters(monkeypatch):
    """They have been stacked by then, and so moved to other memory."""

    def fail(self, *arguments):
        original(self, *arguments)
        raise CompilationError("in a test")

    original = CompiledUpdate.__init__
    monkeypatch.setattr("carrl.algorithms.common.compiled_update.compile_native", lambda *_: list)
    monkeypatch.setattr(CompiledUpdate, "__init__", fail)
    overrides = [*SMALL, *LOSSES["sac"], "trainer.seeds=[1,2]"]
    broken, eager = make_pipeline(*overrides, "compile=true"), make_pipeline(*overrides)
    broken.learner.learn(6)
    eager.learner.learn(6)
    assert_same_state(broken.algorithm.state_dict(), eager.algorithm.state_dict())


def test_measuring_moves_no_generator():
    pipeline = make_pipeline(*SMALL, *LOSSES["sac"])
    pipeline.learner.learn(2)
    algorithm, before = pipeline.algorithm, pipeline.algorithm.state_dict()
    sample = pipeline.replay_buffer.storage.get(torch.arange(50))
    (first,), (second,) = algorithm.measure(sample), algorithm.measure(sample)
    assert first == second
    assert first.keys() == {"td_error", "action_value", "entropy", "alpha"}
    assert_same_state(algorithm.state_dict(), before)


# Runs

FRAMES = 120
TINY = [
    *SMALL,
    "track=oval",
    "env.num_envs=8",
    "env.max_steps=16",
    f"trainer.frames={FRAMES}",
    "evaluation.interval=40",
    "replay_buffer.capacity=96",
    "replay_buffer.batch_size=16",
    "compile=false",
]


@pytest.fixture(scope="module", params=LOSSES)
def run(request, tmp_path_factory):
    """A loss's name, and the folder of a run with it."""
    return request.param, train(tmp_path_factory.mktemp("runs") / request.param, *TINY, *LOSSES[request.param])


def test_a_resumed_run_is_the_run_never_stopped_bit_for_bit(run, tmp_path, monkeypatch):
    name, whole = run
    stopped = interrupted(monkeypatch, tmp_path / "run", 56, *TINY, *LOSSES[name])
    assert main(["train", f"resume={stopped}"]) == 0
    assert_same_run(stopped, whole)
    assert_same_state(state_of(stopped), state_of(whole))


def test_the_log_has_actions_as_numbers_and_what_the_actor_would_have_done(run):
    transitions = load(run[1] / "train.mcap")
    assert transitions["action"].dtype == transitions["greedy_action"].dtype == torch.float32
    assert transitions["action"].shape == transitions["greedy_action"].shape == (FRAMES, 1)
    assert (transitions["action"] != transitions["greedy_action"]).any()


def test_the_log_has_the_figures_of_its_algorithm(run):
    name, folder = run
    own = {"entropy", "alpha"} if name == "sac" else {"sigma"}
    for metrics in read_metrics(folder / "train.mcap"):
        assert metrics.figures.keys() == {"td_error", "action_value"} | own


def test_a_run_is_checked_evaluated_and_reported(run, tmp_path, capsys):
    _, folder = run
    assert main(["log", "check", str(folder / "train.mcap")]) == 0
    assert main(["report", str(folder), "--out", str(tmp_path / "report")]) == 0
    capsys.readouterr()
    assert main(["evaluate", str(folder), "--json"]) == 0
    (track,) = json.loads(capsys.readouterr().out)["tracks"]
    last = json.loads((folder / "summary.json").read_text())["evaluation"]
    assert track["drives"][0]["lap_steps"] == last["lap_steps"]


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A log of untrained actors, each action with much noise."""
    overrides = ["loss=td3", "exploration.sigma=1.0", "trainer.frames=240"]
    overrides += ["replay_buffer.capacity=512", "replay_buffer.batch_size=512"]
    return train(tmp_path_factory.mktemp("logs") / "run", *TINY, *overrides) / "train.mcap"


@pytest.mark.parametrize("loss", ["loss=ddpg", "loss=td3", "loss=sac"])
def test_all_three_learn_from_a_log_of_one(loss, log, tmp_path):
    overrides = ["data=log", f"data.path={log}", "data.updates=20", "compile=false", "track=oval"]
    folder = train(tmp_path / "run", *NETWORKS, *overrides, loss, "replay_buffer.batch_size=32")
    header, row, *_ = (folder / "metrics.csv").read_text().splitlines()
    figures = dict(zip(header.split(","), row.split(","), strict=True))
    assert {"td_error", "logged_value", "greedy_value", "action_distance"} <= figures.keys()
    assert 0 < float(figures["action_distance"]) < 2


def test_learning_from_a_log_of_discrete_actions_is_refused(tmp_path, capsys):
    source = train(tmp_path / "dqn", *TINY[4:], "trainer.frames=80", "evaluation.interval=80")
    overrides = ["data=log", f"data.path={source / 'train.mcap'}", "track=oval", "loss=sac", "compile=false"]
    capsys.readouterr()
    assert main(["train", *overrides, f"hydra.run.dir={tmp_path / 'run'}"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "its actions are ['forward', 'left', 'right']" in error


REFUSED = [
    (["loss=sac", "algorithm=dqn"], "loss is SAC, which is no part of DQN"),
    (["loss=sac", "action=steer3"], "an actor steers by numbers, and action is a choice among some"),
    (
        ["loss=sac", "exploration=paper"],
        "exploration is ExponentialEpsilonGreedy, which is no part of DDPG, TD3 or SAC",
    ),
    (["loss=sac", "network=paper"], "network is make_q_network, which is no part of DDPG, TD3 or SAC"),
    (["experiment=fast", "loss=td3"], "set exploration=none, gaussian or ornstein_uhlenbeck"),
    (["algorithm=actor_critic"], "loss is make_dqn_loss, which is no part of DDPG, TD3 or SAC; set loss=ddpg"),
    (["network=actor_critic"], "network is make_actor_critic, which is no part of DQN and its descendants"),
    (["exploration=gaussian"], "exploration is GaussianNoise, which is no part of DQN and its descendants"),
    (["action=continuous"], "DQN has a value for each action, and action is made of numbers"),
    (["loss=sac", "network.actor_sizes=[0]"], "network.actor_sizes is [0]; every layer needs at least 1 unit"),
    (["loss=sac", "network.critic_sizes=[100000,100000]"], "network.critic_sizes has 2 layers"),
    (["loss=sac", "network.activation=gelu"], "network.activation is 'gelu'; it must be relu or tanh or elu"),
    (["loss=sac", "loss.learn_alpha=false", "loss.target_entropy=-3"], "loss.target_entropy is -3, but with"),
    (
        ["loss=sac", "loss.learn_alpha=false", "loss.alpha_rate=7"],
        "loss.alpha_rate is 7, but with loss.learn_",
    ),
    (["vehicle=single_track"], "is controlled by steer, pedal, in this order; set action=continuous"),
    (["loss=td3", "loss.alpha=1"], "loss.alpha is a key of loss=advantage_learning, loss=cql and loss=sac only"),
]


@pytest.mark.parametrize(
    ("overrides", "message"), REFUSED, ids=lambda value: " ".join(value) if isinstance(value, list) else ""
)
def test_what_does_not_go_together_is_refused_in_one_sentence(overrides, message, tmp_path, capsys):
    folder = tmp_path / "run"
    assert main(["train", *overrides, f"hydra.run.dir={folder}"]) == 2
    output = capsys.readouterr()
    assert message in output.err
    assert output.err.count("\n") == 1
    assert not folder.exists()


@pytest.mark.parametrize(("loss", "exploration"), [("ddpg", "Ornstein"), ("td3", "Gaussian"), ("sac", "NoNoise")])
def test_a_loss_brings_all_that_it_needs_along(loss, exploration):
    config = compose(f"loss={loss}")
    assert exploration in config["exploration"]["_target_"]
    assert config["target_updater"] == {"_target_": "carrl.algorithms.common.optimizer.make_soft_update", "tau": 0.005}
    pipeline = build_pipeline(config)
    pipeline.source.close()


def test_a_loss_leaves_what_was_chosen_besides():
    config = compose("loss=ddpg", "exploration=gaussian", "target_updater=hard_frequent", "network.actor_sizes=[8]")
    assert "Gaussian" in config["exploration"]["_target_"]
    assert config["target_updater"]["period"] == 500
    assert config["network"]["actor_sizes"] == [8]
    build_pipeline(config).source.close()


def test_learning_from_a_log_of_other_controls_is_refused(log, tmp_path, capsys):
    overrides = ["data=log", f"data.path={log}", "loss=sac", "vehicle=kinematic", "compile=false"]
    assert main(["train", *overrides, f"hydra.run.dir={tmp_path / 'run'}"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "its actions are numbers for ['steer'], this car's for ['steer', 'pedal']" in error


def test_a_log_of_numbers_is_none_of_named_actions(log, tmp_path, capsys):
    overrides = ["data=log", f"data.path={log}", "compile=false"]
    assert main(["train", *overrides, f"hydra.run.dir={tmp_path / 'run'}"]) == 2
    assert "its actions are numbers, this car's are ['forward', 'left', 'right']" in capsys.readouterr().err
