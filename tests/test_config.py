"""Every YAML file is a working choice, explained key by key."""

import pytest

from carrl.config import build_node, config_dir
from carrl.errors import ConfigError
from carrl.train.build import build_pipeline
from tests.configs import compose
from tests.export.untrained_runs import write_untrained_run

LEAVES = sorted(
    str(path.relative_to(config_dir()).with_suffix(""))
    for path in config_dir().rglob("*.yaml")
    if path.parent != config_dir() and path.stem != "file"
)

DRIVEN = ["vehicle=kinematic", "action=table"]
"""A car with a speed of its own, for parts that look at it."""
BESIDE = {
    "action/table": DRIVEN,
    "action/continuous": ["loss=sac"],
    **{name: ["loss=sac"] for name in ("algorithm/actor_critic", "network/actor_critic")},
    **{f"exploration/{name}": ["loss=sac"] for name in ("none", "gaussian", "ornstein_uhlenbeck")},
    "vehicle/kinematic": DRIVEN,
    "vehicle/single_track": DRIVEN,
    **{f"observation/{name}": DRIVEN for name in ("f1tenth", "gran_turismo", "race", "racer", "time_trial", "torcs")},
    **{
        f"reward/{name}": DRIVEN
        for name in ("progress", "gran_turismo", "race", "racing", "lap_time", "torcs", "torcs_centred")
    },
    **{f"opponents/{name}": ["env.cars_per_world=3"] for name in ("line", "rule")},
    "opponents/policy": ["env.cars_per_world=3", "opponents.run='RUN'"],
    "data/log": ["data.path=tests/log/version2.mcap"],
    "network/distributional": ["loss=distributional"],  # that needs it
    "experiment/f1tenth": ["track.name_or_path=oval"],
    **{
        f"experiment/{name}": ["track.count=4", "track.validation=2"]
        for name in ("generalist", "race", "racer", "traffic")
    },
}


@pytest.mark.parametrize("leaf", LEAVES)
def test_every_option_of_every_group_builds(leaf, tmp_path):
    group, option = leaf.split("/")
    beside = BESIDE.get(leaf, [])
    if any("RUN" in each for each in beside):
        write_untrained_run(tmp_path / "run")
        beside = [each.replace("RUN", str(tmp_path / "run")) for each in beside]
    if option == "ray":
        pytest.importorskip("ray", reason="clusters need it; pip install 'carrl[ray]'")
    pipeline = build_pipeline(compose(f"{group}={option}", *beside))
    assert len(pipeline.algorithm.seeds) >= 1
    pipeline.source.close()


def test_numbers_as_actions_are_refused_by_dqn_in_one_sentence():
    with pytest.raises(ConfigError, match="DQN has a value for each action, and action is made of numbers; set an"):
        build_pipeline(compose("action=continuous"))


def test_a_track_file_is_an_option_of_the_track_group(real_circuits):
    path = real_circuits / "Norisring.csv"
    pipeline = build_pipeline(compose("track=file", f"track.name_or_path='{path}'"))
    assert pipeline.world.track.name == "Norisring.csv"
    pipeline.source.collector.shutdown()


def test_the_default_is_table_i_of_the_paper():
    config = compose()
    assert config["network"]["hidden_sizes"] == [16, 16, 8]
    assert config["sensor"]["rays"] == 7
    assert config["loss"]["gamma"] == 0.95
    assert config["loss"]["double_dqn"] is False
    assert config["loss"]["loss_function"] == "l2"
    assert config["optimizer"]["lr"] == 1e-3
    assert config["replay_buffer"]["batch_size"] == 128
    assert config["replay_buffer"]["capacity"] == 131072
    assert config["target_updater"]["period"] == 36000
    exploration = config["exploration"]
    assert [exploration[key] for key in ("epsilon_max", "epsilon_min", "decay_rate")] == [0.99, 0.01, 1e-4]
    reward = config["reward"]
    assert [reward[term]["weight"] for term in ("collision", "proximity", "gate")] == [-200, -20, 50]
    assert reward["proximity"]["threshold"] == 0.1
    assert (reward["steering"]["turn"], reward["steering"]["switch"]) == (0, 0)
    assert config["action"]["settings"] == {"steer": [0.0, 1.0, -1.0]}
    assert list(config["observation"]) == ["rays"]
    assert config["trainer"]["episodes"] == 3000
    assert config == compose("experiment=paper")


def test_double_dqn_differs_from_dqn_by_the_loss_alone():
    dqn, double = compose(), compose("loss=double_dqn")
    assert double.pop("loss") == dqn.pop("loss") | {"double_dqn": True}
    assert dqn == double
    assert build_pipeline(compose("loss=double_dqn")).algorithm.replicates[0].loss.double_dqn


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"max_rang": 3.0},
            "sensor has no key 'max_rang'; Sensor takes rays, field_of_view, max_range, noise, dropout, mount, turn",
        ),
        ({"rays": "many"}, "sensor.rays is 'many'; it must be of type int"),
        ({"rays": 7.0}, "sensor.rays is 7.0; it must be of type int; write 7"),
        ({"rays": True}, "sensor.rays is True; it must be of type int"),
        ({"max_range": None}, "sensor.max_range is None; it must be of type float"),
        ({"max_range": -1.0}, "sensor.max_range is -1.0; it must be a positive number of metres"),
        (
            {"max_range": float("nan")},
            "sensor.max_range is nan; it must be a finite number of at most 9007199254740992",
        ),
    ],
)
def test_a_wrong_value_is_one_clear_sentence(values, message):
    with pytest.raises(ConfigError) as caught:
        build_node("sensor", {"_target_": "carrl.sim.sensor.Sensor", **values})
    assert str(caught.value) == message


def test_whole_numbers_may_stand_for_floats():
    assert build_node("sensor", {"_target_": "carrl.sim.sensor.Sensor", "max_range": 5}).max_range == 5
