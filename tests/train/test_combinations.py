"""What goes together trains, and what does not is refused in one sentence, before anything is written."""

import json

import pytest

from carrl.cli.main import main
from carrl.config import config_dir
from carrl.train.build import build_pipeline
from tests.configs import compose

TINY = [
    "track=oval",
    "env.num_envs=8",
    "env.max_steps=20",
    "trainer.frames=32",
    "evaluation.interval=16",
    "replay_buffer.batch_size=16",
    "recorder=null",
]
GROUPS = ["exploration", "learning_rate", "loss", "network", "replay_buffer", "reward", "target_updater"]
OPTIONS = ["gradient_clipping.max_norm=10", "returns.steps=3"]
OPTIONS += [
    f"{group}={path.stem}"
    for group in GROUPS
    for path in sorted((config_dir() / group).glob("*.yaml"))
    if (group, path.stem) != ("network", "distributional")  # loss=distributional brings it along
]


OF_ACTORS = [f"exploration={name}" for name in ("none", "gaussian", "ornstein_uhlenbeck")] + ["network=actor_critic"]


@pytest.mark.parametrize("option", OPTIONS)
def test_every_option_of_every_part_of_learning_trains(option, tmp_path):
    overrides = [*TINY, "compile=false", option, *(["loss=td3"] if option in OF_ACTORS else [])]
    if option.startswith("reward=") and option not in ("reward=paper", "reward=shaped"):
        overrides += ["vehicle=kinematic", "action=table"]
    assert main(["train", *overrides, f"hydra.run.dir={tmp_path}"]) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["finished"]
    assert summary["updates"] > 0


def test_all_of_them_at_once_train_and_are_evaluated(tmp_path, capsys):
    overrides = ["loss=distributional", "replay_buffer=prioritized", "returns.steps=3", "target_updater=soft"]
    overrides += ["gradient_clipping.max_norm=10", "learning_rate=cosine", "exploration=linear", "reward=shaped"]
    tiny = [each for each in TINY if each != "recorder=null"]
    assert main(["train", *tiny, "compile=false", *overrides, f"hydra.run.dir={tmp_path}"]) == 0
    capsys.readouterr()
    assert main(["evaluate", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)
    assert main(["log", "check", str(tmp_path / "train.mcap")]) == 0
    capsys.readouterr()
    assert main(["log", "show", str(tmp_path / "train.mcap"), "--episode", "0", "--json"]) == 0
    assert "shaping" in json.loads(capsys.readouterr().out)["reward_terms"]


@pytest.mark.parametrize("experiment", ["fast", "smooth"])
@pytest.mark.parametrize("option", ["target_updater=soft", "exploration=linear", "loss=dueling", "loss=distributional"])
def test_experiments_take_other_parts(experiment, option):
    pipeline = build_pipeline(compose(f"experiment={experiment}", option))
    assert len(pipeline.algorithm.replicates) == 1
    pipeline.source.collector.shutdown()


def test_loss_dueling_is_double_dqn_with_the_dueling_network():
    dueling, double = compose("loss=dueling"), compose("loss=double_dqn", "network=dueling")
    dueling["loss"].pop("_target_"), double["loss"].pop("_target_")
    assert dueling == double


REFUSED = [
    (["replay_buffer=prioritized", "loss=cql"], "loss is cql, whose conservative term weighs all transitions alike"),
    (["loss=distributional", "network=noisy"], "loss is distributional, and the network is not"),
    (["network=distributional"], "network is distributional, which loss=distributional alone can train"),
    (["network=distributional", "loss=cql"], "network is distributional, which loss=distributional alone can train"),
    (["loss=dueling", "network=noisy"], "loss is dueling, and the network is not"),
    (["target_updater=soft", "target_updater.tau=2"], "target_updater.tau is 2; it must be more than 0"),
    (["learning_rate=linear", "learning_rate.final_share=nan"], "learning_rate.final_share is nan"),
    (
        ["exploration=linear", "exploration.epsilon_max=nan"],
        "exploration.epsilon_max is nan; it must be a finite",
    ),
    (["returns.steps=0"], "returns.steps is 0; it must be at least 1"),
    (["returns.steps=2.5"], "returns.steps is 2.5; it must be of type int"),
    (["optimizer.lr=fast"], "optimizer.lr is 'fast'"),
    (["optimizer.lr=-1"], "optimizer: Invalid learning rate: -1"),
    (["sedd=1"], "there is no key sedd; did you mean seed?"),
    (["loss.gama=0.9"], "there is no key loss.gama; did you mean loss.gamma?"),
    (["loss=ddqn"], "loss has no option ddqn; did you mean dqn, or one of"),
    (["gradient_clipping.max_norm=0"], "gradient_clipping.max_norm is 0; it must be"),
    (["data=log", "data.path=tests/log/version2.mcap", "returns.steps=3"], "returns are over several steps"),
    (["collector=ray", "returns.steps=3"], "collector=ray may break an episode off"),
]


@pytest.mark.parametrize(
    ("overrides", "message"), REFUSED, ids=lambda value: " ".join(value) if isinstance(value, list) else ""
)
def test_what_does_not_go_together_is_refused_in_one_sentence(overrides, message, tmp_path, capsys):
    run = tmp_path / "run"
    assert main(["train", *overrides, f"hydra.run.dir={run}"]) == 2
    output = capsys.readouterr()
    assert message in output.err
    assert output.err.count("\n") == 1
    assert output.out == ""
    assert not run.exists()


def test_shaping_discounts_as_the_loss_does():
    config = compose("reward=shaped", "loss.gamma=0.8")
    assert config["reward"]["shaping"]["discount"] == 0.8
