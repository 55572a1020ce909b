"""Logs as what there is to learn from."""

import json

import pytest
import torch

from carrl.data.logs import check_logs, fill_from_logs
from carrl.data.replay_buffer import KEYS, make_replay_buffer
from carrl.errors import LogError
from carrl.log import load
from carrl.sim.sensor import Sensor
from tests.data.logs import METADATA, STEPS, logged_transitions, write_log

SENSOR = Sensor()


def make_buffer(agents):
    generators = [torch.Generator().manual_seed(seed) for seed in range(agents)]
    return make_replay_buffer(64, 4, device="cpu", generators=generators)


@pytest.mark.parametrize("agents", [1, 3])
def test_every_agent_gets_every_transition_of_every_log_in_order(agents, tmp_path):
    paths = [write_log(tmp_path / "a.mcap"), write_log(tmp_path / "b.mcap")]
    buffer = make_buffer(agents)
    fill_from_logs(buffer, paths, agents)
    expected = torch.cat([load(path) for path in paths])
    assert len(buffer) == len(expected) == 2 * len(STEPS)
    for agent in range(agents):
        for key in KEYS:
            assert torch.equal(buffer[:][:, agent].get(key), expected.get(key))


def test_agents_sample_different_minibatches_of_the_same_transitions(tmp_path):
    buffer = make_buffer(2)
    fill_from_logs(buffer, [write_log(tmp_path / "a.mcap")], 2)
    items, agents = buffer.sampler.sample(buffer.storage, 64)[0]
    assert not torch.equal(items[:, 0], items[:, 1])
    assert torch.equal(agents, torch.arange(2).expand(64, 2))


def test_logs_that_fit_are_counted(tmp_path):
    paths = [write_log(tmp_path / "a.mcap"), write_log(tmp_path / "b.mcap")]
    assert check_logs(paths, SENSOR, observe_action=False) == 20


def test_a_log_that_says_nothing_of_its_sensor_is_taken_at_its_width(tmp_path):
    assert check_logs([write_log(tmp_path / "a.mcap", metadata={})], SENSOR, observe_action=False) == 10


def test_a_log_without_transitions_counts_for_nothing(tmp_path):
    empty = write_log(tmp_path / "a.mcap", logged_transitions()[:0])
    assert check_logs([empty], SENSOR, observe_action=False) == 0


@pytest.mark.parametrize(
    ("sensor", "observe_action", "message"),
    [
        (
            Sensor(rays=9),
            False,
            r"its observations have 7 values, the network reads 9 \(sensor\.rays=9, env\.observe_action=false\); "
            "set both as in the run that wrote it",
        ),
        (SENSOR, True, r"have 7 values, the network reads 10 \(sensor\.rays=7, env\.observe_action=true\)"),
        (Sensor(rays=4), True, r"its sensor has 7 rays over 180 degrees, this configuration's 4 rays over 180 degrees"),
        (
            Sensor(field_of_view=120),
            False,
            r"7 rays over 180 degrees, this .* 7 rays over 120 degrees; set sensor\.rays",
        ),
        (
            Sensor(max_range=15),
            False,
            r"its sensor reaches 10\.0 m, this configuration's 15 m; set sensor\.max_range=10\.0",
        ),
    ],
    ids=["rays", "observed action", "rays and action", "field of view", "range"],
)
def test_a_log_of_another_sensor_is_refused(sensor, observe_action, message, tmp_path):
    with pytest.raises(LogError, match=message):
        check_logs([write_log(tmp_path / "a.mcap")], sensor, observe_action)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"action_names": '["left", "right"]'}, r"its actions are \['left', 'right'\], this car's are"),
        ({"action_names": "left"}, "its metadata entry 'action_names' is not JSON"),
        ({"sensor_range_m": '"far"'}, "its metadata entry 'sensor_range_m' holds no numbers"),
        ({"sensor_range_m": "[10.0]"}, r"its sensor reaches \[10\.\] m"),
        ({"sensor_angles_rad": "[[1], [2, 3]]"}, "its metadata entry 'sensor_angles_rad' holds no numbers"),
        ({"sensor_angles_rad": "[]"}, "its sensor has no rays"),
        ({"sensor_angles_rad": json.dumps([0.0] * 6 + [float("nan")])}, "its sensor has 7 rays over nan degrees"),
    ],
    ids=str,
)
def test_a_log_with_other_metadata_is_refused(entry, message, tmp_path):
    path = write_log(tmp_path / "a.mcap", metadata=METADATA | entry)
    with pytest.raises(LogError, match=message):
        check_logs([path], SENSOR, observe_action=False)


@pytest.mark.parametrize("action", [-1, 3])
def test_an_action_that_there_is_not_is_refused(action, tmp_path):
    path = write_log(tmp_path / "a.mcap", logged_transitions(action=action))
    with pytest.raises(LogError, match=r"has actions .*; they must lie in 0\.\.2, forward, left, right"):
        fill_from_logs(make_buffer(1), [path], 1)


def test_a_missing_log_is_named(tmp_path):
    with pytest.raises(LogError, match=r"nowhere\.mcap"):
        check_logs([tmp_path / "nowhere.mcap"], SENSOR, observe_action=False)
