"""A run's configuration from a stranger calls nothing but what its groups offer, and fills no memory."""

import json

import pytest
import yaml

from carrl.cli.main import main
from carrl.config import config_dir
from carrl.targets import TARGETS
from carrl.train.files import CONFIG
from tests.strangers import make_run, refused

CALLS = {
    "os.system": {"command": "touch {marker}"},
    "subprocess.call": {"args": ["touch", "{marker}"]},
    "builtins.exec": {"source": "open('{marker}', 'w')"},
    "builtins.open": {"file": "{marker}", "mode": "w"},
    "pathlib.Path.touch": {"self": "{marker}"},
    "carrl.config.inspect.os.system": {"command": "touch {marker}"},
    "carrl.train.files.write_text": {"path": "{marker}", "text": ""},
    "carrl.files.write_whole": {"path": "{marker}", "content": ""},
    "carrl.log.mcap_write.McapFile": {"path": "{marker}"},
    "carrl.log.writer.LogWriter": {"path": "{marker}", "attachments": {}, "metadata": {}},
    "carrl.cli.main.main": {"argv": ["track", "random", "--out", "{marker}.csv"]},
    "torch.save": {"obj": 1, "f": "{marker}"},
}


@pytest.mark.parametrize("group", ["track", "vehicle", "sensor", "action", "network"])
@pytest.mark.parametrize("target", CALLS)
def test_a_config_calls_nothing_but_what_its_group_offers(tmp_path, marker, capsys, group, target):
    values = json.loads(json.dumps(CALLS[target]).replace("{marker}", str(marker)))
    run = make_run(tmp_path / "run", **{group: {"_target_": target, **values}})
    assert f"{group}._target_ is " in refused(capsys, "evaluate", run)


@pytest.mark.parametrize("term", ["reward.gate", "observation.rays"])
@pytest.mark.parametrize("target", CALLS)
def test_a_term_calls_nothing_but_what_its_group_offers(tmp_path, marker, capsys, term, target):
    values = json.loads(json.dumps(CALLS[target]).replace("{marker}", str(marker)))
    group, name = term.split(".")
    run = make_run(tmp_path / "run", **{group: {name: {"_target_": target, **values}}})
    assert f"{term}._target_ is " in refused(capsys, "evaluate", run)


def targets_in(node):
    """Whatever a node of the configuration and those in it name."""
    if not isinstance(node, dict):
        return set()
    own = {node["_target_"]} if "_target_" in node else set()
    return own.union(*map(targets_in, node.values()))


def test_the_targets_allowed_are_those_that_the_yaml_files_name():
    named: dict[str, set[str]] = {}
    for path in config_dir().glob("*/*.yaml"):
        node = yaml.safe_load(path.read_text()) or {}
        group = path.parent.name
        found = targets_in(node.get(group) if group in node else node)
        if found and group != "experiment":
            named[group] = named.get(group, set()) | found
    nodes = yaml.safe_load((config_dir() / "train.yaml").read_text())
    alone = {group: set(targets) for group, targets in TARGETS.items() if isinstance(nodes.get(group), dict)}
    assert all(len(targets) == 1 for targets in alone.values())
    assert named | alone == {group: set(targets) for group, targets in TARGETS.items()}


@pytest.mark.parametrize(
    ("verb", "message"), [(["evaluate"], "not YAML"), (["report", "--best-lap"], "no run has a configuration")]
)
def test_a_config_that_is_a_program_is_refused(tmp_path, marker, capsys, verb, message):
    run = make_run(tmp_path / "run")
    tags = ["!!python/object/apply:os.system ['touch {}']", "!!python/object/new:os.system ['touch {}']"]
    for tag in tags:
        (run / CONFIG).write_text(f"seed: {tag.format(marker)}\n")
        assert message in refused(capsys, *verb, run)


LEVELS = "\n".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12))
MERGES = "\n".join(f"a{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 9)}]}}" for i in range(1, 12))
BOMBS = {
    "a list of billions": ("a0: &a0 [1, 1, 1]\n" + LEVELS, "*a11"),
    "a mapping merged billions of times": ("a0: &a0 {b: 1}\n" + MERGES, "*a11"),
    "a deep nest": ("", "[" * 50_000 + "]" * 50_000),
    "a list of itself": ("", "&b [*b]"),
    "a number of many digits": ("", "9" * 200_000),
    "a number in base 60": ("", "1" + ":1" * 100_000),
    "a long text": ("", "a" * 200_000),
}


@pytest.mark.parametrize("place", ["track", "track._target_", "track.name_or_path", "sensor.rays", "seed"])
@pytest.mark.parametrize("bomb", BOMBS)
def test_a_small_config_that_stands_for_a_huge_one_is_refused_at_once(tmp_path, capsys, bomb, place):
    run = make_run(tmp_path / "run")
    before, value = BOMBS[bomb]
    config = yaml.safe_load((run / CONFIG).read_text())
    *above, key = place.split(".")
    (config[above[0]] if above else config)[key] = "BOMB"
    text = yaml.safe_dump(config).replace("BOMB", value)
    (run / CONFIG).write_text(f"{before}\n{text}")
    refused(capsys, "evaluate", run, "--policy", "random")
    assert main(["report", str(run)]) == 0  # which names the run as damaged, or shows its values cut
    assert len(capsys.readouterr().out) < 20_000


@pytest.mark.parametrize(
    ("group", "key", "value", "words"),
    [
        ("sensor", "rays", 10**9, "sensor.rays is 1000000000; it must be a whole number from 1 to 4096"),
        ("sensor", "max_range", float("inf"), "sensor.max_range is inf; it must be a finite number"),
        ("sensor", "noise", float("nan"), "sensor.noise is nan; it must be a finite number"),
        ("sensor", "max_range", 10**400, "sensor.max_range is "),
        ("network", "hidden_sizes", [10**6, 10**6], "it may have at most 64 layers and 67108864 weights"),
        ("network", "hidden_sizes", [1] * 2000, "it may have at most 64 layers"),
        ("network", "hidden_sizes", [1] * 5000, "network.hidden_sizes has 5000 items"),
        ("network", "generator", 5, "network has no key 'generator'; make_q_network takes hidden_sizes"),
        ("vehicle", "speed", 1e-12, "vehicle.speed is 1e-12; it must lie between 1e-09 and 1e+09"),
        ("vehicle", "speed", 1e-6, "more than can be kept"),
        ("reward.gate", "weight", float("nan"), "reward.gate.weight is nan; it must be a finite number"),
        ("track", "gate_spacing", float("inf"), "track.gate_spacing is inf; it must be a finite number"),
        ("track", "name_or_path", "/dev/zero", "this is not a regular file"),
        ("track", "name_or_path", "/", "this is a folder"),
        ("track", "name_or_path", "\x1b[2Jnowhere", "no file of this path"),
        ("observation", "rays", [], "observation.rays is []; it must be a mapping of keys to values"),
        ("reward.proximity", "threshold", [], "reward.proximity.threshold is []; it must be of type float"),
        ("reward.gate", "wight", 5.0, "reward.gate has no key 'wight'; Gate takes weight"),
        ("reward", "\x1b[2J", {}, "reward has a term called '\\x1b[2J'; a term's name is made of letters"),
        ("reward", 5, {}, "reward has a term called 5; a term's name is made of letters"),
        ("action", "names", 3, "action.names is 3; it must be of type"),
        ("action", "names", [], "action.names is []; it must name at least one action, none twice"),
        ("action", "settings", 3, "action.settings is 3; it must be of type"),
        ("action.settings", "steer", 0.5, "action.settings is {'steer': 0.5}; it must be of type"),
        ("action.settings", "steer", [0, 2, 1], "action.settings.steer is [0, 2, 1]; it must have a number within"),
        ("action.settings", "steer", [0, 1], "action.settings.steer is [0, 1]; it must have a number within"),
        ("action.settings", "throttle", [0, 1, 1], "action sets steer, throttle; the vehicle Vehicle is controlled by"),
    ],
)
def test_a_config_with_a_value_that_cannot_be_is_refused(tmp_path, capsys, group, key, value, words):
    run = make_run(tmp_path / "run")
    config = yaml.safe_load((run / CONFIG).read_text())
    node = config
    for name in group.split("."):
        node = node[name]
    node[key] = value
    (run / CONFIG).write_text(yaml.safe_dump(config))
    assert words in refused(capsys, "evaluate", run)


@pytest.mark.parametrize("node", [None, [], 5, "x", {}, {"_target_": "carrl.tracks.track.Track.load"}])
def test_a_config_whose_node_is_no_node_is_refused(tmp_path, capsys, node):
    groups = ["track", "vehicle", "action", "observation", "reward", "network"]
    for group in groups + (["sensor"] if node != {} else []):  # a sensor without keys is the paper's
        assert group in refused(capsys, "evaluate", make_run(tmp_path / f"{group}", **{group: node}))


@pytest.mark.parametrize("seed", [-1, 2**64, "0", None, True, [1]])
def test_a_config_whose_seed_is_none_is_refused(tmp_path, capsys, seed):
    assert "seed is " in refused(capsys, "evaluate", make_run(tmp_path / "run", seed=seed), "--policy", "random")


@pytest.mark.parametrize(
    "override",
    [
        "trainer.seeds=[0..99999999999]",
        "replay_buffer.capacity=1000000000",
        "env.num_envs=10000000",
        "reward.gate.weight=nan",
        "env.max_steps=99999999999999999999",
        "collector.steps_per_batch=1000000",
        "exploration.decay_rate=inf",
        "optimizer.lr=inf",
    ],
)
def test_training_refuses_what_no_memory_holds_and_no_number_is(tmp_path, capsys, override, monkeypatch):
    monkeypatch.chdir(tmp_path)
    key = override.split("=")[0]
    assert key in refused(capsys, "train", "experiment=smoke", "compile=false", override)
